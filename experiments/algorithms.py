"""Compare six search algorithms at equal true evaluations, several seeds each (Table 4).

    python -m experiments.algorithms                                             # on quick
    python -m experiments.algorithms --preset laptop --seeds 1 --evaluations 1000

Every algorithm has its defaults. Each run has a folder of its own: finished ones are read,
half-done ones go on, so this can be stopped and started again, with more seeds, too.
"""

import time
from dataclasses import replace
from itertools import chain, product
from pathlib import Path
from typing import NamedTuple

import numpy as np

import qdenv
from experiments.lines import draw_band
from experiments.program import run_program
from experiments.published import TABLE_4
from experiments.runs import whole_run
from qdenv.io.files import write_csv
from qdenv.ops.output import format_duration, format_table
from qdenv.run.config import choose_algorithm
from qdenv.study.groups import band_of
from qdenv.view.style import new_figure, save_figure, styled

ALGORITHMS = ("cma-mae", "cma-me", "map-elites", "cma-es", "random", "dsage")
# Colours (Okabe and Ito 2008) and styles, which grey prints tell apart, too.
LOOKS = (
    *(("#0072B2", "-"), ("#56B4E9", "--"), ("#D55E00", "-"), ("#E69F00", "--")),
    *(("#999999", ":"), ("#CC79A7", "-.")),
)
METRICS = {"qd_score": "QD-score", "coverage": "coverage", "best_objective": "best objective"}
ENTROPY = ("mean_entropy", "lowest_entropy", "share_below_half")


class Runs(NamedTuple):
    """The runs of one algorithm."""

    evaluations: np.ndarray  # int [N], where its metrics were taken
    metrics: np.ndarray  # float [seeds, N, 3], in the order of `METRICS`
    entropy: np.ndarray  # float [3], over the elites, means over seeds, in the order of `ENTROPY`


def collect(runs: list[qdenv.RunDirectory]) -> Runs:
    """Put the metrics of an algorithm's runs side by side; NaN where entropy is no measure."""
    tables = [run.read_metrics() for run in runs]
    metrics = [[[getattr(row, name) for name in METRICS] for row in rows] for rows in tables]
    entropies = np.full((len(runs), len(ENTROPY)), np.nan)
    for number, run in enumerate(runs):
        found = [place for place, axis in enumerate(run.measures) if "entropy" in axis.name]
        if found:
            values = run.archive.columns["measures"][:, found].ravel()
            entropies[number] = values.mean(), values.min(), (values < 0.5).mean()
    evaluations = np.array([row.evaluations for row in tables[0]])
    return Runs(evaluations, np.array(metrics), entropies.mean(axis=0))


def write_table(path: Path, found: dict[str, Runs], domain: str) -> None:
    """Write one row per algorithm, and print it beside the paper's of a domain.

    A row holds final means, half-widths of their intervals, entropies.
    """
    print(
        "mean +- half of its 95 % interval (Student's t); share: of elites with entropy below 0.5"
    )
    paper = "Table 4: QD-score, coverage"
    shown = [("algorithm", *METRICS.values(), "entropy", "lowest", "share", paper)]
    head = ["algorithm", "seeds", "evaluations"]
    head += [name for metric in METRICS for name in (metric, f"{metric}_margin")]
    rows = []
    for name, runs in found.items():
        pairs = list(zip(*band_of(runs.metrics[:, -1]), strict=True))
        numbers = [f"{number:.6g}" for number in (*chain(*pairs), *runs.entropy)]
        rows.append((name, len(runs.metrics), runs.evaluations[-1], *numbers))
        cells = [
            f"{m:.{digits}f} +- {half:.{digits}f}"
            for (m, half), digits in zip(pairs, (1, 4, 3), strict=True)
        ]
        mean, lowest, share = runs.entropy
        cells += [f"{mean:.2f}", f"{lowest:.2f}", f"{share:.1%}"]
        shown.append((name, *cells, str(TABLE_4.get((domain, name), ""))))
    print("\n".join(format_table(shown)))
    write_csv(path, [*head, *ENTROPY], rows)


@styled
def draw(path: Path, found: dict[str, Runs], title: str) -> None:
    """Draw the three metrics over true evaluations: means, and their 95 % intervals shaded."""
    figure = new_figure(10, 3.6, dpi=110)
    panels = figure.subplots(1, len(METRICS))
    for column, (axes, label) in enumerate(zip(panels, METRICS.values(), strict=True)):
        for (name, runs), look in zip(found.items(), LOOKS, strict=False):
            draw_band(axes, runs.evaluations, runs.metrics[:, :, column], look, name)
        axes.set(title=label, xlabel="true evaluations")
    figure.suptitle(title, fontsize="medium")
    figure.legend(*panels[0].get_legend_handles_labels(), loc="outside lower center", ncols=6)
    save_figure(figure, path)


def main(
    preset: str = "quick",
    seeds: int = 5,
    evaluations: int | None = None,
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
    collected = {name: collect(runs) for name, runs in found.items()}
    domain = qdenv.DOMAINS.name_of(base.evaluation.domain)
    write_table(out / "algorithms.csv", collected, domain)
    spread = "mean and 95 % interval" if seeds > 1 else "one run each"
    draw(out / "algorithms.png", collected, f"{preset}, {seeds} seeds: {spread}")
    print(f"{out / 'algorithms.csv'}, {out / 'algorithms.png'}")


if __name__ == "__main__":
    run_program(main, "python -m experiments.algorithms")
