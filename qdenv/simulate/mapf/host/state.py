"""One run in compiled host code: its records, and how one window is driven.

`agents` and `metrics` agent by agent instead of array by array, number for number.
"""

from typing import NamedTuple

import numpy as np

from qdenv.grid import move_steps
from qdenv.native import Scalar, formula, kernel
from qdenv.simulate.mapf import chance
from qdenv.simulate.mapf.metrics import Block
from qdenv.simulate.mapf.planner import World, unpad
from qdenv.simulate.mapf.tasks import KNOWN, serve

_AGENT_BITS = 24


class GridMap(NamedTuple):
    """One layout; N cells of the padded grid, G goals, n kinds."""

    free: np.ndarray  # bool [N], cells agents may drive on
    goals: np.ndarray  # int64 [G], the goal cells
    odds: np.ndarray  # float32 [n, G], cumulated odds of each goal within its kind
    service_time: np.ndarray  # int64 [n], timesteps served at each kind of goal
    steps: np.ndarray  # int64 [5], what each move adds to a position: wait, right, left, down, up
    width: int  # columns of the padded grid
    margin: int  # rows and columns of walls on each side


class Agents(NamedTuple):
    """The A agents that take part, between two windows; w steps planned ahead."""

    position: np.ndarray  # int64 [A]
    kind: np.ndarray  # int64 [A], the current goal's place in the cycle
    goal: np.ndarray  # int64 [2, A], slots of the current and the next goal
    remaining_service: np.ndarray  # int64 [A], timesteps still to serve
    age: np.ndarray  # int64 [A], timesteps since the last finished task
    legs: np.ndarray  # int64 [A], tasks finished since all were planned
    paths: np.ndarray  # int64 [A, w + 1], the plan from here on
    stuck: np.ndarray  # bool [A], whether the agent neither moved nor served in this window


class Counters(NamedTuple):
    """What was counted so far, see `metrics.Metrics`; T is rounded up to whole windows."""

    time: Scalar  # int64 [], timesteps driven
    congested_at: Scalar  # int64 [], `time` when the first congested window ended; 0 for none
    moves: Scalar  # int64 [], agent-steps with a move
    finished: np.ndarray  # int32 [T], tasks finished at each timestep
    visits: np.ndarray  # int32 [N], agent-steps on each cell


class RunSettings(NamedTuple):
    """The numbers of a run."""

    seed: int  # of all that is drawn
    timesteps: int  # T
    window: int  # timesteps planned ahead (w)
    horizon: int  # timesteps driven before planning again (h)
    stop_when_congested: bool  # whether the first congested window ends the run


class HostRun(NamedTuple):
    """One run under way."""

    grid: GridMap  # the layout
    agents: Agents  # where they are, and what they do
    counters: Counters  # what was counted
    block: Block  # every step, each int32 or bool [T, A]; without rows where nothing is recorded
    settings: RunSettings  # its numbers


def grid_map(world: World) -> GridMap:
    """Take what host code needs of a world of numpy arrays."""
    width = world.traversable.shape[1]
    # Copies: jax's own buffers cannot be written to, for which kernels would be compiled twice.
    return GridMap(
        np.array(world.traversable).reshape(-1),
        np.asarray(world.goals.cells, np.int64),
        np.array(world.goals.odds),
        np.asarray(world.service_time, np.int64),
        move_steps(width),
        width,
        world.margin,
    )


def make_run(world: World, settings: RunSettings, agents: int, block: Block) -> HostRun:
    """Begin a run of `agents` agents who have no position yet.

    Args:
        world: of numpy arrays.
        settings: of the run.
        agents: number of agents.
        block: numpy arrays to record into.
    """
    grid = grid_map(world)
    windows = -(-settings.timesteps // settings.horizon)
    position, kind, remaining_service, age, legs = np.zeros((5, agents), np.int64)
    goal, paths = np.zeros((2, agents), np.int64), np.zeros((agents, settings.window + 1), np.int64)
    stuck = np.zeros(agents, np.bool_)
    time, congested_at, moves = (np.zeros((), np.int64) for _ in range(3))
    counters = Counters(
        time,
        congested_at,
        moves,
        finished=np.zeros(windows * settings.horizon, np.int32),
        visits=np.zeros(grid.free.size, np.int32),
    )
    moving = Agents(position, kind, goal, remaining_service, age, legs, paths, stuck)
    return HostRun(grid, moving, counters, block, settings)


def place_agents(run: HostRun) -> None:
    """Put the agents on distinct free cells and draw their first goals, as `agents.place` does."""
    grid, agents, seed = run.grid, run.agents, run.settings.seed
    count, cells = agents.position.size, np.flatnonzero(grid.free)
    numbers = unpad(cells, grid.width - 2 * grid.margin, grid.margin)
    rank = chance.draw_on_host(chance.draw_on_host(seed, chance.STARTS), numbers) >> 1
    agents.position[:] = cells[np.argsort(-rank.astype(int), kind="stable")[:count]]
    agents.paths[:] = agents.position[:, None]
    for ahead, purpose in enumerate((chance.FIRST_GOAL, chance.SECOND_GOAL)):
        bits = chance.draw_on_host(chance.draw_on_host(seed, purpose), np.arange(count))
        whole = (bits >> (32 - chance.CHANCE_BITS)).astype(np.float32)
        value = whole * np.float32(2.0**-chance.CHANCE_BITS)  # as `chance.uniform`
        odds = grid.odds[ahead % grid.service_time.size]
        drawn = np.searchsorted(odds, value, side="right")
        agents.goal[ahead] = np.minimum(drawn, grid.goals.size - 1)


@kernel
def is_going(run: HostRun) -> bool:
    """Return True if there is another window to drive."""
    halted = run.counters.congested_at[()] != 0 and run.settings.stop_when_congested
    return run.counters.time[()] < run.settings.timesteps and not halted


@kernel
def drive_window(run: HostRun) -> None:
    """Drive the first steps of all paths; count, record and look for a jam."""
    agents, counters, horizon = run.agents, run.counters, run.settings.horizon
    begin, count, stuck = counters.time[()], agents.position.size, 0
    last = agents.paths.shape[1] - 1
    goals = chance.mix(run.settings.seed, chance.GOALS)
    for agent in range(count):
        agents.stuck[agent], agents.legs[agent] = True, 0
    for step in range(horizon):
        drawn = chance.mix(goals, begin + step)
        for agent in range(count):
            _drive(run, agent, step, drawn)
    for agent in range(count):
        stuck += agents.stuck[agent]
        # The rest of the path is kept; its last cell is repeated.
        for step in range(last + 1):
            agents.paths[agent, step] = agents.paths[agent, min(step + horizon, last)]
    # A window that T cuts short is no window of the jam rule.
    jam = begin + horizon <= run.settings.timesteps and stuck > count // 2
    if jam and counters.congested_at[()] == 0:
        counters.congested_at[()] = begin + horizon
    counters.time[()] = min(begin + horizon, run.settings.timesteps)


@kernel
def _drive(run: HostRun, agent: int, step: int, drawn: int) -> None:
    """Move one agent by one step of its path and serve its goal, as `agents.drive` does."""
    grid, agents, counters = run.grid, run.agents, run.counters
    time = counters.time[()] + step
    cell, goal = agents.paths[agent, step + 1], grid.goals[agents.goal[0, agent]]
    moves = cell != agents.position[agent]
    if time < run.settings.timesteps:
        counters.visits[cell] += 1
        counters.moves[()] += moves
    # Stuck: the same cell at all timesteps of the window but the last, and never serving.
    if (moves and step < run.settings.horizon - 1) or agents.remaining_service[agent] > 0:
        agents.stuck[agent] = False
    agents.position[agent] = cell
    kind = agents.kind[agent]
    service_time = grid.service_time[kind]
    known = agents.legs[agent] < KNOWN or service_time == 0
    on_goal = cell == goal and known
    left, finished = serve(agents.remaining_service[agent], on_goal, service_time)
    agents.remaining_service[agent] = left
    agents.age[agent] += 1
    if run.block.positions.size:
        run.block.positions[time, agent] = cell
        run.block.remaining_service[time, agent] = left
        run.block.finished[time, agent] = finished
        run.block.goals[time, agent] = goal
    if finished:
        kind = (kind + 1) % grid.service_time.size
        coming = (kind + 1) % grid.service_time.size
        agents.kind[agent], agents.age[agent] = kind, 0
        agents.legs[agent] += 1
        agents.goal[0, agent] = agents.goal[1, agent]
        agents.goal[1, agent] = _draw_goal(grid, coming, chance.mix(drawn, agent))
        if time < run.settings.timesteps:
            counters.finished[time] += 1


@kernel
def _draw_goal(grid: GridMap, kind: int, bits: int) -> int:
    """Draw a goal of a kind with its odds, as `tasks.draw_goals` does."""
    low, high = 0, grid.goals.size
    value = np.float32(bits >> (32 - chance.CHANCE_BITS)) * np.float32(2.0**-chance.CHANCE_BITS)
    while low < high:
        middle = (low + high) // 2
        if grid.odds[kind, middle] <= value:
            low = middle + 1
        else:
            high = middle
    return min(low, grid.goals.size - 1)


# Orders of agents. Heaps by hand: numba compiles `heapq` for lists only, and its own sort of an
# array makes a list of partitions, which no kernel may.


@formula
def ranked(number: int, agent: int) -> int:
    """Pack a number (0 to 2^38) and an agent: packs sort by number, then by agent."""
    return (number << _AGENT_BITS) | agent


@formula
def agent_of(pack: int) -> int:
    """Read the agent of a pack."""
    return pack & ((1 << _AGENT_BITS) - 1)


@kernel
def sort(values: np.ndarray) -> None:
    """Sort int64 [n] in place, the smallest first (heapsort; Williams 1964).

    https://doi.org/10.1145/512274.512284
    """
    size = values.size
    for first in range(size // 2 - 1, -1, -1):
        sift(values, first, size)
    for last in range(size - 1, 0, -1):
        values[0], values[last] = values[last], values[0]
        sift(values, 0, last)


@kernel
def sift(heap: np.ndarray, hole: int, size: int) -> None:
    """Let the value at `hole` sink below all larger ones of a heap of `size` values."""
    value = heap[hole]
    while 2 * hole + 1 < size:
        child = 2 * hole + 1
        if child + 1 < size and heap[child + 1] > heap[child]:
            child += 1
        if heap[child] <= value:
            break
        heap[hole], hole = heap[child], child
    heap[hole] = value
