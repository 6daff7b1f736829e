"""The energy of a layout being annealed: what a move changes in cost and in broken demands.

Everything is kept up to date by differences; nothing is counted again. Compiled by numba.
"""

import numpy as np

from qdenv.native import formula, inlined, kernel
from qdenv.repair.anneal.state import Aisles, Board, Move, State, Trait

_FIELDS = 0x1111111  # the lowest bit of each of a tally's needs


@formula
def unmet_needs(traits: np.ndarray, tile: int, tally: int) -> int:
    """Mark the needs a tile has and a tally of its neighbours does not meet, one bit for each."""
    # A need is met at most four times: three bits tell.
    return traits[tile, Trait.NEEDS] & ~(tally | tally >> 1 | tally >> 2)


@formula
def _count_unmet(traits: np.ndarray, tile: int, tally: int) -> int:
    """Count the needs of a tile that a tally of its neighbours does not meet."""
    # The product gathers the sum of all fields in the highest of them.
    return unmet_needs(traits, tile, tally) * _FIELDS >> 24 & 7


@inlined
def _weigh_needs(board: Board, state: State, cell: int, new: int) -> int:
    """Count the change in broken adjacency demands if a cell took another tile."""
    traits, tally, old = board.traits, state.tally, state.candidate[cell]
    here = tally[cell]
    broken = _count_unmet(traits, new, here) - _count_unmet(traits, old, here)
    change = traits[new, Trait.UNIT] - traits[old, Trait.UNIT]
    if change:
        for place in (0, 2, 4, 6):
            side = cell + board.steps[place]
            tile, before = state.candidate[side], tally[side]
            broken += _count_unmet(traits, tile, before + change)
            broken -= _count_unmet(traits, tile, before)
    return broken


@formula
def _weigh_counts(board: Board, counts: np.ndarray, old: int, new: int) -> int:
    """Count the change in how far the counts are outside their bounds."""
    before, after = board.traits[old, Trait.BOUNDS], board.traits[new, Trait.BOUNDS]
    broken = 0
    if before != after:
        for bound in range(counts.size):
            count = counts[bound]
            step = (after >> bound & 1) - (before >> bound & 1)
            low, high = board.count_bounds[bound, 0], board.count_bounds[bound, 1]
            broken += max(low - count - step, 0) + max(count + step - high, 0)
            broken -= max(low - count, 0) + max(count - high, 0)
    return broken


@inlined
def put(board: Board, state: State, cell: int, new: int) -> None:
    """Set one cell; the ring and the aisles are `settle_driving`'s."""
    traits, old = board.traits, state.candidate[cell]
    change = traits[new, Trait.UNIT] - traits[old, Trait.UNIT]
    if change:
        for place in (0, 2, 4, 6):
            state.tally[cell + board.steps[place]] += change
    before, after = traits[old, Trait.BOUNDS], traits[new, Trait.BOUNDS]
    if before != after:
        for bound in range(state.counts.size):
            state.counts[bound] += (after >> bound & 1) - (before >> bound & 1)
    state.candidate[cell] = new


@inlined
def weigh(board: Board, state: State, move: Move, changes: int) -> tuple[float, int]:
    """Weigh the proposed changes; returns the rise in cost and in broken demands.

    All but the last are made: each is weighed where the ones before it stand.
    """
    rise, breaks = 0.0, 0
    for index in range(changes):
        if index:
            put(board, state, move.cells[index - 1], move.new[index - 1])
        cell, new = move.cells[index], move.new[index]
        old, own = state.candidate[cell], board.layout[cell]
        move.old[index] = old
        rise += board.change_cost[cell] * ((new != own) * 1.0 - (old != own) * 1.0)
        breaks += _weigh_needs(board, state, cell, new)
        breaks += _weigh_counts(board, state.counts, old, new)
    return rise, breaks


@formula
def unmake(board: Board, state: State, move: Move, changes: int) -> None:
    """Take the proposed changes back, of which all but the last are made."""
    for index in range(changes - 1):
        put(board, state, move.cells[index], move.old[index])


@inlined
def list_changed(board: Board, state: State, cell: int) -> None:
    """Keep the lists of changed cells up to date after a cell has changed."""
    changed, place, since = state.changed, state.place, state.since
    count, differs = state.num_changed[()], state.candidate[cell] != board.layout[cell]
    if differs and place[cell] == 0:
        changed[count] = cell
        place[cell] = count + 1
        state.num_changed[()] = count + 1
    elif not differs and place[cell] > 0:
        # The last cell of the list takes the place of the one that goes.
        last = changed[count - 1]
        changed[place[cell] - 1], place[last] = last, place[cell]
        place[cell] = 0
        state.num_changed[()] = count - 1
    if state.num_since[()] < since.size:
        since[state.num_since[()]] = cell
        state.num_since[()] += 1


@kernel
def remember(state: State) -> None:
    """Keep the candidate as the best layout, at the cost of what has changed since the last one."""
    if state.num_since[()] == state.since.size:
        for cell in range(state.candidate.size):
            state.best[cell] = state.candidate[cell]
    else:
        for entry in range(state.num_since[()]):
            state.best[state.since[entry]] = state.candidate[state.since[entry]]
    state.num_since[()] = 0


@formula
def _toggle(board: Board, aisles: Aisles, cell: int, opens: int) -> int:
    """Open or close a cell; returns the change in driving cells that no open square covers."""
    side, driving, closed, cover = aisles
    stride, broken = board.steps[4], -(driving[cell] == 1 and cover[cell] == 0)
    driving[cell] = opens
    broken += driving[cell] == 1 and cover[cell] == 0
    for corner_step in range(side * side):
        corner = cell - corner_step // side * stride - corner_step % side
        if corner < 0:
            continue
        before = closed[corner] == 0
        closed[corner] += -1 if opens else 1
        after = closed[corner] == 0
        # Only a square that opens or closes as a whole changes what its cells are covered by.
        if before == after:
            continue
        for inside_step in range(side * side):
            inside = corner + inside_step // side * stride + inside_step % side
            broken -= driving[inside] == 1 and cover[inside] == 0
            cover[inside] += 1 if after else -1
            broken += driving[inside] == 1 and cover[inside] == 0
    return broken


@kernel
def set_aisles(
    board: Board, aisles: Aisles, cells: np.ndarray, tiles: np.ndarray, changes: int
) -> int:
    """Bring the aisles to `tiles` on `cells`; returns the change in broken demands."""
    broken = 0
    for index in range(changes):
        cell, opens = cells[index], board.traits[tiles[index], Trait.DRIVES]
        if aisles.driving[cell] != opens:
            broken += _toggle(board, aisles, cell, opens)
    return broken
