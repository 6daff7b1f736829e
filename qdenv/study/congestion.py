"""Where a fleet waits: cell by cell, from the recordings of its runs, in plain numpy."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from qdenv.stats import standard_error
from qdenv.types import Traffic

if TYPE_CHECKING:
    from qdenv.simulate.mapf.metrics import Recording

FADING = 0.05  # throughput that falls by more than this is no chance, nor for long
_DOUBT = 3.0  # standard errors by which it must fall, were tasks finished independently


class Maps(NamedTuple):
    """What happened on each cell of a layout; of one run, or the mean of several.

    Waiting is a timestep without a move anywhere but on the agent's own goal: time that is spent
    being served there is work.
    """

    usage: np.ndarray  # [H, W], agents on the cell, averaged over time
    # [H, W], agents that wait there, averaged over time: the share of time in which one does, as a
    # cell holds one agent
    waiting: np.ndarray
    visits: np.ndarray  # [H, W], agents that come to the cell, per timestep
    # [H, W], tasks finished there per timestep of the whole T; throughput in all
    finished: np.ndarray
    agents: float  # how many take part

    @property
    def waiting_share(self) -> float:
        """Say which share of all the agents' time is spent waiting."""
        return float(self.waiting.sum() / max(self.agents, 1))


class Spot(NamedTuple):
    """A cell where agents wait."""

    row: int  # of the cell, from 0 at the top
    column: int  # of the cell, from 0 at the left
    tile: int  # index of what lies there
    share: float  # of all waiting, in 0 to 1
    waiting: float  # share of time in which an agent waits there
    wait_per_visit: float  # timesteps that an agent waits there each time it comes by


def map_run(shape: tuple[int, int], run: Traffic, recording: Recording) -> Maps:
    """Count what happened on each cell in one run.

    Args:
        shape: rows and columns of the layout.
        run: what the simulator reported; only the timesteps it drove count.
        recording: of the same run.
    """
    end, active = int(run.end_timestep), np.asarray(recording.active)
    positions = np.asarray(recording.positions)[: end + 1, active]
    goals = np.asarray(recording.goals)[:end, active]
    finished = np.asarray(recording.finished)[:end, active]
    before, after = positions[:-1], positions[1:]
    still = before == after

    def count(cells: np.ndarray) -> np.ndarray:
        return np.bincount(cells, minlength=shape[0] * shape[1]).reshape(shape) / max(end, 1)

    return Maps(
        usage=count(after.reshape(-1)),
        waiting=count(after[still & (after != goals)]),
        visits=count(np.concatenate([positions[0], after[~still]])),
        finished=count(after[finished]) * end / len(np.asarray(run.finished)),
        agents=float(active.sum()),
    )


def average(maps: Sequence[Maps]) -> Maps:
    """Average the maps of several runs."""
    return Maps(*(np.mean(part, axis=0) for part in zip(*maps, strict=True)))


def worst_cells(layout: np.ndarray, maps: Maps, most: int = 10) -> list[Spot]:
    """List the cells with the most waiting, the worst first; none where no agent waits.

    Args:
        layout: int8 [H, W].
        maps: of the runs.
        most: how many to list.
    """
    waiting, total = maps.waiting.reshape(-1), maps.waiting.sum()
    worst = np.argsort(-waiting, kind="stable")[:most]
    visits, tiles = maps.visits.reshape(-1), np.asarray(layout).reshape(-1)
    return [
        Spot(
            row=int(cell // layout.shape[1]),
            column=int(cell % layout.shape[1]),
            tile=int(tiles[cell]),
            share=float(waiting[cell] / total),
            waiting=float(waiting[cell]),
            wait_per_visit=float(waiting[cell] / visits[cell]),
        )
        for cell in worst
        if waiting[cell] > 0
    ]


def cells_with_half(maps: Maps) -> int:
    """Count the fewest cells that together hold half of all waiting; 0 where no agent waits."""
    ordered = np.sort(maps.waiting.reshape(-1))[::-1].cumsum()
    return int(np.searchsorted(ordered, ordered[-1] / 2)) + 1 if ordered[-1] > 0 else 0


def throughput_over_time(runs: Sequence[Traffic], windows: int = 40) -> np.ndarray:
    """Average finished tasks per timestep over equal windows of time.

    Args:
        runs: of one length T.
        windows: how many at most; each is a whole number of timesteps.

    Returns:
        [3, n]: where each window ends, the mean over the runs, and its standard error (NaN for
        one run).
    """
    finished = np.stack([np.asarray(run.finished) for run in runs]).astype(float)
    steps = finished.shape[1]
    ends = np.unique(np.linspace(0, steps, min(windows, steps) + 1).astype(int))
    parts = np.add.reduceat(finished, ends[:-1], axis=1) / np.diff(ends)
    return np.stack([ends[1:], parts.mean(axis=0), standard_error(parts)])


def fading(runs: Sequence[Traffic]) -> float:
    """Say by which share of itself throughput falls while time goes on: a jam builds up.

    From the second quarter of the time to the last one, all runs together; the first one is spent
    setting out. 0 where the difference may be chance.
    """
    finished = np.sum([np.asarray(run.finished) for run in runs], axis=0)
    quarter = len(finished) // 4
    early, late = finished[quarter : 2 * quarter].sum(), finished[len(finished) - quarter :].sum()
    sure = early - late > _DOUBT * np.sqrt(early + late)
    return float(1 - late / early) if sure else 0.0
