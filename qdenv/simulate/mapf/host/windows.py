"""The one loop of all planners on the host: plan a window, fall back where needed, drive it."""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from qdenv.native import formula, kernel
from qdenv.simulate.mapf import chance
from qdenv.simulate.mapf.host.distances import DistanceFields
from qdenv.simulate.mapf.host.state import HostRun, drive_window, is_going
from qdenv.simulate.mapf.pibt.numba import Rollout, make_rollout, roll_out

# What `plan_window` and a whole run end with: done, or a buffer that was too small.
DONE, FIELDS_FULL, PLAN_FULL = range(3)


class Fallback(NamedTuple):
    """The paths of a window: as planned, or those of a joint plan that never has conflicts."""

    path: np.ndarray  # int64 [A, w + 1], as planned; conflicts of agents that fall back are allowed
    is_used: np.ndarray  # bool [A], who follows the rollout instead; `plan_window` sets all entries
    rollout: Rollout  # h steps of all agents by PIBT
    queue: np.ndarray  # int64 [A], agents that fall back and may make others fall back
    waits: bool  # the rollout is to stand still, instead of PIBT's


def make_fallback(run: HostRun, waits: bool) -> Fallback:
    """Make the fallback of a run."""
    agents = run.agents.position.size
    return Fallback(
        np.zeros_like(run.agents.paths),
        np.zeros(agents, np.bool_),
        make_rollout(agents, run.settings.horizon, run.grid.free.size),
        np.zeros(agents, np.int64),
        waits,
    )


def compile_windows(plan_window: Callable[..., int]) -> Callable[..., int]:
    """Compile the loop over the windows of a run, (run, fields, plan, fallback) -> status.

    Args:
        plan_window: (run, fields, plan, fallback, seed) -> status; sets ``fallback.path`` and
            ``fallback.is_used`` and, unless it is `DONE`, changes nothing else of the run. A
            `native.shared` function, found by its name: the machine code is cached under the names
            that a closure holds, and one of a compiled function is another in each process.
    """

    def run_windows(run: HostRun, fields: DistanceFields, plan: Any, fallback: Fallback) -> int:
        plans = chance.mix(run.settings.seed, chance.PLANS)
        while is_going(run):
            seed = chance.mix(plans, run.counters.time[()])
            status = plan_window(run, fields, plan, fallback, seed)
            if status != DONE:
                return status
            if not _adopt(run, fields, fallback, seed):
                return FIELDS_FULL
            drive_window(run)
        return DONE

    # The cache of machine code watches the sources that a module imports: the planner's.
    run_windows.__module__ = plan_window.__module__
    return kernel(run_windows)


@kernel
def _adopt(run: HostRun, fields: DistanceFields, fallback: Fallback, seed: int) -> bool:
    """Make the window's paths those of the agents; returns False if the fields are full.

    Who falls back makes those fall back whose paths it would meet. Beyond the horizon the two
    kinds of path may conflict: that part is dropped.
    """
    horizon, paths, is_used = run.settings.horizon, run.agents.paths, fallback.is_used
    waiting, planned, last = 0, 0, paths.shape[1] - 1
    for agent in range(is_used.size):
        if is_used[agent]:
            fallback.queue[waiting] = agent
            waiting += 1
    if waiting > 0:
        last, planned = horizon, is_used.size - waiting
        roll_out(run, fields, fallback.rollout, seed, fallback.waits)
        if fields.is_full[()]:
            return False
    rollout = fallback.rollout.path
    while waiting > 0 and planned > 0:
        waiting -= 1
        agent = fallback.queue[waiting]
        for other in range(is_used.size):
            if not is_used[other] and _meet(rollout, agent, fallback.path, other, horizon):
                is_used[other] = True
                fallback.queue[waiting] = other
                waiting, planned = waiting + 1, planned - 1
    for agent in range(is_used.size):
        for t in range(paths.shape[1]):
            if is_used[agent]:
                paths[agent, t] = rollout[agent, min(t, horizon)]
            else:
                paths[agent, t] = fallback.path[agent, min(t, last)]
    return True


@formula
def _meet(mine: np.ndarray, one: int, theirs: np.ndarray, other: int, horizon: int) -> bool:
    """Return True if two agents meet or swap cells within the driven steps."""
    found = False
    for t in range(1, horizon + 1):
        meets = mine[one, t] == theirs[other, t]
        swaps = mine[one, t] == theirs[other, t - 1] and mine[one, t - 1] == theirs[other, t]
        found = found or meets or swaps
    return found
