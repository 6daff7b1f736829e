"""The shortest path of one agent through a window, past the reservations of others.

A* (Hart, Nilsson and Raphael 1968, https://doi.org/10.1109/TSSC.1968.300136) over leg, timestep
and cell. What a path costs at least follows from the state, so each state is opened once. States
wait in buckets by delay, the steps a path is longer than the shortest way, and timestep; the
latest comes first. Beyond the window distances are exact (Li et al. 2021, section 4.2,
https://arxiv.org/abs/2005.07371).

A path ends with the window, or where the last known goal is served: there the agent vanishes, as
in the published planner, but never within the timesteps that are driven.
"""

from typing import NamedTuple

import numpy as np

from qdenv.native import formula, kernel
from qdenv.simulate.mapf.host.fields import Fields
from qdenv.simulate.mapf.host.site import MOVES, Site
from qdenv.simulate.mapf.pbs.errands import DONE, Errands, first_leg, to_go
from qdenv.simulate.mapf.pbs.reservations import HERE, Reservations, bits_at, opposite

NO_STATE = -1
NO_PATH = -1
CAMPING = DONE + 1  # added to the leg while an agent stays at its start come what may
LAYERS = 2 * CAMPING
SEARCH, DELAY = range(2)  # entries of `Search.number`


class Search(NamedTuple):
    """Room for the search of one path of w timesteps, among S states.

    All cells in reach lie in a square around the start, which has P = (2 w + 1)^2 places: so the
    room stays the same for all agents, and in the cache. A state is a number whose bits are, from
    the lowest, the place, the timestep and the layer: the leg, and `CAMPING` where it holds.
    """

    seen: np.ndarray  # int64 [S], the search that last reached a state
    parent: np.ndarray  # int32 [S], the state before it
    following: np.ndarray  # int32 [S], the next state of the same bucket
    bucket: np.ndarray  # int32 [delays, w + 1], the first state of each bucket
    cells: np.ndarray  # int64 [w + 1], the path found
    number: np.ndarray  # int64 [2], the number of this search, and the delay of the path found
    offset: np.ndarray  # int64 [P], what leads from the start to the cell at a place
    steps: np.ndarray  # int64 [5], what each move adds to a place: wait, right, left, down, up
    time_bit: int  # the lowest bit of the timestep
    layer_bit: int  # the lowest bit of the layer


def make_search(window: int, width: int) -> Search:
    """Make room for the search of one path in a padded grid of so many columns."""
    side = 2 * window + 1
    row, column = np.divmod(np.arange(side * side), side)
    time_bit = (side * side).bit_length()
    layer_bit = time_bit + (window + 1).bit_length()
    states = LAYERS << layer_bit
    parent, following = np.empty((2, states), np.int32)
    # A step can lead away from the goal, which costs two.
    bucket = np.full((2 * window + 3, window + 1), NO_STATE, np.int32)
    return Search(
        np.zeros(states, np.int64),
        parent,
        following,
        bucket,
        np.zeros(window + 1, np.int64),
        np.zeros(2, np.int64),
        (row - window) * width + column - window,
        np.array([0, 1, -1, side, -side]),
        time_bit,
        layer_bit,
    )


@kernel
def find_path(
    search: Search,
    table: Reservations,
    fields: Fields,
    site: Site,
    errands: Errands,
    agent: int,
    terms: tuple[int, bool, int],
) -> int:
    """Find a shortest path into ``search.cells``, and its delay.

    Args:
        search: room.
        table: what to avoid.
        fields: distances.
        site: where.
        errands: what agents have to do.
        agent: who.
        terms: the timesteps that are driven; whether the agent may stay at its start, from the
            beginning on, against all reservations; bits that say which way comes first of equals.

    Returns:
        The timestep at which the path ends, the window or sooner, or `NO_PATH`.
    """
    horizon, may_camp, luck = terms
    window, centre = table.entry.shape[0] - 1, search.offset.size // 2
    start, begin = errands.start[agent], errands.begin[agent]
    search.number[SEARCH] += 1
    search.number[DELAY] = 0
    if begin >= window:
        for t in range(window + 1):
            search.cells[t] = start
        return window
    search.bucket[:] = NO_STATE
    layer = first_leg(errands, agent) + CAMPING * may_camp
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
        layer = state >> search.layer_bit
        if t == window or (layer % CAMPING == DONE and t >= horizon):
            break
        t = _expand(search, table, fields, site, errands, agent, (state, delay, t, luck, horizon))
    search.number[DELAY] = delay
    _read_path(search, state, start)
    return t


@formula
def _pack(search: Search, layer: int, t: int, place: int) -> int:
    """Number a state."""
    return (layer << search.layer_bit) | (t << search.time_bit) | place


@formula
def _place_of(search: Search, state: int) -> int:
    """Read the place of a state."""
    return state & ((1 << search.time_bit) - 1)


@formula
def _time_of(search: Search, state: int) -> int:
    """Read the timestep of a state."""
    return (state & ((1 << search.layer_bit) - 1)) >> search.time_bit


@formula
def _open(search: Search, state: int, parent: int, delay: int, t: int) -> None:
    """Put a state into its bucket."""
    search.seen[state], search.parent[state] = search.number[SEARCH], parent
    search.following[state] = search.bucket[delay, t]
    search.bucket[delay, t] = state


@kernel
def _expand(
    search: Search,
    table: Reservations,
    fields: Fields,
    site: Site,
    errands: Errands,
    agent: int,
    here: tuple[int, int, int, int, int],
) -> int:
    """Open all states one step on; returns the latest timestep that may have an open state."""
    state, delay, t, luck, horizon = here
    window = table.entry.shape[0] - 1
    layer, place = state >> search.layer_bit, _place_of(search, state)
    cell = errands.start[agent] + search.offset[place]
    camps, leg = layer >= CAMPING, layer % CAMPING
    steps, latest = to_go(fields, site, errands, agent, leg, cell), t
    for turn in range(MOVES):
        # Of equals what is opened last is taken first: to wait, only once all goals are served.
        way = (turn + 1) % MOVES if leg == DONE else turn
        move = 0 if way == 0 else 1 + ((luck + ((luck >> 1) & 2 | 1) * way) & 3)
        to = cell + site.steps[move]
        stays = camps and move == 0
        if not site.free[to]:
            continue
        if not stays:
            if bits_at(table, t + 1, to) & HERE:
                continue
            if move > 0 and bits_at(table, t, to) >> opposite(move) & 1:
                continue
        next_t, next_leg, step = t + 1, leg, 1
        if leg == DONE:
            step = 0  # nothing is left to be late for
            if errands.holds[to]:
                next_t = max(t + 1, horizon)
                if not _is_free(table, to, t + 2, next_t):
                    continue
        elif to == errands.cell[leg, agent]:
            until = t + 1 + errands.service_time[leg, agent]
            if not stays and not _is_free(table, to, t + 2, min(until, window)):
                continue
            # A service that the window cuts short does not count as done.
            next_leg = leg if until > window else leg + 1
            next_t = min(until, window)
        goes_on = leg + 1 if leg < DONE and to == errands.cell[leg, agent] else leg
        late = delay + step + to_go(fields, site, errands, agent, goes_on, to) - steps
        reached = _pack(search, next_leg + CAMPING * stays, next_t, place + search.steps[move])
        if search.seen[reached] != search.number[SEARCH] and 0 <= late < search.bucket.shape[0]:
            _open(search, reached, state, late, next_t)
            if late == delay:
                latest = max(latest, next_t)
    return latest


@kernel
def _is_free(table: Reservations, cell: int, first: int, last: int) -> bool:
    """Tell whether nobody reserved a cell from one timestep to another, both counted."""
    taken = 0
    for t in range(first, last + 1):
        taken |= bits_at(table, t, cell) & HERE
    return taken == 0


@kernel
def _read_path(search: Search, state: int, start: int) -> None:
    """Walk back from the last state; between two states an agent is served where it stands."""
    end = _time_of(search, state)
    while state != NO_STATE:
        before = search.parent[state]
        t_before = _time_of(search, before) if before != NO_STATE else -1
        for t in range(t_before + 1, end + 1):
            search.cells[t] = start + search.offset[_place_of(search, state)]
        state, end = before, t_before
