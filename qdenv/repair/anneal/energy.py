"""The energy of a layout under way: what a move changes in cost and in broken demands.

Everything is kept up to date by differences; nothing is counted anew. Compiled by numba.
"""

import numpy as np

from qdenv.repair.anneal.kernel import kernel
from qdenv.repair.anneal.state import Board, Column, Move, State


@kernel
def _broken_needs(table: np.ndarray, tile: int, tally: int) -> int:
    """Count the adjacency demands a tile breaks under a tally of its neighbours."""
    broken = 0
    for need in range(Column.NEEDS, table.shape[1]):
        broken += (tally & table[tile, need]) == 0
    return broken


@kernel
def _change_counts(board: Board, counts: np.ndarray, old: int, new: int) -> int:
    """Update the counts when a tile replaces another; returns the change in broken demands."""
    bounds, column = board.count_bounds, Column.BOUNDS
    broken, differ = 0, board.tile_table[old, column] ^ board.tile_table[new, column]
    for bound in range(counts.size):
        if differ >> bound & 1:
            count = counts[bound]
            broken -= max(bounds[bound, 0] - count, 0) + max(count - bounds[bound, 1], 0)
            count += 1 if board.tile_table[new, column] >> bound & 1 else -1
            broken += max(bounds[bound, 0] - count, 0) + max(count - bounds[bound, 1], 0)
            counts[bound] = count
    return broken


@kernel
def _put(board: Board, state: State, cell: int, new: int) -> int:
    """Set one cell; returns the change in broken adjacency demands."""
    table, tally, candidate = board.tile_table, state.tally, state.candidate
    old = candidate[cell]
    change = table[new, Column.UNIT] - table[old, Column.UNIT]
    broken = _broken_needs(table, new, tally[cell]) - _broken_needs(table, old, tally[cell])
    for step in (1, -1, board.stride, -board.stride):
        before, tile = tally[cell + step], candidate[cell + step]
        broken += _broken_needs(table, tile, before + change) - _broken_needs(table, tile, before)
        tally[cell + step] = before + change
    candidate[cell] = new
    return broken


@kernel
def _update_aisles(board: Board, state: State, cell: int, opens: int) -> int:
    """Open or close a cell; returns the change in driving cells that no open square covers."""
    driving, closed, cover, side = state.driving, state.closed, state.cover, board.aisle
    broken = -(driving[cell] == 1 and cover[cell] == 0)
    driving[cell] = opens
    broken += driving[cell] == 1 and cover[cell] == 0
    for corner_step in range(side * side):
        corner = cell - corner_step // side * board.stride - corner_step % side
        if corner < 0:
            continue
        before = closed[corner] == 0
        closed[corner] += -1 if opens else 1
        after = closed[corner] == 0
        # Only a square that opens or closes as a whole changes what its cells are covered by.
        if before == after:
            continue
        for inside_step in range(side * side):
            inside = corner + inside_step // side * board.stride + inside_step % side
            broken -= driving[inside] == 1 and cover[inside] == 0
            cover[inside] += 1 if after else -1
            broken += driving[inside] == 1 and cover[inside] == 0
    return broken


@kernel
def apply_move(board: Board, state: State, move: Move, changes: int) -> tuple[float, int]:
    """Make the proposed changes; returns the rise in cost and in broken demands."""
    rise, breaks = 0.0, 0
    for index in range(changes):
        cell, new = move.cells[index], move.new[index]
        old, own = state.candidate[cell], board.layout[cell]
        move.old[index] = old
        rise += board.change_cost[cell] * ((new != own) * 1.0 - (old != own) * 1.0)
        breaks += _put(board, state, cell, new)
        breaks += _change_counts(board, state.counts, old, new)
    return rise, breaks


@kernel
def undo_move(board: Board, state: State, move: Move, changes: int) -> None:
    """Take the proposed changes back."""
    table = board.tile_table
    for index in range(changes):
        cell, new, old = move.cells[index], move.new[index], move.old[index]
        _change_counts(board, state.counts, new, old)
        change = table[old, Column.UNIT] - table[new, Column.UNIT]
        for step in (1, -1, board.stride, -board.stride):
            state.tally[cell + step] += change
        state.candidate[cell] = old


@kernel
def set_driving_mask(
    board: Board, state: State, cells: np.ndarray, tiles: np.ndarray, changes: int
) -> None:
    """Bring the driving mask to `tiles` on `cells`, without the aisles."""
    for index in range(changes):
        state.driving[cells[index]] = board.tile_table[tiles[index], Column.DRIVES]


@kernel
def open_and_close(
    board: Board, state: State, cells: np.ndarray, tiles: np.ndarray, changes: int
) -> int:
    """Bring the driving mask and the aisles to `tiles` on `cells`; returns the aisles' change."""
    broken = 0
    for index in range(changes):
        cell, opens = cells[index], board.tile_table[tiles[index], Column.DRIVES]
        if board.aisle > 1 and state.driving[cell] != opens:
            broken += _update_aisles(board, state, cell, opens)
        state.driving[cell] = opens
    return broken


@kernel
def list_changed(board: Board, state: State, move: Move, changes: int) -> None:
    """Keep the list of changed cells up to date after an accepted move."""
    changed, place = state.changed, state.place
    for index in range(changes):
        cell = move.cells[index]
        if state.candidate[cell] != board.layout[cell] and place[cell] == 0:
            changed[0] += 1
            changed[changed[0]] = cell
            place[cell] = changed[0]
        elif state.candidate[cell] == board.layout[cell] and place[cell] > 0:
            # The last cell of the list takes the place of the one that goes.
            last = changed[changed[0]]
            changed[place[cell]], place[last] = last, place[cell]
            place[cell] = 0
            changed[0] -= 1
