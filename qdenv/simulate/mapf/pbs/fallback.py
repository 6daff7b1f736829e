"""What becomes of a window without a solution: its best plan, but for those in conflict PIBT's."""

from typing import NamedTuple

import numpy as np

from qdenv.native import formula, kernel
from qdenv.simulate.mapf.pibt.numba import Rollout, make_rollout


class Resort(NamedTuple):
    """What agents do whose path cannot be driven; A agents."""

    rollout: Rollout  # a joint plan without conflicts
    falls: np.ndarray  # bool [A], who follows it
    waiting: np.ndarray  # int32 [A], those who fell and may make others fall


def make_resort(agents: int, horizon: int, cells: int) -> Resort:
    """Make room for a resort."""
    rollout = make_rollout(agents, horizon, cells)
    return Resort(rollout, np.zeros(agents, np.bool_), np.zeros(agents, np.int32))


@kernel
def choose_falls(resort: Resort, best: np.ndarray) -> None:
    """Let fall who conflicts within the driven steps, and then whoever is in the way of those.

    Args:
        resort: with its rollout; receives who falls.
        best: int32 [w + 1, A], a plan with conflicts; below zero where an agent has no path.
    """
    path, count = resort.rollout.path, 0
    horizon = path.shape[1] - 1
    for agent in range(path.shape[0]):
        resort.falls[agent] = False
    for agent in range(path.shape[0]):
        for t in range(1, horizon + 1):
            if best[t, agent] < 0:
                count = _fall(resort, agent, count)
        for other in range(agent):
            if _conflict(best, agent, best, other, horizon):
                count = _fall(resort, other, _fall(resort, agent, count))
    while count > 0:
        count -= 1
        agent = resort.waiting[count]
        for other in range(path.shape[0]):
            if not resort.falls[other] and _conflict(path.T, agent, best, other, horizon):
                count = _fall(resort, other, count)


@formula
def _fall(resort: Resort, agent: int, count: int) -> int:
    """Let an agent fall who did not yet; returns how many wait then."""
    if resort.falls[agent]:
        return count
    resort.falls[agent] = True
    resort.waiting[count] = agent
    return count + 1


@formula
def _conflict(mine: np.ndarray, one: int, theirs: np.ndarray, other: int, horizon: int) -> bool:
    """Tell whether two agents meet or swap cells within the driven steps."""
    found = False
    for t in range(1, horizon + 1):
        meets = mine[t, one] == theirs[t, other]
        swaps = mine[t, one] == theirs[t - 1, other] and mine[t - 1, one] == theirs[t, other]
        found = found or meets or swaps
    return found
