"""Whole runs on the host: jax's buffers in, compiled host code, jax's buffers out."""

import contextlib
from collections.abc import Iterator
from typing import Any

import jax
import numpy as np
from jax.experimental.buffer_callback import buffer_callback

from qdenv.simulate.mapf.host.distances import empty_fields, make_room
from qdenv.simulate.mapf.host.state import HostRun, RunSettings, make_run, place_agents
from qdenv.simulate.mapf.host.windows import DONE, FIELDS_FULL, make_fallback
from qdenv.simulate.mapf.metrics import Outcome
from qdenv.simulate.mapf.planner import HostPlanner, World

_SPARE_ROWS = 64  # fields of distances for more goals than two per agent


def simulate_in_callback(
    planner: HostPlanner,
    world: World,
    seed: jax.Array,
    agents: jax.Array,
    settings: RunSettings,
    like: Outcome,
) -> Outcome:
    """Run a simulation in a callback that works on jax's own buffers.

    Args:
        planner: plans the paths.
        world: the layout.
        seed: uint32, of all that is drawn.
        agents: int32, number of agents.
        settings: of the run, but for the seed.
        like: the shapes of what is returned.
    """

    def on_host(_: Any, *buffers: Any) -> None:
        # Only numpy here: a jax call inside a callback can wait for the very device it blocks.
        outcome, world, seed, agents = jax.tree.map(np.asarray, buffers)
        simulate_into(outcome, planner, world, int(agents), settings._replace(seed=int(seed)))

    result: Outcome = buffer_callback(on_host, like, vmap_method="sequential")(world, seed, agents)
    return result


def simulate_into(
    outcome: Any, planner: HostPlanner, world: World, agents: int, settings: RunSettings
) -> None:
    """Run a simulation and write what happens into the numpy arrays of an `Outcome`.

    Args:
        outcome: all zeros, of the shapes that `fleet.blank_outcome` gives.
        planner: plans the paths.
        world: of numpy arrays.
        agents: number of agents.
        settings: of the run, its seed among them.
    """
    run = make_run(world, settings, agents, outcome.block)
    if world.valid:
        place_agents(run)
        outcome.start[:agents] = run.agents.position
        with _under_way(run):
            run_to_the_end(planner, run, world.traversable.shape)
    metrics, counters = outcome.metrics, run.counters
    metrics.time[...], metrics.congested_at[...] = counters.time, counters.congested_at
    metrics.moves[...] = counters.moves
    metrics.finished[...], metrics.visits[...] = counters.finished, counters.visits
    outcome.heading[:agents] = run.grid.goals[run.agents.goal[0]]


def run_to_the_end(planner: HostPlanner, run: HostRun, shape: tuple[int, ...]) -> None:
    """Drive a run whose agents have been placed, on a padded grid [H', W'].

    A window for which a buffer is too small is planned again with a larger one.
    """
    goals, agents = run.grid.goals.size, run.agents.position.size
    fields = empty_fields((shape[0], shape[1]), goals, min(goals, 2 * agents + _SPARE_ROWS))
    fallback, size = make_fallback(run, planner.fallback_waits), 1
    plan = planner.make_plan(run, size)
    while (status := planner.run_windows(run, fields, plan, fallback)) != DONE:
        if status == FIELDS_FULL:
            fields = make_room(fields, run.agents.goal.reshape(-1))
        else:
            size *= 2
            plan = planner.make_plan(run, size)


_runs: dict[int, HostRun] = {}  # those that are being driven now, in any thread


@contextlib.contextmanager
def _under_way(run: HostRun) -> Iterator[None]:
    """Let others see how far a run is."""
    _runs[id(run)] = run
    try:
        yield
    finally:
        del _runs[id(run)]


def steps_under_way() -> int:
    """Count the timesteps driven so far by all runs of this process that have not ended yet."""
    return sum(int(run.counters.time) for run in list(_runs.values()))
