"""CPU seconds of growing and repairing layouts, by size (appendix C.4)."""

import time
from dataclasses import dataclass
from statistics import mean
from typing import Any, NamedTuple

import jax
import numpy as np
from matplotlib.axes import Axes

from experiments.layouts import MAZE_S, MAZE_S_EVAL, SECONDS, best_of, open_generator
from experiments.pieces import Drawn, Experiment, Folders, Piece, say, table
from experiments.published import FLEETS
from qdenv.generators import GENERATORS
from qdenv.io.files import write_csv
from qdenv.io.records import read_table
from qdenv.stats import Sample, sample_of
from qdenv.study.elites import SIZES, finish, grow_elite
from qdenv.view.style import new_figure


class Runtime(NamedTuple):
    """What one layout took, a row of the file."""

    seed: int  # of the repair
    steps: int  # of growth
    compile_seconds: float  # CPU seconds of compiling the growth, once per size
    grow_seconds: float  # CPU seconds of the growth
    repair_seconds: float  # CPU seconds of the repair; 0 where nothing is repaired
    repair: str  # how the repair ended
    changed: int  # cells that it changed
    origin: str  # of the generator, as `layouts.best_of` tells it


@dataclass(frozen=True)
class SavedRuntime(Piece):
    """Growing and repairing the best layout of the first zoo (mazes: of the zoo that ships)."""

    kind = "runtimes"
    label = "runtimes of {0.domain} at {0.shape[0]}x{0.shape[1]}"
    file = "runtimes/{0.domain}-{0.shape[0]}x{0.shape[1]}.csv"
    domain: str  # its name
    shape: tuple[int, int]  # rows and columns
    seeds: int = 3  # how many repairs

    def read(self, folders: Folders) -> list[Runtime]:
        """Read what is saved of this generator."""
        if not self.path(folders).exists():
            return []
        origin = best_of(self.domain)
        return [row for row in read_table(self.path(folders), Runtime) if row.origin == origin]

    def done(self, folders: Folders) -> float:
        """Return which share of the repairs is saved."""
        return min(len(self.read(folders)) / self.seeds, 1.0)

    def seconds(self, folders: Folders) -> float:
        """Estimate the CPU seconds of all repairs."""
        known = [sum(row[2:5]) for row in self.read(folders)]
        return self.seeds * mean(known or [SECONDS.get(self.shape, 8.0)])

    def make(self, folders: Folders) -> None:
        """Grow and repair once per seed; each is saved as it ends."""
        run = open_generator(self.domain, "nca")
        config = run.config.evaluation
        grown = grow_elite(run, "best", self.shape)._replace(repair=config.repair)
        assert grown.elite is not None
        solution = grown.elite.solution[None]
        generator = GENERATORS.make(config.generator, grown.domain.canvas)
        # A process loads what was compiled before when it repairs first, which is no repair's work.
        finish(grown, seed=0)
        while (seed := len(known := self.read(folders))) < self.seeds:
            # By the clock of the CPU, all cores together.
            begin = time.process_time()
            grow = jax.jit(lambda some: generator.grow(some, grown.steps))
            compiled_grow = grow.lower(solution).compile()
            compiled = time.process_time()
            compiled_grow(solution).block_until_ready()
            seconds = round(compiled - begin, 4), round(time.process_time() - compiled, 4)
            sized = finish(grown, seed)
            ended: Any = (sized.cpu_seconds, sized.repair, sized.changed, best_of(self.domain))
            known.append(Runtime(seed, grown.steps, *seconds, *ended))
            write_csv(self.path(folders), Runtime._fields, known)
            say(f"{self.name}: {seed + 1} of {self.seeds}, repair {sized.cpu_seconds:.1f} s")


PIECES = tuple(SavedRuntime(domain, shape) for domain in FLEETS for shape in SIZES)
PIECES += tuple(SavedRuntime("maze-walls", shape) for shape in (MAZE_S, MAZE_S_EVAL))
LOOKS = {  # Okabe and Ito 2008
    "warehouse-even": ("#0072B2", "o"),
    "warehouse-uneven": ("#E69F00", "s"),
    "manufacturing": ("#009E73", "^"),
    "maze-walls": ("#CC79A7", "D"),
}
HEAD = (
    *("domain", "size", "steps", "compiling [s]", "growth [s]", "repair [s]", "repairs"),
    *("cells changed", "ended"),
)
NOTES = (
    "CPU seconds of all threads together; mean ± standard error over the repairs. Compiling "
    "happens once per size.",
    "The paper gives its MILP solver 1 thread and 60,000 ticks at 33 x 36, 28 threads and "
    "3,600,000 ticks at 101 x 102 (appendix C.4, which gives no seconds).",
)


def draw(folders: Folders) -> Drawn:
    """Draw CPU seconds over the number of cells, and write them down."""
    figure = new_figure(7.2, 3.6, dpi=100)
    axes, rows = figure.subplots(), []
    every = {one: found for one in PIECES if (found := one.read(folders))}
    for domain in LOOKS:
        own = {one.shape: found for one, found in every.items() if one.domain == domain}
        draw_domain(axes, domain, own)
        for shape, found in own.items():
            named = (domain, "{} x {}".format(*shape), found[0].steps)
            took = [seconds_of(found, name) for name in Runtime._fields[2:5]]
            seconds = [f"{sample.mean:.2f} ± {sample.error:.2f}" for sample in took]
            changed = sample_of(np.array([row.changed for row in found])).mean
            ended = ", ".join(sorted({row.repair for row in found}))
            rows.append((*named, *seconds, len(found), f"{changed:.0f}", ended))
    missing = len(PIECES) - len(every)
    axes.set(xscale="log", yscale="log", xlabel="cells", ylabel="CPU seconds")
    ticks = [rows * cols for rows, cols in (MAZE_S, *SIZES[::2])]
    axes.set_xticks(ticks, [f"{cells:,}" for cells in ticks])
    axes.minorticks_off()
    axes.grid(alpha=0.3)
    figure.legend(loc="outside right center", fontsize="small")
    said = (f"Not made yet: {missing} of {len(PIECES)}.",) if missing else ()
    return Drawn(figure, (*table(HEAD, rows), "", *NOTES, *said))


def draw_domain(axes: Axes, domain: str, own: dict[tuple[int, int], list[Runtime]]) -> None:
    """Draw the repair and the growth of one domain, means with standard errors."""
    colour, marker = LOOKS[domain]
    cells = [rows * cols for rows, cols in own]
    for name, label, style, fill in (
        ("repair_seconds", "repair", "-", colour),
        ("grow_seconds", "growth", ":", "white"),
    ):
        samples = [seconds_of(found, name) for found in own.values()]
        if not any(sample.mean for sample in samples):
            continue
        means, errors, _ = zip(*samples, strict=True)
        look: Any = {"color": colour, "marker": marker, "ls": style, "mfc": fill, "ms": 5}
        label = f"{domain}, {label}"
        axes.errorbar(cells, means, np.nan_to_num(errors), label=label, capsize=2, **look)


def seconds_of(found: list[Runtime], name: str) -> Sample:
    """Average one of the durations."""
    return sample_of(np.array([getattr(row, name) for row in found]))


EXPERIMENT = Experiment("CPU seconds of growth and repair, by size", PIECES, draw)
