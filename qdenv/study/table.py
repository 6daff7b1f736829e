"""Tables of traffic: a row for each layout and number of agents, how it is made and what it shows.

Layouts are simulated side by side (`compare`) or with more and more agents up to their peak
(`climb`); peaks, capacities and differences are read off the rows.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from itertools import pairwise, product
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from qdenv.grid import of_tiles
from qdenv.io.files import write_csv
from qdenv.progress import Progress, silent
from qdenv.simulation.mapf.settings import FleetConfig
from qdenv.stats import (
    Difference,
    Sample,
    difference,
    paired_difference,
    sample_of,
    wilson_interval,
)
from qdenv.study.options import fleet_tasks
from qdenv.study.recordings import fading
from qdenv.types import Floor, TaskRule, Traffic, about

WORTH = 0.5  # share of what an average agent brings; one that brings less is hardly worth it
# Agents of the smallest compiled program: a smaller one saves less than it costs to compile.
_MIN_CAPACITY = 64


class Run(NamedTuple):
    """One simulation in brief."""

    seed: int  # of it
    throughput: float  # tasks per timestep
    congested: bool  # more than half of the agents stood still at once


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
    fading: float = 0.0  # see `recordings.fading`
    # name of the planner, where several are put side by side; "" where one plans all rows
    planner: str = ""
    each: tuple[Run, ...] = ()  # its runs; tables have a file of their own for them

    @property
    def name(self) -> str:
        """What tells it apart at one number of agents."""
        return f"{self.layout}, {self.planner}" if self.planner else self.layout

    @property
    def sample_of_all(self) -> Sample:
        """The mean over all runs with its error."""
        return Sample(self.mean_of_all, self.error_of_all, self.runs)


class Peak(NamedTuple):
    """The most a layout moves, and the number of agents that moves it (Figure 18)."""

    layout: str  # its name
    rows: int  # its rows
    cols: int  # its columns
    agents: int  # where the mean throughput peaks, the maximum scalability of section E.3
    throughput: float  # the peak: tasks per timestep, averaged over all runs, congested ones too
    success_rate: float  # of the runs at the peak
    # throughput did not rise at the next number of agents; False where no larger one was tried, so
    # that the true peak may lie higher
    dropped: bool


class Trial(NamedTuple):
    """The simulations that each layout of a study goes through."""

    tasks: TaskRule | None  # what the agents do; None if the domain has no fleet
    config: FleetConfig  # settings of a simulation; its own number of agents is ignored
    counts: Sequence[int]  # numbers of agents
    seeds: Sequence[int]  # of the runs with each number of agents
    planner: str = ""  # see `Row`


def compare(
    floors: Mapping[str, Floor | np.ndarray],
    trial: Trial,
    on_row: Callable[[Row], None] = lambda row: None,
    progress: Progress = silent,
) -> list[Row]:
    """Simulate floors, or layouts alone, by name: the same numbers of agents, the same seeds.

    Return a row for each layout and number of agents, layout by layout; `on_row` is called with
    each when it is finished. Raises InputError, before the first run, if agents cannot work on a
    layout, which it names.
    """
    for name, floor in floors.items():
        with about(name):
            fleet_tasks(Floor.of(floor).layout, trial.tasks, max(trial.counts))
    trial = trial._replace(config=replace(trial.config, agents=max(trial.counts)))
    total = len(floors) * sum(trial.counts)  # a run's cost grows with its agents
    rows: list[Row] = []
    for (name, floor), agents in product(floors.items(), trial.counts):

        def report(
            doing: str, share: float, note: str, name: str = name, agents: int = agents
        ) -> None:
            done = (sum(row.agents for row in rows) + agents * max(share, 0.0)) / total
            progress("simulating", done, f"{name}, {agents} agents, {note or doing}")

        rows.append(_simulate(name, floor, agents, trial, report))
        on_row(rows[-1])
    return rows


def climb(
    name: str,
    floor: Floor | np.ndarray,
    trial: Trial,
    on_row: Callable[[Row], None] = lambda row: None,
    progress: Progress = silent,
) -> list[Row]:
    """Add agents until the mean throughput over all runs drops (section E.3).

    Of the trial's numbers those that fit are tried, in ascending order. Return a row for each;
    `find_peak` reads them. Raises InputError as `check_climb` does.
    """
    fitting = check_climb(name, floor, trial)
    rows: list[Row] = []
    for count in fitting:
        # No program is larger than the layout needs: its tables grow with its agents.
        config = replace(trial.config, agents=min(choose_capacity(count), fitting[-1]))

        def report(doing: str, share: float, note: str, count: int = count) -> None:
            progress(f"adding agents to {name}", -1, f"{count} agents, {note or doing}")

        rows.append(_simulate(name, floor, count, trial._replace(config=config), report))
        on_row(rows[-1])
        if find_peak(rows).dropped:
            break
    return rows


def check_climb(name: str, floor: Floor | np.ndarray, trial: Trial) -> list[int]:
    """Return the numbers of agents that fit on a layout, in ascending order.

    Raises InputError if agents cannot work on the layout, or not even the smallest number fits.
    """
    tasks, counts, layout = trial.tasks, trial.counts, Floor.of(floor).layout
    with about(name):
        tasks = fleet_tasks(layout, tasks, min(counts))
    free = of_tiles(layout, tasks.traversable, tasks.tiles).sum()
    return [count for count in sorted(counts) if count <= free]


def choose_capacity(agents: int) -> int:
    """Choose the capacity, in agents, of the program that simulates this number of agents.

    Capacities double: few programs are compiled, and none is much too large.
    """
    return max(_MIN_CAPACITY, 1 << (agents - 1).bit_length())


def _simulate(
    name: str, floor: Floor | np.ndarray, agents: int, trial: Trial, progress: Progress
) -> Row:
    """Run the seeds with one number of agents; ``trial.config.agents`` sizes the program."""
    from qdenv.study.engine import run_seeds  # imports the simulator

    tasks, config, _, seeds, planner = trial
    done = run_seeds(floor, tasks, config, seeds, agents, progress=progress)
    stop = config.stop_when_congested
    row = summarise(name, Floor.of(floor).layout, agents, done.runs, done.cpu_seconds, stop)
    return row._replace(
        planner=planner,
        each=tuple(
            Run(int(seed), float(run.throughput), bool(run.congested))
            for seed, run in zip(seeds, done.runs, strict=True)
        ),
    )


def summarise(
    name: str,
    layout: np.ndarray,
    agents: int,
    runs: Sequence[Traffic],
    cpu_seconds: float,
    stop: bool = True,
) -> Row:
    """Condense the runs of one layout with one number of agents, one per seed.

    `cpu_seconds` are those of all of them together; `stop`: congestion ended those that congested.
    """
    # In the runs' single precision, as the numbers of saved tables are.
    every = np.array([run.throughput for run in runs])
    flowed = np.array([not run.congested for run in runs])
    good = every[flowed] if stop else every
    successes = int(flowed.sum())
    low, high = wilson_interval(successes, len(runs))
    return Row(
        layout=name,
        rows=layout.shape[0],
        cols=layout.shape[1],
        agents=agents,
        runs=len(runs),
        throughput=float(good.mean()) if len(good) else float("nan"),
        standard_error=sample_of(good).error if len(good) else float("nan"),
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
    # The first of equal ones: fewer agents that move as much are better.
    top = int(np.argmax(means))
    at = rows[top]
    dropped = top < len(rows) - 1
    return Peak(at.layout, at.rows, at.cols, at.agents, means[top], at.success_rate, dropped)


def value_of_an_agent(fewer: tuple[int, float], more: tuple[int, float]) -> float:
    """Compare what a further agent brings with what one brings on average.

    The elasticity of throughput to the number of agents: 1 without any hindrance, 0 at the peak.
    Both arguments are a number of agents with its throughput.
    """
    added = (more[1] - fewer[1]) / (more[0] - fewer[0])
    return added / (fewer[1] / fewer[0]) if fewer[1] else 0.0


def find_capacity(rows: Sequence[Row]) -> int:
    """Return the number of agents up to which every further one is worth it (see `WORTH`).

    The rows are of one layout, sorted by agents.
    """
    points = [(row.agents, row.mean_of_all) for row in rows]
    for fewer, more in pairwise(points):
        if value_of_an_agent(fewer, more) < WORTH:
            return fewer[0]
    return points[-1][0]


def differences(rows: Sequence[Row]) -> list[Difference]:
    """Compare each row with that of the first layout at the same number of agents.

    Of several planners, with that of the first planner on the same layout, seed by seed. Over all
    runs, congested ones too: to leave them out would favour a layout that congests. The first
    one's own rows differ by 0 from themselves, without an interval.
    """
    begin, itself = rows[0], Difference(0.0, float("nan"), float("nan"), False)
    if begin.planner:
        firsts = {(row.layout, row.agents): row for row in rows if row.planner == begin.planner}
        pairs = [(row, firsts[row.layout, row.agents]) for row in rows]
        return [
            itself
            if row is first
            else paired_difference(*([run.throughput for run in one.each] for one in (row, first)))
            for row, first in pairs
        ]
    first = {row.agents: row.sample_of_all for row in rows if row.layout == begin.layout}
    return [
        itself if row.layout == begin.layout else difference(row.sample_of_all, first[row.agents])
        for row in rows
    ]


def decide(ours: Row, theirs: Row) -> dict[str, Any]:
    """Compare two layouts at one number of agents, over all runs: in numbers, and in a sentence."""
    apart = difference(ours.sample_of_all, theirs.sample_of_all)
    subject, other = ours.layout, f"{theirs.layout} at {ours.agents} robots"

    def more(percent: float) -> str:
        # With few runs an interval may reach below nothing at all.
        return f"{percent:.1f} % more" if percent > 0 else f"{min(-percent, 100.0):.1f} % less"

    low, high = sorted((abs(apart.low), abs(apart.high)))
    moves = f"{subject} moves {more(apart.percent)} than {other}"
    if np.isnan(apart.percent):
        sentence = f"{theirs.layout} moves nothing at {ours.agents} robots"
        sentence += f", {subject} {ours.mean_of_all:.2f} tasks per timestep"
    elif not apart.percent:
        sentence = f"{subject} moves as much as {other}"
    elif np.isnan(apart.low):
        sentence = f"{moves} (too few runs to be sure)"
    elif apart.significant:
        sentence = f"{moves} (95 %: {low:.1f} to {high:.1f} %)"
    else:
        interval = f"(95 %: {more(apart.low)} to {more(apart.high)})"
        sentence = f"{moves}, which may be chance {interval}"
    facts = {"layout": subject, "against": theirs.layout, "agents": ours.agents}
    return {**facts, **apart._asdict(), "sentence": sentence}


def write_rows(
    path: Path, rows: Sequence[Row], columns: Mapping[str, Sequence[Any]] | None = None
) -> None:
    """Write rows as CSV with further columns by name, an entry for each row in each.

    Raises InputError if the place cannot be written to.
    """
    left_out = ["each"] + ["planner"] * (not rows[0].planner)
    names = [name for name in Row._fields if name not in left_out]
    table = {name: [getattr(row, name) for row in rows] for name in names} | dict(columns or {})
    _write(path, list(table), zip(*table.values(), strict=True))


def write_runs(path: Path, rows: Sequence[Row]) -> None:
    """Write a line for each run of each row as CSV.

    Raises InputError if the place cannot be written to.
    """
    head = ("layout", *["planner"] * bool(rows[0].planner), "agents", *Run._fields)
    lines = [(row.layout, row.planner, row.agents, *run) for row in rows for run in row.each]
    _write(path, head, ([one for one in line if one != ""] for line in lines))


def _write(path: Path, head: Sequence[str], lines: Iterable[Sequence[Any]]) -> None:
    """Write lines of values."""
    # Six digits are more than any of these numbers means.
    rounded = [
        [float(f"{one:.6g}") if isinstance(one, float) else one for one in line] for line in lines
    ]
    write_csv(path, head, rounded)
