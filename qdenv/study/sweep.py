"""What `qdenv sweep` does: throughput and success of one layout over numbers of agents."""

import csv
import io
from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from qdenv.files import write_atomically
from qdenv.score.traffic import wilson_interval
from qdenv.simulate.mapf.fleet import FleetConfig
from qdenv.simulate.mapf.tasks import check_playable
from qdenv.study.traffic import Simulated, run_seeds
from qdenv.types import InputError, TaskRule


def parse_counts(text: str) -> tuple[int, ...]:
    """Read numbers of agents: one ("200"), a list ("50,100") or a range ("50:400:50").

    The end of a range belongs to it.

    Raises:
        InputError: none of the three, or a count below one.
    """
    try:
        if ":" in text:
            first, last, *step = (int(part) for part in text.split(":"))
            counts = tuple(range(first, last + 1, *step))
        else:
            counts = tuple(int(part) for part in text.split(","))
    except (ValueError, TypeError):
        raise InputError(f"agents {text!r}: write 200, or 50,100, or 50:400:50") from None
    if not counts or min(counts) < 1:
        raise InputError(f"agents {text!r} holds no number of agents above zero")
    return counts


class SweepRow(NamedTuple):
    """One number of agents of a sweep; throughput is over the runs that never congested."""

    agents: int
    runs: int
    throughput: float
    standard_error: float
    success_rate: float
    success_low: float
    success_high: float
    mean_of_all: float
    cpu_seconds_per_run: float


def summarise(done: Simulated, agents: int) -> SweepRow:
    """Condense the runs with one number of agents to a row of the table."""
    good = np.array([run.throughput for run in done.runs if not run.congested])
    runs = len(done.seeds)
    error = float(good.std(ddof=1) / np.sqrt(len(good))) if len(good) > 1 else float("nan")
    return SweepRow(
        agents,
        runs,
        float(good.mean()) if len(good) else float("nan"),
        error,
        len(good) / runs,
        *wilson_interval(len(good), runs),
        float(np.mean([run.throughput for run in done.runs])),
        done.cpu_seconds / runs,
    )


def sweep(
    layout: np.ndarray,
    tasks: TaskRule | None,
    config: FleetConfig,
    counts: Iterable[int],
    seeds: Sequence[int],
    progress: Callable[[SweepRow], None] = lambda row: None,
) -> list[SweepRow]:
    """Simulate a layout with several numbers of agents; compiles once.

    Args:
        layout: int8 [H, W].
        tasks: what the agents do.
        config: the numbers; its own number of agents does not matter.
        counts: numbers of agents.
        seeds: of the runs with each number.
        progress: told every finished row.

    Raises:
        InputError: the fleet cannot work on this layout, or has no room on it.
    """
    counts = tuple(counts)
    config = replace(config, agents=max(counts))
    if tasks is not None:
        check_playable(layout, tasks, max(counts))
    rows = []
    for agents in counts:
        rows.append(summarise(run_seeds(layout, tasks, config, seeds, agents), agents))
        progress(rows[-1])
    return rows


def write_table(path: Path, rows: Sequence[SweepRow]) -> None:
    """Write a sweep as CSV, one line per number of agents."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(SweepRow._fields)
    writer.writerows(rows)
    write_atomically(path, text.getvalue().encode())
