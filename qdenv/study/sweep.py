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

FEWEST = 64  # agents that a compiled program has room for at least


class Trial(NamedTuple):
    """What layouts are put to: who drives on them, and how often."""

    tasks: TaskRule | None  # what the agents do; None where no fleet drives
    config: FleetConfig  # the numbers of a simulation; its own number of agents does not matter
    counts: Sequence[int]  # numbers of agents
    seeds: Sequence[int]  # of the runs with each number


def name_layouts(paths: Sequence[Path]) -> dict[str, Path]:
    """Name layout files briefly: by their stem where that is enough, else by their whole path."""
    stems = Counter(path.stem for path in set(paths))
    return {path.stem if stems[path.stem] == 1 else str(path): path for path in paths}


@contextmanager
def about(name: str) -> Iterator[None]:
    """Let a mistake's line begin with the layout it is about."""
    try:
        yield
    except InputError as error:
        raise InputError(f"{name}: {error}") from error


def compare(
    layouts: Mapping[str, np.ndarray],
    trial: Trial,
    told: Callable[[Row], None] = lambda row: None,
    progress: Progress = silent,
) -> list[Row]:
    """Simulate layouts with the same numbers of agents and the same seeds.

    Args:
        layouts: int8 [H, W] each, by name; sizes may differ.
        trial: who drives, and how often.
        told: hears of every finished row.
        progress: hears how far it is.

    Returns:
        a row for each layout and number of agents, layout by layout.

    Raises:
        InputError: agents cannot work on a layout, or do not fit; the line names the layout. Before
            the first run.
    """
    from qdenv.study.engine import run_seeds  # imports the simulator

    for name, layout in layouts.items():
        check_fleet(name, layout, trial.tasks, max(trial.counts))
    config = replace(trial.config, agents=max(trial.counts))
    rows: list[Row] = []
    total = len(layouts) * sum(trial.counts)  # a run's cost grows with its agents
    for name, layout in layouts.items():
        for agents in trial.counts:
            before = sum(row.agents for row in rows)
            tell = _part(progress, f"{name}, {agents} agents", before / total, agents / total)
            done = run_seeds(layout, trial.tasks, config, trial.seeds, agents, progress=tell)
            stop = config.stop_when_congested
            rows.append(summarise(name, layout, agents, done.runs, done.cpu_seconds, stop))
            told(rows[-1])
    return rows


def check_fleet(name: str, layout: np.ndarray, tasks: TaskRule | None, agents: int) -> None:
    """Refuse what could not be simulated, before anything is.

    Raises:
        InputError: see `traffic.fleet_tasks`; the line names the layout.
    """
    with about(name):
        fleet_tasks(layout, tasks, agents)


def check_climb(name: str, layout: np.ndarray, trial: Trial) -> list[int]:
    """Choose the numbers of agents that fit a layout, few to many.

    Raises:
        InputError: agents cannot work on the layout, or not even the first number fits.
    """
    tasks, counts = trial.tasks, trial.counts
    free = layout.size if tasks is None else of_tiles(layout, tasks.traversable, tasks.tiles).sum()
    fitting = [count for count in sorted(counts) if count <= free]
    if not fitting:
        raise InputError(f"{name}: {min(counts)} agents do not fit on {free} free cells")
    check_fleet(name, layout, tasks, fitting[-1])
    return fitting


def _part(progress: Progress, state: str, before: float, size: float) -> Progress:
    """Report a part of a larger work: which share lies before it, and how large it is."""

    def tell(doing: str, share: float, note: str) -> None:
        progress("simulating", before + size * max(share, 0.0), f"{state}, {note or doing}")

    return tell


def room_for(agents: int) -> int:
    """Choose how many agents a program has room for that shall drive so many.

    Rooms double from one to the next: few programs to compile, none much too large.
    """
    return max(FEWEST, 1 << (agents - 1).bit_length())


def climb(
    name: str,
    layout: np.ndarray,
    trial: Trial,
    told: Callable[[Row], None] = lambda row: None,
    progress: Progress = silent,
) -> list[Row]:
    """Add agents until the mean throughput over all runs drops (section E.3).

    Args:
        name: of the layout.
        layout: int8 [H, W].
        trial: who drives, and how often; its numbers of agents are tried from few to many, those
            that do not fit are left out.
        told: hears of every finished row.
        progress: hears what is simulated; nobody knows how much will be.

    Returns:
        a row for each number of agents tried; `table.find_peak` reads them.

    Raises:
        InputError: agents cannot work on the layout, or not even the first number fits.
    """
    from qdenv.study.engine import run_seeds  # imports the simulator

    tasks, fitting = trial.tasks, check_climb(name, layout, trial)
    rows: list[Row] = []
    for count in fitting:
        config = replace(trial.config, agents=min(room_for(count), fitting[-1]))

        def tell(doing: str, share: float, note: str, count: int = count) -> None:
            progress(f"adding agents to {name}", -1, f"{count} agents, {note or doing}")

        done = run_seeds(layout, tasks, config, trial.seeds, count, progress=tell)
        stop = config.stop_when_congested
        rows.append(summarise(name, layout, count, done.runs, done.cpu_seconds, stop))
        told(rows[-1])
        if find_peak(rows).dropped:
            break
    return rows
