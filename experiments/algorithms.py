"""Compare all search algorithms at equal true evaluations, several seeds each (Table 4).

    python -m experiments.algorithms                                             # on quick
    python -m experiments.algorithms --preset laptop --seeds 1 --evaluations 1000

Every algorithm has its defaults. Each run has a folder of its own: finished ones are read,
half-done ones go on, so this can be stopped and started again, with more seeds, too.
"""

import itertools
import sys
import time
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

import qdenv
from experiments.published import TABLE_4
from experiments.runs import whole_run
from qdenv.cli.parser import run_program
from qdenv.io.files import write_csv
from qdenv.ops.output import format_duration
from qdenv.run.config import choose_algorithm
from qdenv.study.groups import band_of
from qdenv.view.style import new_figure, save_figure, styled

ALGORITHMS = ("cma-mae", "cma-me", "map-elites", "cma-es", "random", "dsage")
COLOURS = ("#0072B2", "#56B4E9", "#D55E00", "#E69F00", "#999999", "#CC79A7")  # Okabe and Ito 2008
STYLES = ("-", "--", "-", "--", ":", "-.")  # grey prints tell them apart, too
METRICS = {"qd_score": "QD-score", "coverage": "coverage", "best_objective": "best objective"}
ENTROPY = ("mean_entropy", "lowest_entropy", "share_below_half")


class Runs(NamedTuple):
    """The runs of one algorithm."""

    evaluations: np.ndarray  # int [N], where its metrics were taken
    metrics: np.ndarray  # float [seeds, N, 3], in the order of `METRICS`
    entropy: np.ndarray  # float [seeds, 3], over the elites, in the order of `ENTROPY`


def entropies_of(run: qdenv.RunDirectory) -> np.ndarray:
    """Describe the entropy of a run's elites, float [3]; NaN where it is no measure."""
    found = [place for place, axis in enumerate(run.measures) if "entropy" in axis.name]
    values = run.archive.columns["measures"][:, found].ravel()
    if not len(values):
        return np.full(len(ENTROPY), np.nan)
    return np.array([values.mean(), values.min(), (values < 0.5).mean()])


def collect(runs: Iterable[qdenv.RunDirectory]) -> Runs:
    """Put the metrics of an algorithm's runs side by side."""
    runs = list(runs)
    tables = [run.read_metrics() for run in runs]
    metrics = [[[getattr(row, name) for name in METRICS] for row in rows] for rows in tables]
    evaluations = np.array([row.evaluations for row in tables[0]])
    return Runs(evaluations, np.array(metrics), np.array([entropies_of(run) for run in runs]))


def write_table(path: Path, found: dict[str, Runs]) -> None:
    """Write one row per algorithm: final means, half-widths of their intervals, entropies."""
    head = ["algorithm", "seeds", "evaluations"]
    head += [name for metric in METRICS for name in (metric, f"{metric}_margin")]
    rows = []
    for name, runs in found.items():
        numbers = np.stack(band_of(runs.metrics[:, -1]), axis=1).ravel()
        written = [f"{number:.6g}" for number in (*numbers, *runs.entropy.mean(axis=0))]
        rows.append((name, len(runs.metrics), runs.evaluations[-1], *written))
    write_csv(path, [*head, *ENTROPY], rows)


def print_table(found: dict[str, Runs], domain: str) -> None:
    """Print the table beside the paper's of a domain."""
    print(
        "mean +- half of its 95 % interval (Student's t); share: of elites with entropy below 0.5"
    )
    head = "".join(f"{title:18}" for title in METRICS.values())
    print(f"algorithm    {head}entropy  lowest  share  Table 4: QD-score, coverage")
    for name, runs in found.items():
        means, halves = band_of(runs.metrics[:, -1])
        numbers = zip(means, halves, (1, 4, 3), strict=True)
        cells = [f"{mean:.{digits}f} +- {half:.{digits}f}" for mean, half, digits in numbers]
        mean, lowest, share = runs.entropy.mean(axis=0)
        paper = TABLE_4.get((domain, name), "")
        said = "".join(f"{cell:18}" for cell in cells)
        print(f"{name:11}  {said}{mean:7.2f}  {lowest:6.2f}  {share:5.1%}  {paper}".rstrip())


@styled
def draw(path: Path, found: dict[str, Runs], title: str) -> None:
    """Draw the three metrics over true evaluations: means, and their 95 % intervals shaded."""
    figure = new_figure(10, 3.6, dpi=110)
    panels = figure.subplots(1, len(METRICS))
    for column, (axes, label) in enumerate(zip(panels, METRICS.values(), strict=True)):
        for (name, runs), colour, style in zip(found.items(), COLOURS, STYLES, strict=False):
            mean, half = band_of(runs.metrics[:, :, column])
            axes.plot(runs.evaluations, mean, style, color=colour, label=name)
            half = np.nan_to_num(half)
            axes.fill_between(
                runs.evaluations, mean - half, mean + half, color=colour, alpha=0.2, linewidth=0
            )
        axes.set(title=label, xlabel="true evaluations")
        axes.spines[["top", "right"]].set_visible(False)
    figure.suptitle(title, fontsize="medium")
    figure.legend(
        *panels[0].get_legend_handles_labels(), loc="outside lower center", ncols=6, frameon=False
    )
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
    todo = list(itertools.product(range(seeds), algorithms))
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
    write_table(out / "algorithms.csv", collected)
    spread = "mean and 95 % interval" if seeds > 1 else "one run each"
    draw(out / "algorithms.png", collected, f"{preset}, {seeds} seeds: {spread}")
    domain = qdenv.DOMAINS.name_of(base.evaluation.domain)
    print_table(collected, domain)
    print(f"{out / 'algorithms.csv'}, {out / 'algorithms.png'}")


if __name__ == "__main__":
    sys.exit(run_program(main, "python -m experiments.algorithms"))
