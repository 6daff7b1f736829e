"""One run in compiled host code: its records, and how one window is driven.

`agents` and `metrics` agent by agent instead of array by array, number for number.
"""

from typing import Any, NamedTuple

import numpy as np

from qdenv.grid import NUM_MOVES, move_steps, pad
from qdenv.native import Numbers, formula, kernel, numbers
from qdenv.simulation.mapf import chance
from qdenv.simulation.mapf.metrics import Block
from qdenv.simulation.mapf.planner import KNOWN, NEAR, NOBODY, World, next_kind, serve

# Orders of agents are sorted as single numbers: what ranks an agent (below 2^38), then the agent.
AGENT_BITS = 24
AGENT = (1 << AGENT_BITS) - 1


class GridMap(NamedTuple):
    """One layout; N cells of the padded grid, G goals, n kinds."""

    free: np.ndarray  # bool [N], cells agents may drive on
    goals: np.ndarray  # int64 [G], the goal cells
    odds: np.ndarray  # float32 [n, G], cumulated odds of each goal within its kind
    # int64 [n + 1, G], timesteps served at each goal by its kind; an idle agent is of kind n
    service_time: np.ndarray
    steps: np.ndarray  # int64 [5], what each move adds to a position: wait, right, left, down, up
    width: int  # columns of the padded grid
    margin: int  # rows and columns of walls on each side
    # int32 [5, N], the cost of each move at each cell, 0 where it is not allowed; [5, 0] without
    costs: np.ndarray = np.zeros((NUM_MOVES, 0), np.int32)
    # int32 [K], odds of orders per timestep (`chance.poisson`); empty where work never runs out
    orders: np.ndarray = np.zeros(0, np.int32)
    slot: np.ndarray = np.zeros(0, np.int64)  # int64 [N], slot of the goal on each cell, or 0


class RunSettings(NamedTuple):
    """Settings of a run."""

    seed: int  # of all that is drawn
    timesteps: int  # T
    window: int  # timesteps planned ahead (w)
    horizon: int  # timesteps driven before planning again (h)
    stop_when_congested: bool  # whether the first congested window ends the run


class HostRun(NamedTuple):
    """One run between two windows; what it counts is explained in `metrics.Counters`.

    A agents take part, and plan w steps ahead.
    """

    grid: GridMap  # the layout
    position: np.ndarray  # int64 [A]
    kind: np.ndarray  # int64 [A], the current goal's place in the cycle; its length while idle
    goal: np.ndarray  # int64 [2, A], slots of the current and the next goal
    remaining_service: np.ndarray  # int64 [A], timesteps still to serve
    age: np.ndarray  # int64 [A], timesteps since the last finished task
    legs: np.ndarray  # int64 [A], tasks finished since all were planned
    paths: np.ndarray  # int64 [A, w + 1], the plan from here on
    stuck: np.ndarray  # bool [A], neither served, idle nor moving in this window but its last step
    counters: Numbers  # time, congested_at, moves and idle; waiting and begun of `metrics.Orders`
    waited: np.ndarray  # float32 [1], timesteps that all orders waited
    finished: np.ndarray  # int32 [T], T rounded up to whole windows
    visits: np.ndarray  # int32 [N]
    block: Block  # every step, each int32 or bool [T, A]; without rows where nothing is recorded
    settings: RunSettings  # its numbers


def grid_map(world: World) -> GridMap:
    """Take what host code needs of a world of numpy arrays."""
    width, slot = world.traversable.shape[1], np.zeros(world.traversable.size, np.int64)
    used = np.flatnonzero(world.goals.used)
    slot[np.asarray(world.goals.cells)[used]] = used
    # Copies: jax's own buffers cannot be written to, for which kernels would be compiled twice.
    return GridMap(
        np.array(world.traversable).reshape(-1),
        np.asarray(world.goals.cells, np.int64),
        np.array(world.goals.odds),
        np.asarray(world.goals.service_time, np.int64),
        move_steps(width),
        width,
        world.margin,
        np.zeros((NUM_MOVES, 0), np.int32) if world.costs is None else np.array(world.costs),
        np.zeros(0, np.int32) if world.orders is None else np.array(world.orders),
        slot,
    )


def make_run(world: World, settings: RunSettings, agents: int, block: Block) -> HostRun:
    """Begin a run of `agents` agents who have no position yet; all arrays are numpy's."""
    grid = grid_map(world)
    windows = -(-settings.timesteps // settings.horizon)
    return HostRun(
        grid=grid,
        position=np.zeros(agents, np.int64),
        kind=np.zeros(agents, np.int64),
        goal=np.zeros((2, agents), np.int64),
        remaining_service=np.zeros(agents, np.int64),
        age=np.zeros(agents, np.int64),
        legs=np.zeros(agents, np.int64),
        paths=np.zeros((agents, settings.window + 1), np.int64),
        stuck=np.zeros(agents, np.bool_),
        counters=numbers("time", "congested_at", "moves", "idle", "waiting", "begun"),
        waited=np.zeros(1, np.float32),
        finished=np.zeros(windows * settings.horizon, np.int32),
        visits=np.zeros(grid.free.size, np.int32),
        block=block,
        settings=settings,
    )


def place_agents(run: HostRun) -> None:
    """Put the agents on distinct free cells and draw their first goals, as `agents.place` does."""
    grid, seed = run.grid, run.settings.seed
    count, cells = run.position.size, np.flatnonzero(grid.free)
    # Ranked by their places in the layout: a planner's margin changes no start.
    places = pad(cells, grid.width, -grid.margin)
    rank = chance.draw_on_host(chance.draw_on_host(seed, chance.STARTS), places) >> 1
    run.position[:] = cells[np.argsort(-rank.astype(int), kind="stable")[:count]]
    run.paths[:] = run.position[:, None]
    for ahead, purpose in enumerate((chance.FIRST_GOAL, chance.SECOND_GOAL)):
        bits = chance.draw_on_host(chance.draw_on_host(seed, purpose), np.arange(count))
        whole = (bits >> (32 - chance.CHANCE_BITS)).astype(np.float32)
        value = whole * np.float32(2.0**-chance.CHANCE_BITS)  # as `planner.draw_goals`
        drawn = np.searchsorted(grid.odds[ahead % len(grid.odds)], value, side="right")
        run.goal[ahead] = np.minimum(drawn, grid.goals.size - 1)
    if grid.orders.size > 0:  # all are idle, where they are
        run.kind[:], run.goal[:] = len(grid.odds), grid.slot[run.position]


@kernel
def drive_window(run: HostRun, has_orders: bool | None) -> None:
    """Drive the first steps of all paths; count, record and look for a jam.

    `has_orders` is None where work never runs out: numba then leaves out what deals with orders.
    """
    counters, settings = run.counters, run.settings
    begin, horizon, last = counters.time, settings.horizon, run.paths.shape[1] - 1
    goals = chance.mix(settings.seed, chance.GOALS)
    run.stuck[:], run.legs[:] = True, 0
    for step in range(horizon):
        drawn = chance.mix(goals, begin + step)
        for agent in range(run.position.size):
            _drive(run, has_orders, agent, step, begin + step, drawn)
        if has_orders is not None:
            _count_orders(run, begin + step)
    for agent in range(run.position.size):
        # The rest of the path is kept; its last cell is repeated.
        for step in range(last + 1):
            run.paths[agent, step] = run.paths[agent, min(step + horizon, last)]
    # A window that T cuts short is no window of the jam rule.
    jam = begin + horizon <= settings.timesteps and run.stuck.sum() > run.position.size // 2
    if jam and counters.congested_at == 0:
        counters.congested_at = begin + horizon
    counters.time = min(begin + horizon, settings.timesteps)
    if has_orders is not None:
        _hand_out(run, begin + horizon)


@formula
def _drive(
    run: HostRun, has_orders: bool | None, agent: int, step: int, time: int, drawn: int
) -> None:
    """Move one agent by one step of its path and serve its goal, as `agents.drive` does."""
    grid = run.grid
    slot = run.goal[0, agent]
    cell, goal = run.paths[agent, step + 1], grid.goals[slot]
    moves = cell != run.position[agent]
    if time < run.settings.timesteps:
        run.visits[cell] += 1
        run.counters.moves += moves
    kind, idle = run.kind[agent], run.kind[agent] == len(grid.odds)
    # Stuck: the same cell at all timesteps of the window but the last, and never serving or idle.
    if (moves and step < run.settings.horizon - 1) or run.remaining_service[agent] > 0 or idle:
        run.stuck[agent] = False
    run.position[agent] = cell
    service_time = grid.service_time[kind, slot]
    # Planners know of two goals: a later one is not served in passing.
    on_goal = cell == goal and (run.legs[agent] < KNOWN or service_time == 0) and not idle
    left, finished = serve(run.remaining_service[agent], on_goal, service_time)
    run.remaining_service[agent] = left
    run.age[agent] += 1
    if has_orders is not None and idle:
        run.age[agent] = 0  # an idle agent gives way to all others
        run.counters.idle += time < run.settings.timesteps
    if run.block.positions.size:
        run.block.positions[time, agent] = cell
        run.block.remaining_service[time, agent] = left
        run.block.finished[time, agent] = finished
        run.block.goals[time, agent] = NOBODY if idle else goal
    if finished:
        kind = (kind + 1) % len(grid.odds)
        run.kind[agent], run.age[agent] = kind, 0
        run.legs[agent] += 1
        run.goal[0, agent] = run.goal[1, agent]
        run.goal[1, agent] = _draw_goal(grid, kind + 1, drawn, agent)
        if time < run.settings.timesteps:
            run.finished[time] += 1
        if has_orders is not None and kind == 0:
            if run.counters.waiting > 0:
                run.counters.waiting -= 1
                run.counters.begun += 1
            else:
                run.kind[agent], run.goal[1, agent] = len(grid.odds), run.goal[0, agent]


@formula
def _draw_goal(grid: GridMap, kind: int, seed: int, agent: int) -> int:
    """Draw a goal of an agent with the odds of its kind, as `planner.draw_goals` does."""
    bits = chance.mix(seed, agent) >> (32 - chance.CHANCE_BITS)
    value = np.float32(bits) * np.float32(2.0**-chance.CHANCE_BITS)
    slot: Any = np.searchsorted(grid.odds[kind % len(grid.odds)], value, side="right")
    return min(slot, grid.goals.size - 1)


@formula
def service_time(run: HostRun, agent: int, leg: int) -> int:
    """Return the timesteps that an agent serves at its current (leg 0) or next goal (1)."""
    kind = run.kind[agent]
    if leg > 0:
        kind = next_kind(kind, len(run.grid.odds))
    return run.grid.service_time[kind, run.goal[leg, agent]]


@kernel
def _count_orders(run: HostRun, time: int) -> None:
    """Let orders arrive, and count those that wait."""
    arrivals = chance.mix(chance.mix(run.settings.seed, chance.ORDERS), time)
    bits = arrivals >> (32 - chance.CHANCE_BITS)
    run.counters.waiting += np.searchsorted(run.grid.orders, bits, side="right")
    if time < run.settings.timesteps:
        run.waited[0] += np.float32(run.counters.waiting)


@kernel
def _hand_out(run: HostRun, time: int) -> None:
    """Give the orders that wait to idle agents by lot, with new goals, as `agents.hand_out`."""
    counters, idle, seed = run.counters, len(run.grid.odds), run.settings.seed
    width = run.grid.width
    for agent in range(run.position.size):
        cell, place = run.position[agent], run.grid.goals[run.goal[0, agent]]
        away = abs(cell // width - place // width) + abs(cell % width - place % width)
        if run.kind[agent] == idle and away <= NEAR:
            run.goal[0, agent] = run.goal[1, agent] = run.grid.slot[cell]
    lot = chance.mix(chance.mix(seed, chance.ORDERS), time)
    while counters.waiting > 0:
        best, first = NOBODY, 1 << 31
        for agent in range(run.position.size):
            bits = chance.mix(lot, agent) >> 1
            if run.kind[agent] == idle and bits < first:
                best, first = agent, bits
        if best == NOBODY:
            break
        run.kind[best] = 0
        for ahead in range(KNOWN):
            purpose = chance.SECOND_GOAL if ahead else chance.FIRST_GOAL
            drawn = chance.mix(chance.mix(seed, purpose), time)
            run.goal[ahead, best] = _draw_goal(run.grid, ahead, drawn, best)
        counters.waiting -= 1
        counters.begun += 1


@formula
def paths_meet(mine: np.ndarray, one: int, theirs: np.ndarray, other: int, last: int) -> bool:
    """Return True if two agents meet or swap cells within the first `last` steps."""
    for t in range(1, last + 1):
        swaps = mine[one, t] == theirs[other, t - 1] and mine[one, t - 1] == theirs[other, t]
        if swaps or mine[one, t] == theirs[other, t]:
            return True
    return False


@kernel
def sort(values: np.ndarray) -> None:
    """Sort int64 [n] in place, the smallest first (heapsort; Williams 1964).

    https://doi.org/10.1145/512274.512284. By hand: numba compiles `heapq` for lists only, and its
    own sort of an array makes a list of partitions, which no kernel may.
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
