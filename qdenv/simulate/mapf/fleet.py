"""Lifelong multi-agent path finding: one simulation of a fleet on one layout.

Plan a window, drive its first steps, hand out new goals, plan again (RHCR; the rules are in
`qdenv.simulate`). Everything that depends on the layout is traced, so all layouts of one size
share one compiled program.
"""

from dataclasses import dataclass
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from qdenv.grid import of_tiles
from qdenv.simulate.mapf import tasks
from qdenv.simulate.mapf.distances import UNREACHABLE, goal_distances
from qdenv.simulate.mapf.metrics import (
    MARGIN,
    Block,
    Recording,
    Tape,
    count_block,
    empty_tally,
    is_congested,
    recording_of,
    summarise,
    walled,
)
from qdenv.simulate.mapf.negotiated.settings import LOW, MAX_SERVICE, MAX_WINDOW
from qdenv.simulate.mapf.planner import PLANNERS, AgentState, World
from qdenv.types import Array, InputError, TaskRule, Traffic


@dataclass(frozen=True)
class FleetConfig:
    """The numbers of a simulation, all compile-time.

    Attributes:
        agents: agents simulated, or the most of them when `simulate` is told fewer.
        timesteps: horizon T.
        window: timesteps planned ahead without conflict (w), at most 10.
        horizon: timesteps driven before planning again (h).
        planner: chooses the paths; its settings are its own.
        stop_when_congested: end the run at the first congested window.
        goal_capacity: goal cells the tables have room for; None for one per cell of the layout.
    """

    agents: int = 200
    timesteps: int = 1000
    window: int = 10
    horizon: int = 5
    planner: Any = LOW
    stop_when_congested: bool = True
    goal_capacity: int | None = None

    def __post_init__(self) -> None:
        """Refuse numbers that make no simulation."""
        if self.agents < 1 or self.timesteps < 1:
            raise InputError("a simulation needs at least one agent and one timestep")
        if not 1 <= self.horizon <= self.window <= MAX_WINDOW:
            raise InputError(f"need 1 <= horizon <= window <= {MAX_WINDOW}")


class Fleet(NamedTuple):
    """The agents between two windows.

    Attributes:
        position: int32 [A].
        kind: int32 [A], the current goal's place in the cycle.
        goal: int32 [2, A], slots of the current and the next goal.
        serving: int32 [A], timesteps still to serve.
        age: int32 [A], timesteps since the last finished task.
        previous: int32 [window + 1, A], the plan from here on.
    """

    position: Array
    kind: Array
    goal: Array
    serving: Array
    age: Array
    previous: Array


def prepare(layout: Array, rule: TaskRule, config: FleetConfig) -> World:
    """Build what all runs on `layout` (int8 [H, W]) share: goals, distances, walls.

    Raises:
        InputError: a goal keeps its agents for more than 20 timesteps.
    """
    if max(goal.stay for goal in rule.cycle) > MAX_SERVICE:
        raise InputError(f"agents can stay at a goal for at most {MAX_SERVICE} timesteps")
    rows, cols = layout.shape
    capacity = config.goal_capacity or rows * cols
    traversable = of_tiles(layout, rule.traversable, rule.tiles)
    goals = tasks.goal_table(layout, rule, capacity)
    used = goals.used & traversable.reshape(-1)[goals.cells]
    distance = goal_distances(traversable, goals.cells, used)
    margins = ((0, 0), (MARGIN, MARGIN), (MARGIN, MARGIN))
    distance = jnp.pad(distance.reshape(capacity, rows, cols), margins, constant_values=UNREACHABLE)
    return World(
        traversable=jnp.pad(traversable, MARGIN),
        goals=goals._replace(cells=walled(goals.cells, cols)),
        distance=distance.reshape(capacity, -1),
        service_time=jnp.asarray(tasks.stays(rule)),
        valid=goals.complete,
        margin=MARGIN,
    )


def place(world: World, config: FleetConfig, active: Array, key: Array) -> Fleet:
    """Put the agents on distinct random cells and draw their first goals; consumes the key."""
    start_key, *goal_keys = jax.random.split(key, 3)
    count = config.agents
    luck = jax.random.uniform(start_key, (world.traversable.size,))
    luck = jnp.where(world.traversable.reshape(-1), luck, -1.0)
    _, cells = jax.lax.top_k(luck, count)
    position = jnp.where(active, cells.astype(jnp.int32), 0)
    kind = jnp.zeros((count,), jnp.int32)
    cycle = world.service_time.shape[0]
    goal = [
        tasks.draw_goals(world.goals, (kind + ahead) % cycle, goal_key)
        for ahead, goal_key in enumerate(goal_keys)
    ]
    still = jnp.broadcast_to(position, (config.window + 1, count))
    return Fleet(position, kind, jnp.stack(goal), kind, kind, still)


def drive(
    world: World, fleet: Fleet, cell: Array, active: Array, key: Array
) -> tuple[Fleet, Array]:
    """Move every agent to `cell` (int32 [A]) and serve goals; returns who finished (bool [A])."""
    cycle = world.service_time.shape[0]
    arrived = (fleet.serving == 0) & (cell == world.goals.cells[fleet.goal[0]]) & active
    left = jnp.where(arrived, world.service_time[fleet.kind], fleet.serving - 1)
    finished = (arrived | (fleet.serving > 0)) & (left <= 0)
    kind = jnp.where(finished, (fleet.kind + 1) % cycle, fleet.kind)
    drawn = tasks.draw_goals(world.goals, (kind + 1) % cycle, key)
    return fleet._replace(
        position=cell,
        kind=kind,
        goal=jnp.where(finished, jnp.stack([fleet.goal[1], drawn]), fleet.goal),
        serving=jnp.maximum(left, 0),
        age=jnp.where(finished, 0, fleet.age + 1),
    ), finished


def agent_state(world: World, fleet: Fleet, active: Array) -> AgentState:
    """Tell the planner what it needs to know."""
    cycle = world.service_time.shape[0]
    stay = world.service_time[jnp.stack([fleet.kind, (fleet.kind + 1) % cycle])]
    return AgentState(
        fleet.position, active, fleet.goal, stay, fleet.serving, fleet.age, fleet.previous
    )


def run_window(
    world: World, config: FleetConfig, fleet: Fleet, active: Array, key: Array
) -> tuple[Fleet, Block]:
    """Plan a window and drive its first steps; consumes the key."""
    plan_key, goal_key = jax.random.split(key)
    plan = PLANNERS.make(config.planner).plan
    paths = plan(world, agent_state(world, fleet, active), config.horizon, plan_key)

    def step(fleet: Fleet, inputs: tuple[Array, Array]) -> tuple[Fleet, Block]:
        heading = world.goals.cells[fleet.goal[0]]
        fleet, finished = drive(world, fleet, inputs[0], active, inputs[1])
        return fleet, Block(fleet.position, fleet.serving, finished, heading)

    executed = paths[1 : config.horizon + 1]
    keys = jax.random.split(goal_key, config.horizon)
    fleet, block = jax.lax.scan(step, fleet, (executed, keys))
    last = jnp.broadcast_to(paths[-1], (config.horizon, config.agents))
    return fleet._replace(previous=jnp.concatenate([paths[config.horizon :], last])), block


def _run(
    world: World, key: Array, config: FleetConfig, agents: Array | None, keep: bool
) -> tuple[Traffic, Recording | None]:
    """Simulate until T or congestion, keeping every step if asked."""
    asked = config.agents if agents is None else agents
    active = jnp.arange(config.agents) < asked
    room = world.traversable.sum() >= asked
    world = world.replace(valid=world.valid & room & (asked <= config.agents))
    place_key, drive_key = jax.random.split(key)
    fleet = place(world, config, active, place_key)
    blocks = -(-config.timesteps // config.horizon)
    tally = empty_tally(world, blocks * config.horizon)
    tape = Tape.empty(fleet.position, blocks * config.horizon) if keep else None

    def going(carry: tuple) -> jax.Array:
        tally = carry[1]
        halted = tally.congested & config.stop_when_congested
        return world.valid & (tally.time < config.timesteps) & ~halted

    def window(carry: tuple) -> tuple:
        fleet, tally, tape = carry
        at_work = active & going(carry)  # a finished lane of a batch has nobody left to plan
        step_key = jax.random.fold_in(drive_key, tally.time)
        after, block = run_window(world, config, fleet, at_work, step_key)
        whole = tally.time + config.horizon <= config.timesteps
        jam = whole & is_congested(fleet.position, block, fleet.serving, active)
        tape = tape.store(block, tally.time) if keep else None
        tally = count_block(tally, fleet.position, block, active, config.timesteps)
        return after, tally._replace(congested=tally.congested | jam), tape

    fleet, tally, tape = jax.lax.while_loop(going, window, (fleet, tally, tape))
    traffic = summarise(world, tally, active, config.timesteps)
    last_goal = world.goals.cells[fleet.goal[0]]
    kept = recording_of(tape, tally, last_goal, active, world, config.timesteps) if keep else None
    return traffic, kept


def simulate(
    world: World, key: Array, rule: TaskRule, config: FleetConfig, agents: Array | None = None
) -> Traffic:
    """Run one simulation until T, or until it congests.

    Args:
        world: from `prepare`, with the same rule and config.
        key: consumed; decides starts, goals and ties.
        rule: what the agents do.
        config: the numbers.
        agents: how many agents take part (traced, at most ``config.agents``); None for all.

    Returns:
        `Traffic`. A layout with too few free cells or without goals counts as congested at once.
    """
    del rule  # the world holds all of it that a run needs
    return _run(world, key, config, agents, keep=False)[0]


def record(
    world: World, key: Array, rule: TaskRule, config: FleetConfig, agents: Array | None = None
) -> tuple[Traffic, Recording]:
    """Run the same simulation as `simulate` and keep every step of it."""
    del rule
    return _run(world, key, config, agents, keep=True)
