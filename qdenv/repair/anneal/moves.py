"""How the annealer draws its moves: up to five cells that change together. Compiled by numba.

A move that broke one rule for the sake of another would rarely be accepted; cells that depend on
one another are therefore changed at once.
"""

import numpy as np

from qdenv.repair.anneal.kernel import kernel
from qdenv.repair.anneal.state import NO_TILE, Board, Column, Move, State

# How moves are drawn, in per cent; measured on published and random layouts at equal numbers of
# moves: drawing near changed cells, and partners next door, each save about two thirds of them.
FOCUS = 70  # start at a changed cell or beside one
PAIR = 85  # flip another cell the other way when a cell joins or leaves the driving area
NEXT_DOOR = 90  # look for that partner among the eight neighbours
SIDE = 33  # retile a neighbour on the driving area as well
PARTNER_TRIES = 6
EITHER = -1  # a tile on or off the driving area
NO_CELL = -1
_U7, _U13, _U17, _U32 = (np.uint64(bits) for bits in (7, 13, 17, 32))


@kernel
def draw(rng: np.ndarray, bound: int) -> int:
    """Draw from 0 .. bound - 1 (xorshift64, high bits; Marsaglia 2003).

    https://doi.org/10.18637/jss.v008.i14
    """
    x = rng[0]
    x ^= x << _U13
    x ^= x >> _U7
    x ^= x << _U17
    rng[0] = x
    # The high half times the bound, instead of a remainder: no division, no bias to low bits.
    return int(np.int64(((x >> _U32) * np.uint64(bound)) >> _U32))


@kernel
def _is_free(board: Board, cell: int) -> bool:
    """Whether more than one tile may stand here: more than one bit is set."""
    return board.allowed[cell] & (board.allowed[cell] - 1) != 0


@kernel
def _step_aside(board: Board, rng: np.ndarray, cell: int) -> int:
    """Step to a random cell of the 3x3 block around `cell`, itself included."""
    return cell + (draw(rng, 3) - 1) * board.stride + draw(rng, 3) - 1


@kernel
def _other_tile(board: Board, state: State, rng: np.ndarray, cell: int, drives: int) -> int:
    """Draw another tile for a cell, often its input tile, or `NO_TILE`.

    `drives` asks for a tile on (1) or off (0) the driving area, or for `EITHER`.
    """
    table, members = board.tile_table, board.role_members
    old, own = state.candidate[cell], board.layout[cell]
    fits = board.allowed[cell] >> own & 1 and (drives < 0 or table[own, Column.DRIVES] == drives)
    # The input tile costs nothing: half of the draws go back to it.
    if old != own and fits and draw(rng, 2):
        return own
    # Draw a role first: three kinds of station should not be three times as likely.
    role = draw(rng, members.shape[0])
    if drives >= 0 and table[members[role, 1], Column.DRIVES] != drives:
        return NO_TILE
    # Another kind of the same role matters to the counts only, which seldom ask for it.
    if role == table[old, Column.ROLE] and (members[role, 0] == 1 or draw(rng, 4)):
        return NO_TILE
    if fits and table[own, Column.ROLE] == role and own != old:
        return own
    new = members[role, 1 + draw(rng, members[role, 0])]
    return new if new != old and board.allowed[cell] >> new & 1 else NO_TILE


@kernel
def _partner(board: Board, state: State, rng: np.ndarray, cell: int, drives: int) -> int:
    """Find a free cell on or off the driving area, mostly beside `cell`, or `NO_CELL`."""
    near = draw(rng, 100) < NEXT_DOOR
    for _ in range(PARTNER_TRIES):
        other = board.free[draw(rng, board.free.size)]
        if near:
            other = _step_aside(board, rng, cell)
        if other != cell and _is_free(board, other) and state.driving[other] == drives:
            return other
    return NO_CELL


@kernel
def _pick(board: Board, state: State, rng: np.ndarray) -> int:
    """Pick a cell that may change, mostly one that did or is beside one; may find `NO_CELL`."""
    changed = state.changed
    if changed[0] == 0 or draw(rng, 100) >= FOCUS:
        return board.free[draw(rng, board.free.size)]
    cell = changed[1 + draw(rng, changed[0])]
    if draw(rng, 2):
        cell = _step_aside(board, rng, cell)
    return cell if _is_free(board, cell) else NO_CELL


@kernel
def _release(board: Board, state: State, move: Move) -> int:
    """Retile the driving neighbours that the first change would leave wanting; returns changes.

    A shelf that goes may strand four endpoints: giving them up one by one would cost more at
    each step than the annealer pays.
    """
    table, open_tile, cell, changes = board.tile_table, board.open_tile, move.cells[0], 1
    change = table[move.new[0], Column.UNIT] - table[state.candidate[cell], Column.UNIT]
    for place in (0, 2, 4, 6):
        side = cell + board.offsets[place]
        own, tally = state.candidate[side], state.tally[side]
        if open_tile[side] == NO_TILE or open_tile[side] == own or not table[own, Column.DRIVES]:
            continue
        for need in range(Column.NEEDS, table.shape[1]):
            if tally & table[own, need] and not (tally + change) & table[own, need]:
                move.cells[changes], move.new[changes] = side, open_tile[side]
                changes += 1
                break
    return changes


@kernel
def _pair(board: Board, state: State, move: Move, rng: np.ndarray) -> int:
    """Flip a partner the other way, so that the counts stay as they are; returns changes."""
    cell, drives = move.cells[0], board.tile_table[move.new[0], Column.DRIVES]
    other = _partner(board, state, rng, cell, drives)
    swap = NO_TILE
    if other != NO_CELL:
        swap = _other_tile(board, state, rng, other, state.driving[cell])
    if swap == NO_TILE:
        return 1
    move.cells[1], move.new[1] = other, swap
    return 2


@kernel
def propose(board: Board, state: State, move: Move, rng: np.ndarray) -> int:
    """Draw up to five changes into `move`; returns how many."""
    changes, cell = 1, _pick(board, state, rng)
    if cell == NO_CELL:
        return 0
    new = _other_tile(board, state, rng, cell, EITHER)
    if new == NO_TILE:
        return 0
    move.cells[0], move.new[0] = cell, new
    if board.tile_table[new, Column.DRIVES] != state.driving[cell]:
        if draw(rng, 100) >= PAIR:
            return _release(board, state, move)
        changes = _pair(board, state, move, rng)
    # An endpoint comes and goes with its shelf: retile a driving neighbour in the same move.
    if draw(rng, 100) < SIDE:
        side = cell + board.offsets[2 * draw(rng, 4)]
        partner = move.cells[1] if changes == 2 else NO_CELL
        if _is_free(board, side) and state.driving[side] and side != partner:
            new = _other_tile(board, state, rng, side, 1)
            if new != NO_TILE:
                move.cells[changes], move.new[changes] = side, new
                changes += 1
    return changes
