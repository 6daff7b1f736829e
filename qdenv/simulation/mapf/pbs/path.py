"""The shortest path of one agent through a window, past the reservations of others.

A* (Hart, Nilsson and Raphael 1968, https://doi.org/10.1109/TSSC.1968.300136) over leg, timestep
and cell. What a path costs at least follows from the state, so each state is opened once. States
wait in buckets by delay, the steps a path is longer than the shortest way, and timestep; the
latest comes first. Beyond the window distances are exact (Li et al. 2021, section 4.2,
https://arxiv.org/abs/2005.07371).

Where moves have costs, delays are sums of them, and states wait in a heap, in the same order: costs
of 1 give the same paths. A way to a state may then be cheaper than the one found first, so the
state is opened once more. Without costs that happens only where both known goals are one cell: the
first way found stays, which costs of 1 may shorten by a step or two.

A path ends with the window, or where the last known goal is served: there the agent vanishes, as
in the published planner, but never within the timesteps that are driven.
"""

from qdenv.grid import NUM_MOVES
from qdenv.native import formula, inlined, kernel
from qdenv.simulation.mapf.host.distances import DistanceFields, distance
from qdenv.simulation.mapf.host.state import GridMap, sift
from qdenv.simulation.mapf.pbs.workspace import (
    HOLDING,
    NO_STATE,
    SERVED,
    Goals,
    JointPlan,
    PathSearch,
)
from qdenv.simulation.mapf.planner import move_of

NO_PATH = -1
_MOVE_BITS = 5  # an agent is here, and leaves right, left, down, up: one bit each
HERE = 1
# What waits in the heap is packed: delay (below 2^25: a way out and two distances), timestep (below
# 2^5) and the number of the entry. The largest comes first.
_DELAY_BIT, _ENTRY_BITS, _NO_DELAY = 38, 33, (1 << 25) - 1
_LAST_TABLE = (1 << (31 - _MOVE_BITS)) - 1


@kernel
def forget_reservations(search: PathSearch) -> None:
    """Begin a table without reservations: those of other tables do not count."""
    if search.numbers.table >= _LAST_TABLE:
        search.reserved[:] = 0
        search.numbers.table = 0
    search.numbers.table += 1


@kernel
def reserve_path(search: PathSearch, plan: JointPlan, agent: int, width: int) -> None:
    """Reserve the path of an agent."""
    last, cell = plan.path[agent].end, plan.cell[0, agent]
    for t in range(last):
        after = plan.cell[t + 1, agent]
        reserve(search, t, cell, HERE | (1 << move_of(after - cell, width)))
        cell = after
    reserve(search, last, cell, HERE)


@formula
def reserve(search: PathSearch, t: int, cell: int, bits: int) -> None:
    """Reserve a cell at a timestep."""
    old, table = search.reserved[t, cell], search.numbers.table
    fresh = (table << _MOVE_BITS) | bits
    search.reserved[t, cell] = old | bits if old >> _MOVE_BITS == table else fresh


@formula
def _bits_at(search: PathSearch, t: int, cell: int) -> int:
    """Read the bits of a cell at a timestep."""
    entry = search.reserved[t, cell]
    return entry & ((1 << _MOVE_BITS) - 1) if entry >> _MOVE_BITS == search.numbers.table else 0


@kernel
def find_path(
    search: PathSearch,
    fields: DistanceFields,
    grid: GridMap,
    goals: Goals,
    agent: int,
    may_hold: bool,
    ties: int,
) -> int:
    """Find a shortest path, into ``search.cells``, past all that is reserved, and its delay.

    If the agent `may_hold` it may stay at its start, from the beginning on, against all
    reservations. The three bits of `ties` decide which way comes first of equals. Returns the
    timestep at which the path ends, the window or sooner, or `NO_PATH`.
    """
    window, centre = search.reserved.shape[0] - 1, search.offset.size // 2
    has_costs = grid.costs.size > 0
    start, begin = goals.start[agent], goals.begin[agent]
    search.numbers.search += 1
    search.numbers.delay = 0
    if begin >= window:
        search.cells[:] = start
        return window
    search.bucket[:] = NO_STATE
    search.numbers.entries, search.numbers.waiting = 0, 0
    first = _pack(search, goals.leg[agent] + HOLDING * may_hold, begin, centre)
    if has_costs:
        _push(search, first, NO_STATE, 0, begin)
    else:
        _open(search, first, NO_STATE, 0, begin)
    delay, t = 0, begin
    while True:
        while not has_costs and t >= 0 and search.bucket[delay, t] == NO_STATE:
            t -= 1
        if has_costs:
            state = _pop(search)
            if state == NO_STATE:
                return NO_PATH
            delay, t = search.least[state], _unpack(search, state)[1]
        elif t < 0:
            delay, t = delay + 1, window
            if delay == search.bucket.shape[0]:
                return NO_PATH
            continue
        else:
            state = search.bucket[delay, t]
            search.bucket[delay, t] = search.following[state]
        search.numbers.delay = delay
        layer = state >> search.layer_bit
        if t == window or (layer % HOLDING == SERVED and t >= search.horizon):
            break
        t = _expand(search, fields, grid, goals, agent, state, ties)
    # Walk back from the last state; between two states the agent is served where it is.
    last = t
    while state != NO_STATE:
        _, _, place = _unpack(search, state)
        state = search.parent[state]
        since = _unpack(search, state)[1] + 1 if state != NO_STATE else 0
        for time in range(since, last + 1):
            search.cells[time] = start + search.offset[place]
        last = since - 1
    return t


@formula
def _pack(search: PathSearch, layer: int, t: int, place: int) -> int:
    """Number a state."""
    return (layer << search.layer_bit) | (t << search.time_bit) | place


@formula
def _unpack(search: PathSearch, state: int) -> tuple[int, int, int]:
    """Read layer, timestep and place of a state."""
    t = (state & ((1 << search.layer_bit) - 1)) >> search.time_bit
    return state >> search.layer_bit, t, state & ((1 << search.time_bit) - 1)


@formula
def _open(search: PathSearch, state: int, parent: int, delay: int, t: int) -> None:
    """Put a state into its bucket."""
    search.seen[state], search.parent[state] = search.numbers.search, parent
    search.following[state] = search.bucket[delay, t]
    search.bucket[delay, t] = state


@kernel
def _push(search: PathSearch, state: int, parent: int, delay: int, t: int) -> None:
    """Put a state into the heap, unless a way to it that is as cheap is known."""
    known = search.seen[state] == search.numbers.search and search.least[state] <= delay
    if known or not 0 <= delay < _NO_DELAY:
        return
    search.seen[state], search.parent[state] = search.numbers.search, parent
    entry, hole, heap = search.numbers.entries, search.numbers.waiting, search.heap
    search.least[state], search.entry[entry] = delay, state
    search.numbers.entries, search.numbers.waiting = entry + 1, hole + 1
    rank = ((_NO_DELAY - delay) << _DELAY_BIT) | (t << _ENTRY_BITS) | entry
    while hole > 0 and heap[(hole - 1) // 2] < rank:
        heap[hole], hole = heap[(hole - 1) // 2], (hole - 1) // 2
    heap[hole] = rank


@kernel
def _pop(search: PathSearch) -> int:
    """Take the state with the least delay off the heap; `NO_STATE` if none waits."""
    heap = search.heap
    while search.numbers.waiting > 0:
        rank = heap[0]
        search.numbers.waiting -= 1
        heap[0] = heap[search.numbers.waiting]
        sift(heap, 0, search.numbers.waiting)
        state = search.entry[rank & ((1 << _ENTRY_BITS) - 1)]
        if search.least[state] == _NO_DELAY - (rank >> _DELAY_BIT):  # else found cheaper since
            return state
    return NO_STATE


@formula
def _steps_left(
    fields: DistanceFields, grid: GridMap, goals: Goals, agent: int, leg: int, cell: int
) -> int:
    """Count the steps, or costs, from a cell to the last known goal, through those before it."""
    if leg == SERVED:
        return 0
    steps = distance(fields, grid, goals.goal[leg, agent], cell)
    return steps + goals.between[agent] if leg == 0 else steps


@inlined
def _expand(
    search: PathSearch,
    fields: DistanceFields,
    grid: GridMap,
    goals: Goals,
    agent: int,
    state: int,
    ties: int,
) -> int:
    """Open all states one step on; returns the latest timestep that may have an open state."""
    window, horizon, delay = search.reserved.shape[0] - 1, search.horizon, search.numbers.delay
    layer, t, place = _unpack(search, state)
    cell = goals.start[agent] + search.offset[place]
    holds, leg, has_costs = layer >= HOLDING, layer % HOLDING, grid.costs.size > 0
    steps, latest = _steps_left(fields, grid, goals, agent, leg, cell), t
    for turn in range(NUM_MOVES):
        # Of equals what is opened last is taken first: to wait, only once all goals are served.
        way = (turn + 1) % NUM_MOVES if leg == SERVED else turn
        # Two of the bits choose the first direction, the third whether numbers then rise or fall.
        move = 0 if way == 0 else 1 + ((ties + ((ties >> 1) & 2 | 1) * way) & 3)
        to = cell + grid.steps[move]
        stays = holds and move == 0
        step = grid.costs[move, cell] if has_costs else 1
        if step == 0 or not grid.free[to]:
            continue
        if not stays:
            if _bits_at(search, t + 1, to) & HERE:
                continue
            # Right and left, down and up are neighbouring numbers, from 1 on: the move against.
            if move > 0 and _bits_at(search, t, to) >> (1 + ((move - 1) ^ 1)) & 1:
                continue
        next_t, next_leg, goes_on = t + 1, leg, leg
        if leg == SERVED:
            step = 0  # nothing is left to be late for
            if goals.holds[to]:
                next_t = max(t + 1, horizon)
                if not _is_free(search, to, t + 2, next_t):
                    continue
        elif to == goals.cell[leg, agent]:
            until = t + 1 + goals.service_time[leg, agent]
            if not stays and not _is_free(search, to, t + 2, min(until, window)):
                continue
            # A service that the window cuts short does not count as done.
            goes_on = leg + 1
            next_leg = leg if until > window else goes_on
            next_t = min(until, window)
        late = delay + step + _steps_left(fields, grid, goals, agent, goes_on, to) - steps
        reached = _pack(search, next_leg + HOLDING * stays, next_t, place + search.steps[move])
        if has_costs:
            _push(search, reached, state, late, next_t)
        elif search.seen[reached] != search.numbers.search and 0 <= late < search.bucket.shape[0]:
            _open(search, reached, state, late, next_t)
            if late == delay:
                latest = max(latest, next_t)
    return latest


@kernel
def _is_free(search: PathSearch, cell: int, first: int, last: int) -> bool:
    """Return True if a cell is not reserved from one timestep to another, both counted."""
    taken = 0
    for t in range(first, last + 1):
        taken |= _bits_at(search, t, cell) & HERE
    return taken == 0
