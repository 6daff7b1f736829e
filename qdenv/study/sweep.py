"""Layouts over numbers of agents: one by one, side by side, and up to their peaks."""

from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from qdenv.grid import of_tiles
from qdenv.progress import Progress, silent
from qdenv.simulate.mapf.settings import FleetConfig
from qdenv.study.options import fleet_tasks
from qdenv.study.table import Row, find_peak, summarise
from qdenv.types import InputError, TaskRule

# Agents of the smallest compiled program: below this a smaller one saves less than it costs to
# compile.
_MIN_CAPACITY = 64


class Trial(NamedTuple):
    """The simulations that each layout of a study goes through."""

    tasks: TaskRule | None  # what the agents do; None if the domain has no fleet
    config: FleetConfig  # settings of a simulation; its own number of agents is ignored
    counts: Sequence[int]  # numbers of agents
    seeds: Sequence[int]  # of the runs with each number of agents


def name_layouts(paths: Sequence[Path]) -> dict[str, Path]:
    """Name layout files briefly: by their stem where that is enough, else by their whole path."""
    stems = Counter(path.stem for path in set(paths))
    return {path.stem if stems[path.stem] == 1 else str(path): path for path in paths}


@contextmanager
def about(name: str) -> Iterator[None]:
    """Prefix the message of an `InputError` with the name of the layout."""
    try:
        yield
    except InputError as error:
        raise InputError(f"{name}: {error}") from error


def compare(
    layouts: Mapping[str, np.ndarray],
    trial: Trial,
    on_row: Callable[[Row], None] = lambda row: None,
    progress: Progress = silent,
) -> list[Row]:
    """Simulate layouts with the same numbers of agents and the same seeds.

    Args:
        layouts: int8 [H, W] each, by name; sizes may differ.
        trial: the simulations.
        on_row: called with each row when it is finished.
        progress: called with the share of the work that is done.

    Returns:
        a row for each layout and number of agents, layout by layout.

    Raises:
        InputError: agents cannot work on a layout, or do not fit; the message names the layout.
            Raised before the first run.
    """
    for name, layout in layouts.items():
        check_fleet(name, layout, trial.tasks, max(trial.counts))
    config = replace(trial.config, agents=max(trial.counts))
    rows: list[Row] = []
    total = len(layouts) * sum(trial.counts)  # a run's cost grows with its agents
    for name, layout in layouts.items():
        for agents in trial.counts:
            before = sum(row.agents for row in rows)
            part = _part(progress, f"{name}, {agents} agents", before / total, agents / total)
            rows.append(_simulate(name, layout, agents, trial._replace(config=config), part))
            on_row(rows[-1])
    return rows


def _simulate(name: str, layout: np.ndarray, agents: int, trial: Trial, progress: Progress) -> Row:
    """Run the seeds with one number of agents; ``trial.config.agents`` sizes the program."""
    from qdenv.study.engine import run_seeds  # imports the simulator

    tasks, config, _, seeds = trial
    done = run_seeds(layout, tasks, config, seeds, agents, progress=progress)
    stop = config.stop_when_congested
    return summarise(name, layout, agents, done.runs, done.cpu_seconds, stop)


def check_fleet(name: str, layout: np.ndarray, tasks: TaskRule | None, agents: int) -> None:
    """Refuse what cannot be simulated.

    Raises:
        InputError: see `options.fleet_tasks`; the message names the layout.
    """
    with about(name):
        fleet_tasks(layout, tasks, agents)


def check_climb(name: str, layout: np.ndarray, trial: Trial) -> list[int]:
    """Return the numbers of agents that fit on a layout, in ascending order.

    Raises:
        InputError: agents cannot work on the layout, or not even the smallest number fits.
    """
    tasks, counts = trial.tasks, trial.counts
    free = layout.size if tasks is None else of_tiles(layout, tasks.traversable, tasks.tiles).sum()
    fitting = [count for count in sorted(counts) if count <= free]
    if not fitting:
        raise InputError(f"{name}: {min(counts)} agents do not fit on {free} free cells")
    check_fleet(name, layout, tasks, fitting[-1])
    return fitting


def _part(progress: Progress, state: str, before: float, size: float) -> Progress:
    """Report a part of a larger task: which share lies before it, and how large it is."""

    def report(doing: str, share: float, note: str) -> None:
        progress("simulating", before + size * max(share, 0.0), f"{state}, {note or doing}")

    return report


def choose_capacity(agents: int) -> int:
    """Choose the capacity, in agents, of the program that simulates this number of agents.

    Capacities double: few programs are compiled, and none is much too large.
    """
    return max(_MIN_CAPACITY, 1 << (agents - 1).bit_length())


def climb(
    name: str,
    layout: np.ndarray,
    trial: Trial,
    on_row: Callable[[Row], None] = lambda row: None,
    progress: Progress = silent,
) -> list[Row]:
    """Add agents until the mean throughput over all runs drops (section E.3).

    Args:
        name: of the layout.
        layout: int8 [H, W].
        trial: the simulations; its numbers of agents are tried in ascending order, those that do
            not fit are left out.
        on_row: called with each row when it is finished.
        progress: called with what is simulated; the share is -1, as the end is unknown.

    Returns:
        a row for each number of agents tried; `table.find_peak` reads them.

    Raises:
        InputError: agents cannot work on the layout, or not even the smallest number fits.
    """
    fitting = check_climb(name, layout, trial)
    rows: list[Row] = []
    for count in fitting:
        config = replace(trial.config, agents=min(choose_capacity(count), fitting[-1]))

        def report(doing: str, share: float, note: str, count: int = count) -> None:
            progress(f"adding agents to {name}", -1, f"{count} agents, {note or doing}")

        rows.append(_simulate(name, layout, count, trial._replace(config=config), report))
        on_row(rows[-1])
        if find_peak(rows).dropped:
            break
    return rows
