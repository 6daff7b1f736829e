"""Compare six search algorithms at equal true evaluations, several seeds each (Table 4).

    python -m experiments.algorithms                                             # on quick
    python -m experiments.algorithms --preset laptop --seeds 1 --evaluations 1000

Every algorithm has its defaults. Each run has a folder of its own: finished ones are read,
half-done ones go on, so this can be stopped and started again, with more seeds, too.
"""

import time
from dataclasses import replace
from itertools import chain, cycle, product
from math import nan
from pathlib import Path

import numpy as np

import qdenv
from experiments.lines import draw_band
from experiments.program import run_program
from experiments.published import TABLE_4
from experiments.runs import whole_run
from qdenv.io.files import write_csv
from qdenv.ops.output import format_duration, format_table
from qdenv.ranges import PositiveInt
from qdenv.run.config import choose_algorithm
from qdenv.study.groups import CURVES, Group, band_of, group_runs
from qdenv.view.style import new_figure, save_figure, styled

ALGORITHMS = ("cma-mae", "cma-me", "map-elites", "cma-es", "random", "dsage")
# Colours (Okabe and Ito 2008) and styles, which grey prints tell apart, too.
LOOKS = (
    *(("#0072B2", "-"), ("#56B4E9", "--"), ("#D55E00", "-"), ("#E69F00", "--")),
    *(("#999999", ":"), ("#CC79A7", "-.")),
)
ENTROPY = ("mean_entropy", "lowest_entropy", "share_below_half")


def entropy_of(run: qdenv.RunDirectory) -> tuple[float, float, float]:
    """Return the `ENTROPY` of the elites of a run; NaN where entropy is no measure."""
    found = [place for place, axis in enumerate(run.measures) if "entropy" in axis.name]
    if not found:
        return nan, nan, nan
    values = run.archive.columns["measures"][:, found].ravel()
    return values.mean(), values.min(), (values < 0.5).mean()


def write_table(path: Path, found: dict[str, Group], domain: str) -> None:
    """Write one row per algorithm, and print it beside the paper's of a domain.

    A row holds final means, half-widths of their intervals, means of entropies.
    """
    print("mean ± half of its 95 % interval (Student's t); share: of elites with entropy below 0.5")
    paper = "Table 4: QD-score, coverage"
    shown = [("algorithm", *CURVES.values(), "entropy", "lowest", "share", paper)]
    head = ["algorithm", "seeds", "evaluations"]
    head += [name for metric in CURVES for name in (metric, f"{metric}_margin")]
    rows = []
    for name, group in found.items():
        last = np.column_stack([values[:, -1] for values in group.curves.values()])
        pairs = list(zip(*band_of(last), strict=True))
        entropies = np.mean([entropy_of(run) for run in group.runs], axis=0)
        numbers = [f"{number:.6g}" for number in (*chain(*pairs), *entropies)]
        rows.append((name, len(group.runs), group.evaluations[-1], *numbers))
        cells = [f"{m:.{d}f} ± {half:.{d}f}" for (m, half), d in zip(pairs, (1, 4, 3), strict=True)]
        mean, lowest, share = entropies
        cells += [f"{mean:.2f}", f"{lowest:.2f}", f"{share:.1%}"]
        shown.append((name, *cells, str(TABLE_4.get((domain, name), ""))))
    print("\n".join(format_table(shown)))
    write_csv(path, [*head, *ENTROPY], rows)


@styled
def draw(path: Path, found: dict[str, Group], title: str) -> None:
    """Draw the three metrics over true evaluations: means, and their 95 % intervals shaded."""
    figure = new_figure(10, 3.6, dpi=110)
    panels = figure.subplots(1, len(CURVES))
    for axes, (metric, label) in zip(panels, CURVES.items(), strict=True):
        for (name, group), look in zip(found.items(), cycle(LOOKS), strict=False):
            draw_band(axes, group.evaluations, group.curves[metric], look, name)
        axes.set(title=label, xlabel="true evaluations")
    figure.suptitle(title, fontsize="medium")
    figure.legend(*panels[0].get_legend_handles_labels(), loc="outside lower center", ncols=6)
    save_figure(figure, path)


def main(
    preset: str = "quick",
    seeds: PositiveInt = 5,
    evaluations: PositiveInt | None = None,
    algorithms: tuple[str, ...] = ALGORITHMS,
    out: Path = Path("runs/algorithms"),
) -> None:
    """Run what is missing, write algorithms.csv and algorithms.png, print the table.

    Args:
        preset: the domain, generator and archive that all share.
        seeds: runs of each algorithm.
        evaluations: true ones of each run; as many as the preset has unless given.
        algorithms: which to compare.
        out: folder of the runs, the table and the picture.
    """
    base = qdenv.find_preset(preset)
    base = replace(base, evaluations=evaluations or base.evaluations)
    todo = list(product(range(seeds), algorithms))
    found: dict[str, list[qdenv.RunDirectory]] = {name: [] for name in algorithms}
    start = time.time()
    for done, (seed, name) in enumerate(todo, start=1):
        config = replace(choose_algorithm(base, name), seed=seed)
        path = out / f"{preset}-{name}-{seed}"
        run = whole_run(config, path)
        if run.config.evaluations > config.evaluations:
            more = f"a run of {run.config.evaluations} evaluations"
            raise qdenv.InputError(f"{path}: {more}: give a larger number")
        found[name].append(run)
        left = (time.time() - start) / done * (len(todo) - done)
        rest = f", about {format_duration(left)} left" if done < len(todo) else ""
        print(f"{done} of {len(todo)}: {run!r}{rest}", flush=True)
    groups = {name: group_runs(runs)[0] for name, runs in found.items()}
    write_table(out / "algorithms.csv", groups, qdenv.DOMAINS.name_of(base.evaluation.domain))
    spread = "mean and 95 % interval" if seeds > 1 else "one run each"
    draw(out / "algorithms.png", groups, f"{preset}, {seeds} seeds: {spread}")
    print(f"{out / 'algorithms.csv'}, {out / 'algorithms.png'}")


if __name__ == "__main__":
    run_program(main, "python -m experiments.algorithms")
