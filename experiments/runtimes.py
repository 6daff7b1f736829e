"""CPU seconds of growing and repairing layouts, by size (appendix C.4)."""

import time
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np
from matplotlib.axes import Axes

from experiments.layouts import MAZE_S, MAZE_S_EVAL, S_EVAL, SECONDS, best_of
from experiments.pieces import Drawn, Experiment, Folders, Piece, Say, read_rows, table
from experiments.published import FLEETS
from qdenv.io.files import write_csv
from qdenv.run.config import RunConfig
from qdenv.run.directory import RunDirectory
from qdenv.stats import Sample, sample_of
from qdenv.study.elites import SIZES, Grown, finish, grow_elite
from qdenv.view.style import new_figure

SEEDS = 3  # repairs of each layout


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
    """Growing and repairing the best layout of the zoo at one size."""

    kind = "runtimes"
    domain: str  # its name
    shape: tuple[int, int]  # rows and columns
    seeds: int = SEEDS  # how many repairs

    @property
    def name(self) -> str:
        """Return its name in lists."""
        return "runtimes of {} at {}x{}".format(self.domain, *self.shape)

    def path(self, folders: Folders) -> Path:
        """Find its file."""
        return folders.results / "runtimes" / "{}-{}x{}.csv".format(self.domain, *self.shape)

    def read(self, folders: Folders) -> list[Runtime]:
        """Read what is saved of the generator that ships now."""
        if not self.path(folders).exists():
            return []
        origin = best_of(self.domain)
        return [row for row in read_rows(self.path(folders), Runtime) if row.origin == origin]

    def done(self, folders: Folders) -> float:
        """Return which share of the repairs is saved."""
        return min(len(self.read(folders)) / self.seeds, 1.0)

    def cost(self, folders: Folders) -> float:
        """Estimate the CPU seconds of the repairs that are missing."""
        known = self.read(folders)
        each = SECONDS.get(self.shape, 8.0)
        if known:
            each = sum(sum(row[2:5]) for row in known) / len(known)
        return each * (self.seeds - len(known))

    def make(self, folders: Folders, say: Say) -> None:
        """Grow and repair once per seed; each is saved as it ends."""
        run = RunDirectory.open(f"zoo:{self.domain}/best")
        grown = grow_elite(run, "best", self.shape)
        assert grown.elite is not None
        # A process loads what was compiled before when it repairs first, which is no repair's work.
        finish(grown, run.config.evaluation.repair, seed=0)
        while (seed := len(known := self.read(folders))) < self.seeds:
            assert grown.elite is not None
            row = measure(grown, grown.elite.solution, run.config, seed, best_of(self.domain))
            write_csv(self.path(folders), Runtime._fields, [*known, row])
            say(f"{self.name}: {seed + 1} of {self.seeds}, repair {row.repair_seconds:.1f} s")


def measure(
    grown: Grown, solution: np.ndarray, config: RunConfig, seed: int, origin: str
) -> Runtime:
    """Grow a layout once more and repair it by the clock of the CPU, all cores together.

    Raises:
        InputError: no repair was found.
    """
    import jax

    from qdenv.generate import GENERATORS

    generator = GENERATORS.make(config.evaluation.generator, grown.domain.canvas)
    begin = time.process_time()
    grow = jax.jit(lambda some: generator.grow(some, grown.steps)).lower(solution[None]).compile()
    compiled = time.process_time()
    grow(solution[None]).block_until_ready()
    done = time.process_time()
    sized = finish(grown, config.evaluation.repair, seed)
    seconds = (round(compiled - begin, 4), round(done - compiled, 4), sized.cpu_seconds)
    return Runtime(seed, grown.steps, *seconds, sized.repair, sized.changed, origin)


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
    "CPU seconds of all threads together; mean +- standard error over the repairs. Compiling "
    "happens once per size.",
    "The paper gives its MILP solver 1 thread and 60,000 ticks at 33 x 36, 28 threads and "
    "3,600,000 ticks at 101 x 102 (appendix C.4, which gives no seconds).",
)


def draw(folders: Folders) -> Drawn:
    """Draw CPU seconds over the number of cells, and write them down."""
    figure = new_figure(7.2, 3.6, dpi=100)
    axes, rows = figure.subplots(), []
    for domain in LOOKS:
        own = {
            one.shape: found
            for one in PIECES
            if one.domain == domain and (found := one.read(folders))
        }
        draw_domain(axes, domain, own)
        rows += [row_of(domain, shape, found) for shape, found in own.items()]
    missing = sum(not one.read(folders) for one in PIECES)
    axes.set(xscale="log", yscale="log", xlabel="cells", ylabel="CPU seconds")
    ticks = [rows * cols for rows, cols in (MAZE_S, *SIZES[::2], S_EVAL)]
    axes.set_xticks(sorted(set(ticks)), [f"{cells:,}" for cells in sorted(set(ticks))])
    axes.minorticks_off()
    axes.grid(alpha=0.3)
    figure.legend(loc="outside right center", frameon=False, fontsize="small")
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
        means, errors = ([getattr(one, part) for one in samples] for part in ("mean", "error"))
        (line, *_) = axes.errorbar(
            cells, means, np.nan_to_num(errors), color=colour, capsize=2, label=f"{domain}, {label}"
        )
        line.set(marker=marker, linestyle=style, markerfacecolor=fill, markersize=5)


def seconds_of(found: list[Runtime], name: str) -> Sample:
    """Average one of the durations."""
    return sample_of(np.array([getattr(row, name) for row in found]))


def row_of(domain: str, shape: tuple[int, int], found: list[Runtime]) -> tuple[object, ...]:
    """Write what one size took."""
    seconds = []
    for name in ("compile_seconds", "grow_seconds", "repair_seconds"):
        sample = seconds_of(found, name)
        seconds.append(f"{sample.mean:.2f} +- {sample.error:.2f}")
    changed = sample_of(np.array([row.changed for row in found])).mean
    ended = ", ".join(sorted({row.repair for row in found}))
    named = (domain, "{} x {}".format(*shape), found[0].steps)
    return (*named, *seconds, len(found), f"{changed:.0f}", ended)


EXPERIMENT = Experiment("CPU seconds of growth and repair, by size", PIECES, draw)
