"""The one row record of every study: one layout at one number of agents, over some seeds."""

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from qdenv.files import write_csv
from qdenv.score.traffic import wilson_interval
from qdenv.types import Traffic


class Row(NamedTuple):
    """One layout at one number of agents.

    Attributes:
        layout: its name.
        rows: its rows.
        cols: its columns.
        agents: how many took part.
        runs: how many simulations, one per seed.
        throughput: tasks per timestep, averaged over the runs that never congested (as published
            tables do); NaN where every run congested.
        standard_error: of `throughput`; NaN with fewer than two such runs.
        success_rate: share of the runs that never congested.
        success_low: lower end of its 95 % Wilson interval.
        success_high: upper end.
        mean_of_all: tasks per timestep, averaged over all runs.
        cpu_seconds_per_run: without compilation.
    """

    layout: str
    rows: int
    cols: int
    agents: int
    runs: int
    throughput: float
    standard_error: float
    success_rate: float
    success_low: float
    success_high: float
    mean_of_all: float
    cpu_seconds_per_run: float


class Peak(NamedTuple):
    """The most a layout moves, and the number of agents that moves it (Figure 18).

    Attributes:
        layout: its name.
        rows: its rows.
        cols: its columns.
        agents: where the mean throughput peaks, the maximum scalability of section E.3.
        throughput: the peak: tasks per timestep, averaged over all runs, congested ones too.
        success_rate: of the runs at the peak.
        dropped: throughput fell at the next number of agents; False where it still rose at the
            last one tried, so that the true peak lies higher.
    """

    layout: str
    rows: int
    cols: int
    agents: int
    throughput: float
    success_rate: float
    dropped: bool


def summarise(
    name: str, layout: np.ndarray, agents: int, runs: Sequence[Traffic], cpu_seconds: float
) -> Row:
    """Condense the runs of one layout with one number of agents.

    Args:
        name: how the table calls the layout.
        layout: int8 [H, W].
        agents: how many took part.
        runs: one per seed.
        cpu_seconds: of all of them together.
    """
    every = np.array([run.throughput for run in runs])
    good = every[[not run.congested for run in runs]]
    error = float(good.std(ddof=1) / np.sqrt(len(good))) if len(good) > 1 else float("nan")
    low, high = wilson_interval(len(good), len(runs))
    return Row(
        layout=name,
        rows=layout.shape[0],
        cols=layout.shape[1],
        agents=agents,
        runs=len(runs),
        throughput=float(good.mean()) if len(good) else float("nan"),
        standard_error=error,
        success_rate=len(good) / len(runs),
        success_low=low,
        success_high=high,
        mean_of_all=float(every.mean()),
        cpu_seconds_per_run=cpu_seconds / len(runs),
    )


def find_peak(rows: Sequence[Row]) -> Peak:
    """Find the peak of one layout's rows, sorted by agents."""
    means = [row.mean_of_all for row in rows]
    top = int(np.argmax(means))
    at = rows[top]
    dropped = top < len(rows) - 1
    return Peak(at.layout, at.rows, at.cols, at.agents, means[top], at.success_rate, dropped)


def write_rows(path: Path, rows: Sequence[Row]) -> None:
    """Write rows as CSV, one line each.

    Raises:
        InputError: the place cannot be written to.
    """
    write_csv(path, Row._fields, rows)
