"""Whole runs on the host: plan a window, fall back where needed, drive it, until the end."""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from qdenv.native import kernel
from qdenv.simulation.mapf import chance
from qdenv.simulation.mapf.host.distances import DistanceFields, empty_fields, make_room
from qdenv.simulation.mapf.host.state import (
    HostRun,
    RunSettings,
    drive_window,
    make_run,
    paths_meet,
    place_agents,
)
from qdenv.simulation.mapf.pibt.numba import Rollout, make_rollout, roll_out
from qdenv.simulation.mapf.planner import NOBODY, Planner, World

_SPARE_ROWS = 64  # fields of distances for more goals than two per agent
# What `plan_window` and a whole run end with: done, or a buffer that was too small.
DONE, FIELDS_FULL, PLAN_FULL = range(3)


class Fallback(NamedTuple):
    """The paths of a window: as planned, or those of a joint plan that never has conflicts."""

    path: np.ndarray  # int64 [A, w + 1], as planned; conflicts of agents that fall back are allowed
    is_used: np.ndarray  # bool [A], who follows the rollout instead; `plan_window` sets all entries
    rollout: Rollout  # h steps of all agents by PIBT
    queue: np.ndarray  # int64 [A], agents that fall back and may make others fall back
    waits: bool  # the rollout is to stand still, instead of PIBT's
    swaps: bool | None  # agents of the rollout change places in passages; None if they do not


def compile_windows(plan_window: Callable[..., int]) -> Callable[..., int]:
    """Make the loop over the windows of a run, which numba compiles at its first call.

    `plan_window`, (run, fields, plan, fallback, seed) -> status, sets ``fallback.path`` and
    ``fallback.is_used`` and changes nothing else of the run. It is `native.shared`, found by its
    name: the machine code is cached under the names that a closure holds, and one of a compiled
    function is another in each process.
    """

    def run_windows(
        run: HostRun, fields: DistanceFields, plan: Any, fallback: Fallback, has_orders: bool | None
    ) -> int:
        counters, settings = run.counters, run.settings
        plans = chance.mix(settings.seed, chance.PLANS)
        while counters.time < settings.timesteps:
            seed = chance.mix(plans, counters.time)
            status = plan_window(run, fields, plan, fallback, seed)
            if status != DONE:
                return status
            if not _adopt(run, fields, fallback, seed):
                return FIELDS_FULL
            drive_window(run, has_orders)
            if counters.congested_at and settings.stop_when_congested:
                break
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
    horizon, paths, is_used = run.settings.horizon, run.paths, fallback.is_used
    waiting, planned, last = 0, 0, paths.shape[1] - 1
    for agent in range(is_used.size):
        if is_used[agent]:
            fallback.queue[waiting] = agent
            waiting += 1
    if waiting > 0:
        last, planned = horizon, is_used.size - waiting
        roll_out(run, fields, fallback.rollout, seed, fallback.waits, fallback.swaps)
        if fields.numbers.is_full:
            return False
    rollout = fallback.rollout.path
    while waiting > 0 and planned > 0:
        waiting -= 1
        agent = fallback.queue[waiting]
        for other in range(is_used.size):
            if not is_used[other] and paths_meet(rollout, agent, fallback.path, other, horizon):
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


runs_under_way: dict[int, HostRun] = {}  # those that are being driven now, in any thread


def simulate_into(
    outcome: Any, planner: Planner, world: World, agents: int, settings: RunSettings
) -> None:
    """Run a simulation of `agents` agents and write what happens into the arrays of an `Outcome`.

    These are all zeros, of the shapes that `fleet.blank_outcome` gives; all arrays are numpy's.
    """
    run = make_run(world, settings, agents, outcome.block)
    if world.valid:
        place_agents(run)
        outcome.start[:agents] = run.position
        runs_under_way[id(run)] = run
        try:
            run_to_the_end(planner, run)
        finally:
            del runs_under_way[id(run)]
    counted, counters = outcome.counters, run.counters
    counted.time[...], counted.congested_at[...] = counters.time, counters.congested_at
    counted.moves[...], counted.idle[...] = counters.moves, counters.idle
    counted.finished[...], counted.visits[...] = run.finished, run.visits
    headings = np.where(run.kind < len(run.grid.odds), run.grid.goals[run.goal[0]], NOBODY)
    outcome.heading[:agents] = headings
    if outcome.orders is not None:
        outcome.orders.waiting[...] = counters.waiting
        outcome.orders.begun[...], outcome.orders.waited[...] = counters.begun, run.waited[0]


def run_to_the_end(planner: Planner, run: HostRun) -> None:
    """Drive a run whose agents have been placed.

    A window for which a buffer is too small is planned again with a larger one.
    """
    grid, agents, size = run.grid, run.position.size, 1
    rows = min(grid.goals.size, 2 * agents + _SPARE_ROWS)
    shape = (grid.free.size // grid.width, grid.width)
    fields = empty_fields(shape, grid.goals.size, rows, has_costs=grid.costs.size > 0)
    fallback = Fallback(
        np.zeros_like(run.paths),
        np.zeros(agents, np.bool_),
        make_rollout(agents, run.settings.horizon, grid.free.size),
        np.zeros(agents, np.int64),
        planner.fallback_waits,
        planner.fallback_swaps or None,
    )
    plan = planner.make_plan(run, size)
    assert planner.run_windows is not None  # else runs are computed by XLA
    has_orders = grid.orders.size > 0 or None
    while (status := planner.run_windows(run, fields, plan, fallback, has_orders)) != DONE:
        if status == FIELDS_FULL:
            fields = make_room(fields, run.goal.reshape(-1))
        else:
            size *= 2
            plan = planner.make_plan(run, size)
