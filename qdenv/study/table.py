"""The row of every study of traffic: one layout at one number of agents, over some seeds."""

from collections.abc import Mapping, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from qdenv.io.files import write_csv
from qdenv.stats import Difference, Sample, difference, sample_of, wilson_interval
from qdenv.study.congestion import fading
from qdenv.types import Traffic

WORTH = 0.5  # share of what an average agent brings; one that brings less is hardly worth it


class Row(NamedTuple):
    """One layout at one number of agents."""

    layout: str  # its name
    rows: int  # its rows
    cols: int  # its columns
    agents: int  # how many took part
    runs: int  # how many simulations, one per seed
    # tasks per timestep, averaged over the runs that never congested (as published tables do); NaN
    # where every run congested. Over all runs where congestion ends none.
    throughput: float
    standard_error: float  # of `throughput`; NaN with fewer than two such runs
    success_rate: float  # share of the runs that never congested
    success_low: float  # lower end of its 95 % Wilson interval
    success_high: float  # upper end
    mean_of_all: float  # tasks per timestep, averaged over all runs
    cpu_seconds_per_run: float  # without compilation
    error_of_all: float = float("nan")  # standard error of `mean_of_all`; NaN with one run
    fading: float = 0.0  # see `congestion.fading`


class Peak(NamedTuple):
    """The most a layout moves, and the number of agents that moves it (Figure 18)."""

    layout: str  # its name
    rows: int  # its rows
    cols: int  # its columns
    agents: int  # where the mean throughput peaks, the maximum scalability of section E.3
    throughput: float  # the peak: tasks per timestep, averaged over all runs, congested ones too
    success_rate: float  # of the runs at the peak
    # throughput fell at the next number of agents; False where it still rose at the last one tried,
    # so that the true peak lies higher
    dropped: bool


def summarise(
    name: str,
    layout: np.ndarray,
    agents: int,
    runs: Sequence[Traffic],
    cpu_seconds: float,
    stop: bool = True,
) -> Row:
    """Condense the runs of one layout with one number of agents.

    Args:
        name: how the table calls the layout.
        layout: int8 [H, W].
        agents: how many took part.
        runs: one per seed.
        cpu_seconds: of all of them together.
        stop: congestion ended those that congested.
    """
    every = np.array([run.throughput for run in runs])
    flowed = np.array([not run.congested for run in runs])
    good = every[flowed] if stop else every
    error = sample_of(good).error if len(good) else float("nan")
    successes = int(flowed.sum())
    low, high = wilson_interval(successes, len(runs))
    return Row(
        layout=name,
        rows=layout.shape[0],
        cols=layout.shape[1],
        agents=agents,
        runs=len(runs),
        throughput=float(good.mean()) if len(good) else float("nan"),
        standard_error=error,
        success_rate=successes / len(runs),
        success_low=low,
        success_high=high,
        mean_of_all=float(every.mean()),
        cpu_seconds_per_run=cpu_seconds / len(runs),
        error_of_all=sample_of(every).error,
        fading=fading(runs),
    )


def find_peak(rows: Sequence[Row]) -> Peak:
    """Find the peak of one layout's rows, sorted by agents."""
    means = [row.mean_of_all for row in rows]
    top = int(np.argmax(means))
    at = rows[top]
    dropped = top < len(rows) - 1
    return Peak(at.layout, at.rows, at.cols, at.agents, means[top], at.success_rate, dropped)


def value_of_an_agent(fewer: tuple[int, float], more: tuple[int, float]) -> float:
    """Compare what a further agent brings with what one brings on average.

    The elasticity of throughput to the number of agents: 1 without any hindrance, 0 at the peak.

    Args:
        fewer: a number of agents and its throughput.
        more: a larger number and its throughput.
    """
    added = (more[1] - fewer[1]) / (more[0] - fewer[0])
    return added / (fewer[1] / fewer[0]) if fewer[1] else 0.0


def find_capacity(rows: Sequence[Row]) -> int:
    """Find up to which number of agents of one layout's rows every further one is worth it.

    It is where it brings at least half of what an average one does (`WORTH`).

    Args:
        rows: sorted by agents.
    """
    points = [(row.agents, row.mean_of_all) for row in rows]
    for fewer, more in pairwise(points):
        if value_of_an_agent(fewer, more) < WORTH:
            return fewer[0]
    return points[-1][0]


def differences(rows: Sequence[Row]) -> list[Difference]:
    """Compare each row with that of the first layout at the same number of agents.

    Over all runs, congested ones too: to leave them out would favour a layout that congests.
    The first layout's own rows differ by 0 from themselves, without an interval.
    """
    first = {row.agents: row for row in rows if row.layout == rows[0].layout}
    itself = Difference(0.0, float("nan"), float("nan"), False)

    def sample(row: Row) -> Sample:
        return Sample(row.mean_of_all, row.error_of_all, row.runs)

    return [
        itself
        if row.layout == rows[0].layout
        else difference(sample(row), sample(first[row.agents]))
        for row in rows
    ]


def write_rows(
    path: Path, rows: Sequence[Row], columns: Mapping[str, Sequence[Any]] | None = None
) -> None:
    """Write rows as CSV, one line each.

    Args:
        path: the file.
        rows: of the table.
        columns: further ones by name, an entry for each row.

    Raises:
        InputError: the place cannot be written to.
    """
    columns = columns or {}
    lines = [(*row, *rest) for row, *rest in zip(rows, *columns.values(), strict=True)]
    # Six digits are more than any of these numbers means.
    lines = [
        tuple(float(f"{one:.6g}") if isinstance(one, float) else one for one in line)
        for line in lines
    ]
    write_csv(path, (*Row._fields, *columns), lines)
