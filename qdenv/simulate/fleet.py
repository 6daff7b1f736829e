"""Lifelong multi-agent path finding: one simulation of a fleet on one layout.

Plan a window, drive its first steps, hand out new goals, plan again (RHCR; the rules are in
`qdenv.simulate`). Everything that depends on the layout is traced, so all layouts of one size
share one compiled program.
"""

from dataclasses import dataclass, field
from typing import NamedTuple

import jax
import jax.numpy as jnp

from qdenv.grid import of_tiles
from qdenv.simulate import tasks
from qdenv.simulate.distances import UNREACHABLE, goal_distances
from qdenv.simulate.planners.base import Planner, Problem, Situation
from qdenv.simulate.planners.single_agent import LONGEST_STAY, REACH
from qdenv.simulate.planners.windowed import LOW
from qdenv.types import Array, InputError, TaskRule, Traffic

MARGIN = REACH  # rows and columns of walls around the grid


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
    planner: Planner = field(default=LOW)
    stop_when_congested: bool = True
    goal_capacity: int | None = None

    def __post_init__(self) -> None:
        """Refuse numbers that make no simulation."""
        if self.agents < 1 or self.timesteps < 1:
            raise InputError("a simulation needs at least one agent and one timestep")
        if not 1 <= self.horizon <= self.window <= REACH:
            raise InputError(f"need 1 <= horizon <= window <= {REACH}")


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


class Tally(NamedTuple):
    """What was counted so far; T is rounded up to whole windows."""

    time: Array  # int32
    congested: Array  # bool
    finished: Array  # int32 [T]
    visits: Array  # int32 [H' * W']
    moves: Array  # int32


class Recording(NamedTuple):
    """A whole run, for the audit and for pictures; positions on the layout without margin.

    Attributes:
        positions: int32 [T + 1, A]; after the end of the run the last position is repeated.
        goals: int32 [T + 1, A], the goal cell each agent is heading for before the step.
        serving: int32 [T + 1, A], timesteps it must still stay.
        finished: bool [T, A], tasks finished by the step.
        active: bool [A].
    """

    positions: Array
    goals: Array
    serving: Array
    finished: Array
    active: Array


def prepare(layout: Array, rule: TaskRule, config: FleetConfig) -> Problem:
    """Build what all runs on `layout` (int8 [H, W]) share: goals, distances, walls.

    Raises:
        InputError: a goal keeps its agents for more than 20 timesteps.
    """
    if max(goal.stay for goal in rule.cycle) > LONGEST_STAY:
        raise InputError(f"agents can stay at a goal for at most {LONGEST_STAY} timesteps")
    rows, cols = layout.shape
    capacity = config.goal_capacity or rows * cols
    traversable = of_tiles(layout, rule.traversable, rule.tiles)
    goals = tasks.goal_table(layout, rule, capacity)
    used = goals.used & traversable.reshape(-1)[goals.cells]
    distance = goal_distances(traversable, goals.cells, used)
    margins = ((0, 0), (MARGIN, MARGIN), (MARGIN, MARGIN))
    distance = jnp.pad(distance.reshape(capacity, rows, cols), margins, constant_values=UNREACHABLE)
    return Problem(
        traversable=jnp.pad(traversable, MARGIN),
        goals=goals._replace(cells=walled(goals.cells, cols)),
        distance=distance.reshape(capacity, -1),
        stays=jnp.asarray(tasks.stays(rule)),
        valid=goals.complete,
    )


def walled(cells: Array, cols: int) -> jax.Array:
    """Translate positions of the layout into positions of the walled grid."""
    return (cells // cols + MARGIN) * (cols + 2 * MARGIN) + cells % cols + MARGIN


def unwalled(cells: Array, cols: int) -> jax.Array:
    """Translate positions of the walled grid into positions of the layout."""
    width = cols + 2 * MARGIN
    return (cells // width - MARGIN) * cols + cells % width - MARGIN


def place(problem: Problem, config: FleetConfig, active: Array, key: Array) -> Fleet:
    """Put the agents on distinct random cells and draw their first goals; consumes the key."""
    start_key, *goal_keys = jax.random.split(key, 3)
    count = config.agents
    luck = jax.random.uniform(start_key, (problem.traversable.size,))
    luck = jnp.where(problem.traversable.reshape(-1), luck, -1.0)
    _, cells = jax.lax.top_k(luck, count)
    position = jnp.where(active, cells.astype(jnp.int32), 0)
    kind = jnp.zeros((count,), jnp.int32)
    cycle = problem.stays.shape[0]
    goal = [
        tasks.draw_goals(problem.goals, (kind + ahead) % cycle, goal_key)
        for ahead, goal_key in enumerate(goal_keys)
    ]
    still = jnp.broadcast_to(position, (config.window + 1, count))
    return Fleet(position, kind, jnp.stack(goal), kind, kind, still)


def drive(
    problem: Problem, fleet: Fleet, cell: Array, active: Array, key: Array
) -> tuple[Fleet, Array]:
    """Move every agent to `cell` (int32 [A]) and serve goals; returns who finished (bool [A])."""
    cycle = problem.stays.shape[0]
    arrived = (fleet.serving == 0) & (cell == problem.goals.cells[fleet.goal[0]]) & active
    left = jnp.where(arrived, problem.stays[fleet.kind], fleet.serving - 1)
    finished = (arrived | (fleet.serving > 0)) & (left <= 0)
    kind = jnp.where(finished, (fleet.kind + 1) % cycle, fleet.kind)
    drawn = tasks.draw_goals(problem.goals, (kind + 1) % cycle, key)
    return fleet._replace(
        position=cell,
        kind=kind,
        goal=jnp.where(finished, jnp.stack([fleet.goal[1], drawn]), fleet.goal),
        serving=jnp.maximum(left, 0),
        age=jnp.where(finished, 0, fleet.age + 1),
    ), finished


def situation_of(problem: Problem, fleet: Fleet, active: Array) -> Situation:
    """Tell the planner what it needs to know."""
    cycle = problem.stays.shape[0]
    stay = problem.stays[jnp.stack([fleet.kind, (fleet.kind + 1) % cycle])]
    return Situation(
        fleet.position, active, fleet.goal, stay, fleet.serving, fleet.age, fleet.previous
    )


class Block(NamedTuple):
    """What happened in the executed steps of one window, each [h, A]."""

    positions: Array  # int32, after the step
    serving: Array  # int32, after the step
    finished: Array  # bool
    goals: Array  # int32, goal cells before the step


def run_window(
    problem: Problem, config: FleetConfig, fleet: Fleet, active: Array, key: Array
) -> tuple[Fleet, Block]:
    """Plan a window and drive its first steps; consumes the key."""
    plan_key, goal_key = jax.random.split(key)
    paths = config.planner(problem, situation_of(problem, fleet, active), config.horizon, plan_key)

    def step(fleet: Fleet, inputs: tuple[Array, Array]) -> tuple[Fleet, Block]:
        heading = problem.goals.cells[fleet.goal[0]]
        fleet, finished = drive(problem, fleet, inputs[0], active, inputs[1])
        return fleet, Block(fleet.position, fleet.serving, finished, heading)

    executed = paths[1 : config.horizon + 1]
    keys = jax.random.split(goal_key, config.horizon)
    fleet, block = jax.lax.scan(step, fleet, (executed, keys))
    last = jnp.broadcast_to(paths[-1], (config.horizon, config.agents))
    return fleet._replace(previous=jnp.concatenate([paths[config.horizon :], last])), block


def is_congested(start: Array, block: Block, serving: Array, active: Array) -> jax.Array:
    """Tell whether more than half of the agents are stuck.

    Stuck: the same cell at all timesteps of the window but the last, and never serving.
    """
    path = jnp.concatenate([start[None], block.positions])[:-1]
    at_work = jnp.concatenate([serving[None], block.serving])[:-1] > 0
    stuck = (path == path[0]).all(0) & ~at_work.any(0) & active
    return stuck.sum() > active.sum() // 2


def count_block(tally: Tally, start: Array, block: Block, active: Array, timesteps: int) -> Tally:
    """Add the driven steps to the tally; steps beyond T do not count."""
    horizon = block.positions.shape[0]
    counts = (tally.time + jnp.arange(horizon) < timesteps)[:, None] & active[None, :]
    before = jnp.concatenate([start[None], block.positions[:-1]])
    finished = (block.finished & counts).sum(1, dtype=jnp.int32)
    return Tally(
        time=jnp.minimum(tally.time + horizon, timesteps),
        congested=tally.congested,
        finished=jax.lax.dynamic_update_slice(tally.finished, finished, (tally.time,)),
        visits=tally.visits.at[block.positions].add(counts.astype(jnp.int32)),
        moves=tally.moves + ((block.positions != before) & counts).sum(dtype=jnp.int32),
    )


def summarise(problem: Problem, config: FleetConfig, tally: Tally, active: Array) -> Traffic:
    """Turn the tally into the record that other stages read."""
    finished = tally.finished[: config.timesteps]
    visits = tally.visits.reshape(problem.traversable.shape)[MARGIN:-MARGIN, MARGIN:-MARGIN]
    steps = jnp.maximum(tally.time * active.sum(), 1).astype(jnp.float32)
    total = finished.sum()
    return Traffic(
        throughput=total / jnp.float32(config.timesteps),
        congested=tally.congested | ~problem.valid,
        end_timestep=tally.time,
        finished=finished,
        usage=visits / jnp.maximum(visits.sum(), 1).astype(jnp.float32),
        waiting=1.0 - tally.moves / steps,
        path_length=tally.moves / jnp.maximum(total, 1).astype(jnp.float32),
    )


def _run(
    problem: Problem, key: Array, config: FleetConfig, agents: Array | None, keep: bool
) -> tuple[Traffic, Recording | None]:
    """Simulate until T or congestion, keeping every step if asked."""
    asked = config.agents if agents is None else agents
    active = jnp.arange(config.agents) < asked
    room = problem.traversable.sum() >= asked
    problem = problem._replace(valid=problem.valid & room & (asked <= config.agents))
    place_key, drive_key = jax.random.split(key)
    fleet = place(problem, config, active, place_key)
    windows = -(-config.timesteps // config.horizon)
    total = windows * config.horizon
    tally = Tally(
        time=jnp.int32(0),
        congested=jnp.bool_(False),
        finished=jnp.zeros((total,), jnp.int32),
        visits=jnp.zeros((problem.traversable.size,), jnp.int32),
        moves=jnp.int32(0),
    )
    tape = None
    if keep:
        tape = Block(*(jnp.zeros((total, config.agents), jnp.int32) for _ in Block._fields))
    begin = fleet

    def going(carry: tuple) -> jax.Array:
        tally = carry[1]
        halted = tally.congested & config.stop_when_congested
        return problem.valid & (tally.time < config.timesteps) & ~halted

    def window(carry: tuple) -> tuple:
        fleet, tally, tape = carry
        at_work = active & going(carry)  # a finished lane of a batch has nobody left to plan
        step_key = jax.random.fold_in(drive_key, tally.time)
        after, block = run_window(problem, config, fleet, at_work, step_key)
        jam = is_congested(fleet.position, block, fleet.serving, active)
        time = tally.time
        tally = count_block(tally, fleet.position, block, active, config.timesteps)
        if keep:
            tape = jax.tree.map(
                lambda roll, part: jax.lax.dynamic_update_slice(
                    roll, part.astype(jnp.int32), (time, 0)
                ),
                tape,
                block,
            )
        return after, tally._replace(congested=tally.congested | jam), tape

    fleet, tally, tape = jax.lax.while_loop(going, window, (fleet, tally, tape))
    traffic = summarise(problem, config, tally, active)
    return traffic, _recording(problem, config, begin, fleet, tape, tally, active) if keep else None


def _recording(
    problem: Problem,
    config: FleetConfig,
    begin: Fleet,
    end: Fleet,
    tape: Block,
    tally: Tally,
    active: Array,
) -> Recording:
    """Cut the tape to T steps and translate its positions."""
    cols = problem.traversable.shape[1] - 2 * MARGIN
    steps = config.timesteps
    driven = (jnp.arange(steps) < tally.time)[:, None]
    positions = jnp.where(driven, tape.positions[:steps], end.position)
    headings = jnp.where(driven, tape.goals[:steps], problem.goals.cells[end.goal[0]])
    last = problem.goals.cells[end.goal[0]]
    return Recording(
        positions=unwalled(jnp.concatenate([begin.position[None], positions]), cols),
        goals=unwalled(jnp.concatenate([headings, last[None]]), cols),
        serving=jnp.concatenate(
            [begin.serving[None], jnp.where(driven, tape.serving[:steps], end.serving)]
        ),
        finished=(tape.finished[:steps] > 0) & driven,
        active=active,
    )


def simulate(
    problem: Problem, key: Array, rule: TaskRule, config: FleetConfig, agents: Array | None = None
) -> Traffic:
    """Run one simulation until T, or until it congests.

    Args:
        problem: from `prepare`, with the same rule and config.
        key: consumed; decides starts, goals and ties.
        rule: what the agents do.
        config: the numbers.
        agents: how many agents take part (traced, at most ``config.agents``); None for all.

    Returns:
        `Traffic`. A layout with too few free cells or without goals counts as congested at once.
    """
    del rule  # the problem holds all of it that a run needs
    return _run(problem, key, config, agents, keep=False)[0]


def record(
    problem: Problem, key: Array, rule: TaskRule, config: FleetConfig, agents: Array | None = None
) -> tuple[Traffic, Recording]:
    """Run the same simulation as `simulate` and keep every step of it."""
    del rule
    return _run(problem, key, config, agents, keep=True)
