"""Layouts against one another: side by side at equal numbers of agents, and up to their peaks."""

from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from qdenv.files import write_csv
from qdenv.grid import of_tiles
from qdenv.simulate.mapf.fleet import FleetConfig
from qdenv.study.sweep import SweepRow, summarise, sweep
from qdenv.study.traffic import run_seeds
from qdenv.types import InputError, TaskRule


class Compared(NamedTuple):
    """One layout at one number of agents."""

    layout: str
    rows: int
    cols: int
    traffic: SweepRow


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


def name_layouts(paths: Sequence[Path]) -> dict[str, Path]:
    """Name layout files briefly: by their stem where that is enough, else by their whole path."""
    stems = Counter(path.stem for path in set(paths))
    return {path.stem if stems[path.stem] == 1 else str(path): path for path in paths}


@contextmanager
def named(name: str) -> Iterator[None]:
    """Let a mistake's line begin with the layout it is about."""
    try:
        yield
    except InputError as error:
        raise InputError(f"{name}: {error}") from error


def compare(
    layouts: Mapping[str, np.ndarray],
    tasks: TaskRule | None,
    config: FleetConfig,
    counts: Sequence[int],
    seeds: Sequence[int],
    progress: Callable[[Compared], None] = lambda row: None,
) -> list[Compared]:
    """Simulate layouts with the same numbers of agents and the same seeds.

    Args:
        layouts: int8 [H, W] each, by name; sizes may differ.
        tasks: what the agents do.
        config: the numbers; its own number of agents does not matter.
        counts: numbers of agents.
        seeds: of the runs with each number.
        progress: told every finished row.

    Returns:
        a row for each layout and number of agents, layout by layout.

    Raises:
        InputError: agents cannot work on a layout, or do not fit; the line names the layout.
    """

    def one(name: str, layout: np.ndarray) -> list[Compared]:
        def tell(row: SweepRow) -> None:
            progress(Compared(name, *layout.shape, row))

        with named(name):
            rows = sweep(layout, tasks, config, counts, seeds, tell)
        return [Compared(name, *layout.shape, row) for row in rows]

    return [row for name, layout in layouts.items() for row in one(name, layout)]


def climb(
    name: str,
    layout: np.ndarray,
    tasks: TaskRule | None,
    config: FleetConfig,
    counts: Sequence[int],
    seeds: Sequence[int],
    progress: Callable[[Compared], None] = lambda row: None,
) -> list[Compared]:
    """Add agents until the mean throughput over all runs drops (section E.3).

    Args:
        name: of the layout.
        layout: int8 [H, W].
        tasks: what the agents do.
        config: the numbers; its own number of agents does not matter.
        counts: numbers of agents to try, from few to many; those that do not fit are left out.
        seeds: of the runs with each number.
        progress: told every finished row.

    Returns:
        a row for each number of agents tried; `find_peak` reads them.

    Raises:
        InputError: agents cannot work on the layout, or not even the first number fits.
    """
    free = layout.size if tasks is None else of_tiles(layout, tasks.traversable, tasks.tiles).sum()
    fitting = [count for count in sorted(set(counts)) if count <= free]
    if not fitting:
        raise InputError(f"{name}: {min(counts)} agents do not fit on {free} free cells")
    way: list[Compared] = []
    for count in fitting:
        # Programs for fleets that double in size: few to compile, none much too large.
        config = replace(config, agents=min(1 << max(6, (count - 1).bit_length()), fitting[-1]))
        with named(name):
            row = summarise(run_seeds(layout, tasks, config, seeds, count), count)
        way.append(Compared(name, *layout.shape, row))
        progress(way[-1])
        if find_peak(way).dropped:
            break
    return way


def find_peak(way: Sequence[Compared]) -> Peak:
    """Find the peak of one layout's rows, sorted by agents."""
    means = [row.traffic.mean_of_all for row in way]
    top = int(np.argmax(means))
    name, rows, cols, traffic = way[top]
    dropped = top < len(way) - 1
    return Peak(name, rows, cols, traffic.agents, means[top], traffic.success_rate, dropped)


def write_comparison(path: Path, rows: Sequence[Compared]) -> None:
    """Write layouts side by side as CSV, one line per layout and number of agents."""
    header = (*Compared._fields[:-1], *SweepRow._fields)
    write_csv(path, header, [(*row[:-1], *row.traffic) for row in rows])
