"""Layouts over numbers of agents: one by one, side by side, and up to their peaks."""

from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from qdenv.grid import of_tiles
from qdenv.simulate.mapf.goals import check_playable
from qdenv.simulate.mapf.settings import FleetConfig
from qdenv.study.table import Row, find_peak, summarise
from qdenv.types import InputError, TaskRule

FEWEST = 64  # agents that a compiled program has room for at least


class Trial(NamedTuple):
    """What layouts are put to: who drives on them, and how often.

    Attributes:
        tasks: what the agents do; None where no fleet drives.
        config: the numbers of a simulation; its own number of agents does not matter.
        counts: numbers of agents.
        seeds: of the runs with each number.
    """

    tasks: TaskRule | None
    config: FleetConfig
    counts: Sequence[int]
    seeds: Sequence[int]


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


def sweep(
    name: str,
    layout: np.ndarray,
    trial: Trial,
    progress: Callable[[Row], None] = lambda row: None,
) -> list[Row]:
    """Simulate a layout with several numbers of agents; compiles once.

    Args:
        name: of the layout.
        layout: int8 [H, W].
        trial: who drives, and how often.
        progress: told every finished row.

    Raises:
        InputError: agents cannot work on this layout, or do not fit; the line names the layout.
    """
    from qdenv.study.traffic import run_seeds  # imports the simulator

    tasks, counts = trial.tasks, trial.counts
    config = replace(trial.config, agents=max(counts))
    rows = []
    with about(name):
        if tasks is not None:
            check_playable(layout, tasks, max(counts))
        for agents in counts:
            done = run_seeds(layout, tasks, config, trial.seeds, agents)
            rows.append(summarise(name, layout, agents, done.runs, done.cpu_seconds))
            progress(rows[-1])
    return rows


def compare(
    layouts: Mapping[str, np.ndarray],
    trial: Trial,
    progress: Callable[[Row], None] = lambda row: None,
) -> list[Row]:
    """Simulate layouts with the same numbers of agents and the same seeds.

    Args:
        layouts: int8 [H, W] each, by name; sizes may differ. The other arguments, and what may
            go wrong, are those of `sweep`.
        trial: who drives, and how often.
        progress: told every finished row.

    Returns:
        a row for each layout and number of agents, layout by layout.
    """
    return [row for name, layout in layouts.items() for row in sweep(name, layout, trial, progress)]


def climb(
    name: str,
    layout: np.ndarray,
    trial: Trial,
    progress: Callable[[Row], None] = lambda row: None,
) -> list[Row]:
    """Add agents until the mean throughput over all runs drops (section E.3).

    Args:
        name: of the layout.
        layout: int8 [H, W].
        trial: who drives, and how often; its numbers of agents are tried from few to many, those
            that do not fit are left out.
        progress: told every finished row.

    Returns:
        a row for each number of agents tried; `table.find_peak` reads them.

    Raises:
        InputError: agents cannot work on the layout, or not even the first number fits.
    """
    from qdenv.study.traffic import run_seeds  # imports the simulator

    tasks, counts = trial.tasks, trial.counts
    free = layout.size if tasks is None else of_tiles(layout, tasks.traversable, tasks.tiles).sum()
    fitting = [count for count in sorted(set(counts)) if count <= free]
    if not fitting:
        raise InputError(f"{name}: {min(counts)} agents do not fit on {free} free cells")
    rows: list[Row] = []
    for count in fitting:
        # Programs for fleets that double in size: few to compile, none much too large.
        room = max(FEWEST, 1 << (count - 1).bit_length())
        config = replace(trial.config, agents=min(room, fitting[-1]))
        with about(name):
            done = run_seeds(layout, tasks, config, trial.seeds, count)
        rows.append(summarise(name, layout, count, done.runs, done.cpu_seconds))
        progress(rows[-1])
        if find_peak(rows).dropped:
            break
    return rows
