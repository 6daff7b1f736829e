"""Lifelong multi-agent path finding: one simulation of a fleet on one layout.

Plan a window, drive its first steps, hand out new goals, plan again (RHCR, Li et al. 2021,
https://arxiv.org/abs/2005.07371; the rules are in `qdenv.simulate`). Everything that depends on
the layout is traced, so all layouts of one size share one compiled program.
"""

from collections.abc import Callable
from dataclasses import replace
from typing import NamedTuple

import chex
import jax
import jax.numpy as jnp
import numpy as np

from qdenv.grid import of_tiles
from qdenv.simulate.mapf import chance, tasks
from qdenv.simulate.mapf.agents import Fleet, agent_state, drive, look_ahead, place
from qdenv.simulate.mapf.distances import goal_distances
from qdenv.simulate.mapf.goals import service_times
from qdenv.simulate.mapf.host.run import simulate_in_callback, simulate_into
from qdenv.simulate.mapf.host.state import RunSettings
from qdenv.simulate.mapf.metrics import (
    Block,
    Metrics,
    Outcome,
    Recording,
    TrajectoryBuffer,
    accumulate,
    empty_metrics,
    is_congested,
    recording_of,
    summarise,
)
from qdenv.simulate.mapf.planner import World, pad, steps_type, unreachable
from qdenv.simulate.mapf.settings import PLANNERS, FleetConfig
from qdenv.types import Array, InputError, TaskRule, Traffic

_TABLE_BYTES = 1 << 27  # of a table of all distances; above, agents measure their own


def prepare(layout: Array, rule: TaskRule, config: FleetConfig) -> World:
    """Build what all runs on one layout share: goals, distances, walls.

    Args:
        layout: int8 [H, W].
        rule: what the agents do.
        config: the numbers of the simulation.

    Raises:
        InputError: the window, or a stay at a goal, is longer than the planner understands.
    """
    chex.assert_rank(layout, 2)
    chex.assert_type(layout, int)
    planner, service_time = config.make_planner(), service_times(rule)
    if config.window > planner.max_window:
        raise InputError(
            f"the planner {PLANNERS.name_of(config.planner)!r} plans at most {planner.max_window} "
            f"timesteps ahead: choose a window of at most that, not {config.window}"
        )
    if service_time.max() > planner.max_service:
        raise InputError(
            f"the planner {PLANNERS.name_of(config.planner)!r} lets agents stay at a goal for at "
            f"most {planner.max_service} timesteps, not {service_time.max()}: shorten the stay"
        )
    rows, cols = layout.shape
    capacity = config.goal_capacity or rows * cols
    traversable = jnp.asarray(of_tiles(layout, rule.traversable, rule.tiles))
    goals = tasks.goal_table(layout, rule, capacity)
    distance, entry = None, np.dtype(steps_type(layout.size))
    if not planner.on_host and capacity * layout.size * entry.itemsize <= _TABLE_BYTES:
        used = goals.used & traversable.reshape(-1)[goals.cells]
        distance = goal_distances(traversable, goals.cells, used).reshape(capacity, rows, cols)
        sides, far = (planner.margin, planner.margin), unreachable(layout.size)
        distance = jnp.pad(distance, ((0, 0), sides, sides), constant_values=far)
        distance = distance.reshape(capacity, -1)
    return World(
        traversable=jnp.pad(traversable, planner.margin),
        goals=goals._replace(cells=pad(goals.cells, cols, planner.margin)),
        distance=distance,
        service_time=jnp.asarray(service_time),
        valid=goals.complete,
        margin=planner.margin,
    )


def _run_window(
    world: World,
    config: FleetConfig,
    fleet: Fleet,
    active: jax.Array,
    seed: jax.Array,
    time: jax.Array,
) -> tuple[Fleet, Block]:
    """Plan the window that begins at `time` and drive its first steps."""
    fleet = look_ahead(world, fleet)._replace(legs=jnp.zeros_like(fleet.legs))
    state = agent_state(world, fleet, active)
    key = chance.key_of(chance.draw(seed, chance.PLANS), time)
    plan = config.make_planner().plan
    assert plan is not None  # else runs are computed on the host
    paths = plan(world, state, config.horizon, key)
    chex.assert_shape(paths, (config.window + 1, config.agents))
    goals = chance.draw(seed, chance.GOALS)

    def step(fleet: Fleet, inputs: tuple[jax.Array, jax.Array]) -> tuple[Fleet, Block]:
        heading = world.goals.cells[fleet.goal[0]]
        drawn = chance.draw(goals, inputs[1])
        fleet, finished = drive(world, fleet, inputs[0], active, drawn)
        return fleet, Block(fleet.position, fleet.remaining_service, finished, heading)

    times = time + jnp.arange(config.horizon)
    fleet, block = jax.lax.scan(step, fleet, (paths[1 : config.horizon + 1], times))
    last = jnp.broadcast_to(paths[-1], (config.horizon, config.agents))
    return fleet._replace(previous=jnp.concatenate([paths[config.horizon :], last])), block


class _Run(NamedTuple):
    """A simulation under way."""

    fleet: Fleet  # the agents now
    metrics: Metrics  # what was counted so far
    # what was recorded so far; without room where nothing shall be recorded
    buffer: TrajectoryBuffer


def blank_outcome(world: World, config: FleetConfig, keep: bool) -> Outcome:
    """Make room for what a run leaves behind, all zeros.

    Args:
        world: where it runs.
        config: the numbers.
        keep: room for every step.
    """
    windows = -(-config.timesteps // config.horizon) * config.horizon
    nowhere = jnp.zeros((config.agents,), jnp.int32)
    buffer = TrajectoryBuffer.empty(nowhere, windows if keep else 0)
    return Outcome(empty_metrics(world, windows), nowhere, buffer)


def run_settings(config: FleetConfig, seed: int = 0) -> RunSettings:
    """List what host code needs to know of a simulation."""
    return RunSettings(
        seed, config.timesteps, config.window, config.horizon, config.stop_when_congested
    )


def _run(
    world: World, seed: jax.Array, config: FleetConfig, active: jax.Array, keep: bool
) -> Outcome:
    """Simulate until T or congestion, keeping every step if asked."""
    planner = config.make_planner()
    if planner.host is not None:
        like = jax.eval_shape(lambda: blank_outcome(world, config, keep))
        settings = run_settings(config)
        return simulate_in_callback(planner.host, world, seed, active.sum(), settings, like)
    metrics, _, buffer = blank_outcome(world, config, keep)
    fleet = place(world, config.window, active, seed)

    def going(run: _Run) -> jax.Array:
        halted = (run.metrics.congested_at > 0) & config.stop_when_congested
        return world.valid & (run.metrics.time < config.timesteps) & ~halted

    def window(run: _Run) -> _Run:
        fleet, metrics, buffer = run
        at_work = active & going(run)  # a finished lane of a batch has nobody left to plan
        after, block = _run_window(world, config, fleet, at_work, seed, metrics.time)
        # A window that T cuts short is no window of the jam rule.
        whole = metrics.time + config.horizon <= config.timesteps
        jam = whole & is_congested(fleet.position, fleet.remaining_service, block, active)
        buffer = buffer.store(block, metrics.time)
        metrics = accumulate(metrics, fleet.position, block, active, config.timesteps)
        first = jam & (metrics.congested_at == 0)
        since = jnp.where(first, metrics.time, metrics.congested_at)
        return _Run(after, metrics._replace(congested_at=since), buffer)

    begin = _Run(fleet, metrics, buffer._replace(start=fleet.position))
    last = jax.lax.while_loop(going, window, begin)
    return Outcome(last.metrics, world.goals.cells[last.fleet.goal[0]], last.buffer)


def _select_active_agents(
    world: World, config: FleetConfig, agents: Array | None
) -> tuple[World, jax.Array]:
    """Choose who takes part (bool [A]); without room for them the world is not valid."""
    chex.assert_rank(world.traversable, 2)
    asked = jnp.asarray(config.agents if agents is None else agents)
    chex.assert_rank(asked, 0)
    room = (world.traversable.sum() >= asked) & (asked <= config.agents)
    return replace(world, valid=world.valid & room), jnp.arange(config.agents) < asked


def simulate(
    world: World, key: jax.Array, config: FleetConfig, agents: Array | None = None
) -> Traffic:
    """Run one simulation until T, or until it congests.

    Args:
        world: from `prepare`, with the same config.
        key: consumed; decides starts, goals and ties.
        config: the numbers.
        agents: how many agents take part (traced, at most ``config.agents``); None for all.

    Returns:
        `Traffic`. A layout with too few free cells or without goals counts as congested at once.
    """
    world, active = _select_active_agents(world, config, agents)
    outcome = _run(world, chance.seed_of(key), config, active, keep=False)
    return summarise(world, outcome.metrics, active, config.timesteps)


def record(
    world: World, key: jax.Array, config: FleetConfig, agents: Array | None = None
) -> tuple[Traffic, Recording]:
    """Run the same simulation as `simulate` and keep every step of it."""
    world, active = _select_active_agents(world, config, agents)
    return report(world, config, _run(world, chance.seed_of(key), config, active, True), active)


def report(
    world: World, config: FleetConfig, outcome: Outcome, active: jax.Array
) -> tuple[Traffic, Recording]:
    """Turn what a recorded run left behind into the records that others read."""
    recording = recording_of(outcome, active, world, config.timesteps)
    return summarise(world, outcome.metrics, active, config.timesteps), recording


def compile_runs(
    world: World, config: FleetConfig, keep: bool
) -> Callable[[World, int, int], tuple[Traffic, Recording | None]]:
    """Compile whole runs on layouts of one size, (world, seed, agents) -> traffic and recording.

    On the host only what turns the outcome into records is a program of XLA's: what XLA compiles
    around a callback it forgets with the process. The worlds are of numpy arrays there.

    Args:
        world: from `prepare`, or its shapes.
        config: the numbers.
        keep: keep every step; else the recording is None.
    """
    host, count = config.make_planner().host, jax.ShapeDtypeStruct((), np.int32)

    def finish(world: World, outcome: Outcome, agents: Array) -> tuple[Traffic, Recording | None]:
        world, active = _select_active_agents(world, config, agents)
        if keep:
            return report(world, config, outcome, active)
        return summarise(world, outcome.metrics, active, config.timesteps), None

    if host is None:

        def whole(world: World, key: jax.Array, agents: Array) -> tuple[Traffic, Recording | None]:
            able, active = _select_active_agents(world, config, agents)
            outcome = _run(able, chance.seed_of(key), config, active, keep)
            return finish(world, outcome, agents)

        program = jax.jit(whole).lower(world, jax.random.key(0), count).compile()
        return lambda world, seed, agents: program(world, jax.random.key(seed), np.int32(agents))

    shapes = jax.eval_shape(lambda: blank_outcome(world, config, keep))
    program = jax.jit(finish).lower(world, shapes, count).compile()

    def run(world: World, seed: int, agents: int) -> tuple[Traffic, Recording | None]:
        outcome = jax.tree.map(lambda leaf: np.zeros(leaf.shape, leaf.dtype), shapes)
        # Too many agents for the layout: nobody drives, and the report calls that congested.
        if agents <= min(int(np.asarray(world.traversable).sum()), config.agents):
            settings = run_settings(config, int(chance.seed_of(jax.random.key(seed))))
            simulate_into(outcome, host, world, agents, settings)
        return program(world, outcome, np.int32(agents))

    return run
