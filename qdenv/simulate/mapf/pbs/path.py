"""The shortest path of one agent through a window, past the reservations of others.

A* (Hart, Nilsson and Raphael 1968, https://doi.org/10.1109/TSSC.1968.300136) over leg, timestep
and cell. What a path costs at least follows from the state, so each state is opened once. States
wait in buckets by delay, the steps a path is longer than the shortest way, and timestep; the
latest comes first. Beyond the window distances are exact (Li et al. 2021, section 4.2,
https://arxiv.org/abs/2005.07371).

A path ends with the window, or where the last known goal is served: there the agent vanishes, as
in the published planner, but never within the timesteps that are driven.
"""

from qdenv.grid import DOWN, LEFT, NUM_MOVES, RIGHT, UP
from qdenv.native import formula, kernel
from qdenv.simulate.mapf.host.distances import DistanceFields, distance
from qdenv.simulate.mapf.host.state import GridMap
from qdenv.simulate.mapf.pbs.workspace import (
    DONE,
    HOLDING,
    NO_STATE,
    Goals,
    JointPlan,
    PathSearch,
    ReservationTable,
)

NO_PATH = -1
_MOVE_BITS = 5  # an agent is here, and leaves right, left, down, up: one bit each
HERE = 1
_LAST_SEARCH = (1 << (31 - _MOVE_BITS)) - 1


@kernel
def forget_reservations(table: ReservationTable) -> None:
    """Begin with no reservations."""
    if table.search[()] >= _LAST_SEARCH:
        table.entry[:] = 0
        table.search[()] = 0
    table.search[()] += 1


@kernel
def reserve_path(table: ReservationTable, plan: JointPlan, agent: int, width: int) -> None:
    """Reserve the path of an agent."""
    last, cell = plan.path[agent].end, plan.cell[0, agent]
    for t in range(last):
        after = plan.cell[t + 1, agent]
        step = after - cell
        leaving = ((step == 1) << RIGHT) | ((step == -1) << LEFT)
        leaving |= ((step == width) << DOWN) | ((step == -width) << UP)
        reserve(table, t, cell, HERE | leaving)
        cell = after
    reserve(table, last, cell, HERE)


@formula
def reserve(table: ReservationTable, t: int, cell: int, bits: int) -> None:
    """Reserve a cell at a timestep."""
    old, number = table.entry[t, cell], table.search[()]
    fresh = (number << _MOVE_BITS) | bits
    table.entry[t, cell] = old | bits if old >> _MOVE_BITS == number else fresh


@formula
def _bits_at(table: ReservationTable, t: int, cell: int) -> int:
    """Read the bits of a cell at a timestep."""
    entry = table.entry[t, cell]
    return entry & ((1 << _MOVE_BITS) - 1) if entry >> _MOVE_BITS == table.search[()] else 0


@kernel
def find_path(
    search: PathSearch,
    table: ReservationTable,
    fields: DistanceFields,
    grid: GridMap,
    goals: Goals,
    agent: int,
    may_hold: bool,
    ties: int,
) -> int:
    """Find a shortest path into ``search.cells``, and its delay.

    Args:
        search: its arrays.
        table: what to avoid.
        fields: distances.
        grid: the layout.
        goals: what agents have to do.
        agent: the agent.
        may_hold: whether the agent may stay at its start, from the beginning on, against all
            reservations.
        ties: three bits that decide which way comes first of equals.

    Returns:
        The timestep at which the path ends, the window or sooner, or `NO_PATH`.
    """
    window, centre = table.entry.shape[0] - 1, search.offset.size // 2
    start, begin = goals.start[agent], goals.begin[agent]
    search.search[()] += 1
    search.delay[()] = 0
    if begin >= window:
        for t in range(window + 1):
            search.cells[t] = start
        return window
    search.bucket[:] = NO_STATE
    # What the agent serves now is behind it when it sets out.
    layer = (1 if begin > 0 else 0) + HOLDING * may_hold
    _open(search, _pack(search, layer, begin, centre), NO_STATE, 0, begin)
    delay, t = 0, begin
    while True:
        while t >= 0 and search.bucket[delay, t] == NO_STATE:
            t -= 1
        if t < 0:
            delay, t = delay + 1, window
            if delay == search.bucket.shape[0]:
                return NO_PATH
            continue
        state = search.bucket[delay, t]
        search.bucket[delay, t] = search.following[state]
        search.delay[()] = delay
        layer = state >> search.layer_bit
        if t == window or (layer % HOLDING == DONE and t >= search.horizon):
            break
        t = _expand(search, table, fields, grid, goals, agent, state, ties)
    _read_path(search, state, start)
    return t


@formula
def _pack(search: PathSearch, layer: int, t: int, place: int) -> int:
    """Number a state."""
    return (layer << search.layer_bit) | (t << search.time_bit) | place


@formula
def _place_of(search: PathSearch, state: int) -> int:
    """Read the place of a state."""
    return state & ((1 << search.time_bit) - 1)


@formula
def _time_of(search: PathSearch, state: int) -> int:
    """Read the timestep of a state."""
    return (state & ((1 << search.layer_bit) - 1)) >> search.time_bit


@formula
def _open(search: PathSearch, state: int, parent: int, delay: int, t: int) -> None:
    """Put a state into its bucket."""
    search.seen[state], search.parent[state] = search.search[()], parent
    search.following[state] = search.bucket[delay, t]
    search.bucket[delay, t] = state


@formula
def _steps_left(
    fields: DistanceFields, grid: GridMap, goals: Goals, agent: int, leg: int, cell: int
) -> int:
    """Count the steps from a cell to the last known goal, through those before it."""
    if leg == DONE:
        return 0
    steps = distance(fields, grid, goals.goal[leg, agent], cell)
    return steps + goals.between[agent] if leg == 0 else steps


@kernel
def _expand(
    search: PathSearch,
    table: ReservationTable,
    fields: DistanceFields,
    grid: GridMap,
    goals: Goals,
    agent: int,
    state: int,
    ties: int,
) -> int:
    """Open all states one step on; returns the latest timestep that may have an open state."""
    window, horizon, delay = table.entry.shape[0] - 1, search.horizon, search.delay[()]
    layer, t, place = state >> search.layer_bit, _time_of(search, state), _place_of(search, state)
    cell = goals.start[agent] + search.offset[place]
    holds, leg = layer >= HOLDING, layer % HOLDING
    steps, latest = _steps_left(fields, grid, goals, agent, leg, cell), t
    for turn in range(NUM_MOVES):
        # Of equals what is opened last is taken first: to wait, only once all goals are served.
        way = (turn + 1) % NUM_MOVES if leg == DONE else turn
        # Two of the bits choose the first direction, the third whether numbers then rise or fall.
        move = 0 if way == 0 else 1 + ((ties + ((ties >> 1) & 2 | 1) * way) & 3)
        to = cell + grid.steps[move]
        stays = holds and move == 0
        if not grid.free[to]:
            continue
        if not stays:
            if _bits_at(table, t + 1, to) & HERE:
                continue
            # Right and left, down and up are neighbouring numbers, from 1 on: the move against.
            if move > 0 and _bits_at(table, t, to) >> (1 + ((move - 1) ^ 1)) & 1:
                continue
        next_t, next_leg, step = t + 1, leg, 1
        if leg == DONE:
            step = 0  # nothing is left to be late for
            if goals.holds[to]:
                next_t = max(t + 1, horizon)
                if not _is_free(table, to, t + 2, next_t):
                    continue
        elif to == goals.cell[leg, agent]:
            until = t + 1 + goals.service_time[leg, agent]
            if not stays and not _is_free(table, to, t + 2, min(until, window)):
                continue
            # A service that the window cuts short does not count as done.
            next_leg = leg if until > window else leg + 1
            next_t = min(until, window)
        goes_on = leg + 1 if leg < DONE and to == goals.cell[leg, agent] else leg
        late = delay + step + _steps_left(fields, grid, goals, agent, goes_on, to) - steps
        reached = _pack(search, next_leg + HOLDING * stays, next_t, place + search.steps[move])
        if search.seen[reached] != search.search[()] and 0 <= late < search.bucket.shape[0]:
            _open(search, reached, state, late, next_t)
            if late == delay:
                latest = max(latest, next_t)
    return latest


@kernel
def _is_free(table: ReservationTable, cell: int, first: int, last: int) -> bool:
    """Return True if a cell is not reserved from one timestep to another, both counted."""
    taken = 0
    for t in range(first, last + 1):
        taken |= _bits_at(table, t, cell) & HERE
    return taken == 0


@kernel
def _read_path(search: PathSearch, state: int, start: int) -> None:
    """Walk back from the last state; between two states an agent is served where it is."""
    end = _time_of(search, state)
    while state != NO_STATE:
        before = search.parent[state]
        t_before = _time_of(search, before) if before != NO_STATE else -1
        for t in range(t_before + 1, end + 1):
            search.cells[t] = start + search.offset[_place_of(search, state)]
        state, end = before, t_before
