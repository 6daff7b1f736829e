"""Lifelong multi-agent path finding: one simulation of a fleet on one layout.

Plan a window, drive its first steps, hand out new goals, plan again (RHCR, Li et al. 2021,
https://arxiv.org/abs/2005.07371; the rules are in `qdenv.simulation`). Everything that depends on
the layout is traced, so all layouts of one size share one compiled program.
"""

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any, TypeAlias

import chex
import jax
import jax.numpy as jnp
import numpy as np
from jax.experimental.buffer_callback import buffer_callback

from qdenv.grid import NUM_MOVES, of_tiles, pad
from qdenv.simulation.mapf import chance
from qdenv.simulation.mapf.agents import FleetState, drive, hand_out, place
from qdenv.simulation.mapf.distances import goal_costs, goal_distances, measure_fields, rows_of
from qdenv.simulation.mapf.host.run import simulate_into
from qdenv.simulation.mapf.host.state import RunSettings
from qdenv.simulation.mapf.metrics import (
    Block,
    Counters,
    Orders,
    Outcome,
    Recording,
    accumulate,
    recording_of,
    summarise,
)
from qdenv.simulation.mapf.planner import (
    NOBODY,
    AgentState,
    World,
    distance_type,
    goal_table,
    move_of,
    next_kind,
)
from qdenv.simulation.mapf.settings import PLANNERS, FleetConfig, check_costs
from qdenv.types import Array, InputError, TaskRule, Traffic

_TABLE_BYTES = 1 << 27  # of a table of all distances; above, agents measure their own

_Report: TypeAlias = tuple[Traffic, Recording | None]


def prepare(
    layout: Array, rule: TaskRule, config: FleetConfig, costs: Array | None = None
) -> World:
    """Build what all runs on one layout (int8 [H, W]) share: goals, distances, walls.

    `costs` are those of each move at each cell (int32 [5, H, W], see `guidance.fixed_costs`).
    Raises InputError if the window, or a stay that all layouts share, is longer than the planner
    understands, or if it knows no costs of moves. Other such stays make the world invalid.
    """
    chex.assert_rank(layout, 2)
    chex.assert_type(layout, int)
    planner = PLANNERS.make(config.planner)
    name = f"the planner {PLANNERS.name_of(config.planner)!r}"
    longest = max(0 if callable(goal.stay) else goal.stay for goal in rule.cycle)
    if config.window > planner.max_window:
        limit = f"plans at most {planner.max_window} timesteps ahead"
        raise InputError(f"{name} {limit}: choose a window of at most that, not {config.window}")
    if longest > planner.max_service:
        limit = f"lets agents stay at a goal for at most {planner.max_service} timesteps"
        raise InputError(f"{name} {limit}, not {longest}: shorten the stay")
    if costs is not None:
        check_costs(config.planner)
    rows, cols = layout.shape
    capacity = config.goal_capacity or rows * cols
    traversable = jnp.asarray(of_tiles(layout, rule.traversable, rule.tiles))
    goals = goal_table(layout, rule, capacity)
    cells = pad(goals.cells, cols, planner.margin)
    distance, (kind, far) = None, distance_type(layout.size, costs is not None)
    sides = (planner.margin, planner.margin)
    walled = jnp.pad(traversable, planner.margin)
    if costs is not None:
        costs = jnp.pad(jnp.asarray(costs), ((0, 0), sides, sides)).reshape(NUM_MOVES, -1)
    table_bytes = capacity * layout.size * np.dtype(kind).itemsize
    if not planner.on_host and table_bytes <= _TABLE_BYTES:
        used = goals.used & traversable.reshape(-1)[goals.cells]
        if costs is None:
            distance = goal_distances(traversable, goals.cells, used).reshape(capacity, rows, cols)
            distance = jnp.pad(distance, ((0, 0), sides, sides), constant_values=far)
            distance = distance.reshape(capacity, -1)
        else:
            distance = goal_costs(walled, costs, cells, used)
    return World(
        traversable=walled,
        goals=goals._replace(cells=cells),
        distance=distance,
        # Stays that depend on the layout can be too long as well, which shows here only.
        valid=goals.complete & (goals.service_time.max() <= planner.max_service),
        costs=costs,
        margin=planner.margin,
        orders=jnp.asarray(chance.poisson(rule.rate / len(rule.cycle))) if rule.rate else None,
    )


def _run_window(
    world: World,
    config: FleetConfig,
    fleet: FleetState,
    active: jax.Array,
    seed: jax.Array,
    time: jax.Array,
) -> tuple[FleetState, Block]:
    """Plan the window that begins at `time` and drive its first steps."""
    fleet = fleet._replace(legs=jnp.zeros_like(fleet.legs))
    distance, row, cycle = world.distance, fleet.goal, world.goals.odds.shape[0]
    if fleet.fields is not None:
        fields = measure_fields(world, fleet.fields, fleet.goal)
        fleet = fleet._replace(fields=fields)
        distance, row = fields.distance, rows_of(fields)
    plan = PLANNERS.make(config.planner).plan
    assert plan is not None and distance is not None  # else runs are computed on the host
    state = AgentState(
        position=fleet.position,
        active=active,
        goal=fleet.goal,
        service_time=world.goals.service_time[
            jnp.stack([fleet.kind, next_kind(fleet.kind, cycle)]), fleet.goal
        ],
        remaining_service=fleet.remaining_service,
        age=fleet.age,
        previous=fleet.previous,
        distance=distance,
        row=row,
        leg=(fleet.kind == cycle).astype(jnp.int32),
    )
    # A key whose `chance.seed_of` is the host's seed of a window, mix(mix(seed, PLANS), time).
    words = jnp.stack([chance.draw(seed, chance.PLANS), time.astype(jnp.uint32)])
    key = jax.random.wrap_key_data(words, impl="threefry2x32")
    paths = plan(world, state, config.horizon, key)
    chex.assert_shape(paths, (config.window + 1, config.agents))
    goals, arrivals = (chance.draw(seed, one) for one in (chance.GOALS, chance.ORDERS))

    def step(fleet: FleetState, inputs: tuple[jax.Array, jax.Array]) -> tuple[FleetState, Block]:
        heading = _headings(world, fleet)
        fleet, finished = drive(world, fleet, inputs[0], active, chance.draw(goals, inputs[1]))
        if world.orders is not None and fleet.orders is not None:
            bits = chance.draw(arrivals, inputs[1]) >> (32 - chance.CHANCE_BITS)
            new = (world.orders <= bits.astype(jnp.int32)).sum(dtype=jnp.int32)
            waiting, waited = fleet.orders.waiting + new, fleet.orders.waited
            counts = inputs[1] < config.timesteps
            orders = Orders(waiting, fleet.orders.begun, waited + counts * waiting)
            fleet = fleet._replace(orders=orders)
        return fleet, Block(fleet.position, fleet.remaining_service, finished, heading)

    times = time + jnp.arange(config.horizon)
    fleet, block = jax.lax.scan(step, fleet, (paths[1 : config.horizon + 1], times))
    last = jnp.broadcast_to(paths[-1], (config.horizon, config.agents))
    fleet = fleet._replace(previous=jnp.concatenate([paths[config.horizon :], last]))
    return hand_out(world, fleet, active, seed, time + config.horizon), block


def _headings(world: World, fleet: FleetState) -> jax.Array:
    """Return the goal cells of all agents, -1 of those that are idle (int32 [A])."""
    cells = world.goals.cells[fleet.goal[0]]
    return jnp.where(fleet.kind < world.goals.odds.shape[0], cells, NOBODY)


def blank_outcome(world: World, config: FleetConfig, keep: bool) -> Outcome:
    """Make room for what a run leaves behind, all zeros; `keep` makes room for every step."""
    windows = -(-config.timesteps // config.horizon) * config.horizon
    nowhere = jnp.zeros((config.agents,), jnp.int32)
    blank = jnp.zeros((windows if keep else 0, config.agents), jnp.int32)
    counters = Counters(
        time=jnp.int32(0),
        congested_at=jnp.int32(0),
        finished=jnp.zeros((windows,), jnp.int32),
        visits=jnp.zeros((world.traversable.size,), jnp.int32),
        moves=jnp.int32(0),
        idle=jnp.int32(0),
    )
    block = Block(blank, blank, blank.astype(bool), blank)
    orders = Orders(jnp.int32(0), jnp.int32(0), jnp.float32(0))
    return Outcome(counters, nowhere, nowhere, block, None if world.orders is None else orders)


def run_settings(config: FleetConfig, seed: int = 0) -> RunSettings:
    """List what host code needs to know of a simulation."""
    return RunSettings(
        seed, config.timesteps, config.window, config.horizon, config.stop_when_congested
    )


def _run(
    world: World, seed: jax.Array, config: FleetConfig, active: jax.Array, keep: bool
) -> Outcome:
    """Simulate until T or congestion, keeping every step if `keep`."""
    planner = PLANNERS.make(config.planner)
    if planner.on_host:

        def on_host(_: Any, *buffers: Any) -> None:
            # Only numpy here: a jax call inside a callback can wait for the very device it blocks.
            outcome, world, seed, agents = jax.tree.map(np.asarray, buffers)
            simulate_into(outcome, planner, world, int(agents), run_settings(config, int(seed)))

        def copied(*inputs: Any) -> Any:
            outcome = jax.tree.map(lambda leaf: np.zeros(leaf.shape, leaf.dtype), like)
            on_host(None, outcome, *inputs)
            return outcome

        like = jax.eval_shape(lambda: blank_outcome(world, config, keep))
        # On a CPU the callback works on jax's own buffers, which elsewhere it cannot reach.
        return jax.lax.platform_dependent(
            *(world, seed, active.sum()),
            cpu=buffer_callback(on_host, like, vmap_method="sequential"),
            default=partial(jax.pure_callback, copied, like, vmap_method="sequential"),
        )
    first = place(world, config.window, active, seed)
    counters, _, _, room, _ = blank_outcome(world, config, keep)

    def is_going(run: tuple[FleetState, Counters, Block]) -> jax.Array:
        counters = run[1]
        halted = (counters.congested_at > 0) & config.stop_when_congested
        return world.valid & (counters.time < config.timesteps) & ~halted

    def run_window(run: tuple[FleetState, Counters, Block]) -> tuple[FleetState, Counters, Block]:
        fleet, counters, kept = run
        at_work = active & is_going(run)  # a finished lane of a batch has no agents left to plan
        after, block = _run_window(world, config, fleet, at_work, seed, counters.time)
        if keep:
            begin = (counters.time, 0)
            kept = jax.tree.map(
                lambda rows, part: jax.lax.dynamic_update_slice(rows, part, begin), kept, block
            )
        before = fleet.position, fleet.remaining_service
        return after, accumulate(counters, *before, block, active, config.timesteps), kept

    fleet, counters, kept = jax.lax.while_loop(is_going, run_window, (first, counters, room))
    return Outcome(counters, _headings(world, fleet), first.position, kept, fleet.orders)


def _simulate(
    world: World,
    key: jax.Array | None,
    config: FleetConfig,
    agents: Array | None,
    keep: bool,
    outcome: Outcome | None = None,
) -> _Report:
    """Simulate, unless the outcome is known, and report; the recording is None unless `keep`."""
    chex.assert_rank(world.traversable, 2)
    count = jnp.asarray(config.agents if agents is None else agents)
    chex.assert_rank(count, 0)
    # Without room for those who take part the world is not valid.
    room = (world.traversable.sum() >= count) & (count <= config.agents)
    world, active = replace(world, valid=world.valid & room), jnp.arange(config.agents) < count
    if outcome is None:
        assert key is not None
        outcome = _run(world, chance.seed_of(key), config, active, keep)
    recording = recording_of(outcome, active, world, config.timesteps) if keep else None
    return summarise(world, outcome, active, config.timesteps), recording


def simulate(
    world: World, key: jax.Array, config: FleetConfig, agents: Array | None = None
) -> Traffic:
    """Run one simulation until T, or until it congests.

    The world is from `prepare`, with the same config. The key is consumed; it decides starts, goals
    and ties. `agents` (traced, at most ``config.agents``) take part; None for all. A layout with
    too few free cells or without goals counts as congested at once.
    """
    return _simulate(world, key, config, agents, keep=False)[0]


def record(
    world: World, key: jax.Array, config: FleetConfig, agents: Array | None = None
) -> tuple[Traffic, Recording]:
    """Run the same simulation as `simulate` and keep every step of it."""
    traffic, recording = _simulate(world, key, config, agents, keep=True)
    assert recording is not None
    return traffic, recording


def count_moves(world: World, key: jax.Array, config: FleetConfig) -> jax.Array:
    """Simulate once and count how often each move was made (int32 [5, H, W], waiting first)."""
    traffic, recording = record(world, key, config)
    rows, cols = (side - 2 * world.margin for side in world.traversable.shape)
    # Beside a margin: in a layout of one column a step down is one to the right, too.
    cells = pad(recording.positions, cols, 1)
    move = move_of(cells[1:] - cells[:-1], cols + 2)
    driven = (jnp.arange(config.timesteps) < traffic.end_timestep)[:, None] & recording.active[None]
    counts = jnp.zeros((NUM_MOVES, rows * cols), jnp.int32)
    return counts.at[move, recording.positions[:-1]].add(driven).reshape(NUM_MOVES, rows, cols)


def compile_runs(
    world: World, config: FleetConfig, keep: bool
) -> Callable[[World, int, int], _Report]:
    """Compile whole runs on layouts of one size, (world, seed, agents) -> traffic and recording.

    The recording is None unless `keep`. On the host only what turns the outcome into records is a
    program of XLA's: what XLA compiles around a callback it forgets with the process. The worlds
    are of numpy arrays there.
    """
    planner, count = PLANNERS.make(config.planner), jax.ShapeDtypeStruct((), np.int32)
    if not planner.on_host:
        whole = jax.jit(lambda world, key, agents: _simulate(world, key, config, agents, keep))
        program = whole.lower(world, jax.random.key(0), count).compile()
        return lambda world, seed, agents: program(world, jax.random.key(seed), np.int32(agents))

    shapes = jax.eval_shape(lambda: blank_outcome(world, config, keep))
    report = jax.jit(
        lambda world, outcome, agents: _simulate(world, None, config, agents, keep, outcome)
    )
    program = report.lower(world, shapes, count).compile()

    def run(world: World, seed: int, agents: int) -> _Report:
        outcome = jax.tree.map(lambda leaf: np.zeros(leaf.shape, leaf.dtype), shapes)
        # Too many agents for the layout: none drives, and the report calls that congested.
        if agents <= min(int(np.asarray(world.traversable).sum()), config.agents):
            settings = run_settings(config, int(chance.seed_of(jax.random.key(seed))))
            simulate_into(outcome, planner, world, agents, settings)
        return program(world, outcome, np.int32(agents))

    return run
