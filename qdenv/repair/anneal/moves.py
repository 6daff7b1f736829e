"""How the annealer draws its moves: up to five cells that change together. Compiled by numba.

A move that broke one rule for the sake of another would rarely be accepted; cells that depend on
one another are therefore changed at once.
"""

import numpy as np

from qdenv.native import formula, inlined, kernel
from qdenv.repair.anneal.connectivity import SET_BITS
from qdenv.repair.anneal.energy import lacking
from qdenv.repair.anneal.state import (
    LEVELS,
    NO_TILE,
    Asked,
    Board,
    Move,
    State,
    Trait,
    below,
    bits,
    word,
)

# How moves are drawn, in parts of `LEVELS`; measured on published and random layouts at equal
# numbers of moves: drawing near changed cells, and partners next door, each save two thirds of
# them.
FOCUS = round(0.70 * LEVELS)  # start at a changed cell or beside one
PAIR = round(0.85 * LEVELS)  # flip another cell the other way where one opens or closes
PAIR_EARLY = round(0.35 * LEVELS)  # the same while there is much to mend
MUCH = 25  # one broken demand to so many cells: a driving area that must grow first
NEXT_DOOR = round(0.90 * LEVELS)  # look for that partner among the eight neighbours
SIDE = round(0.33 * LEVELS)  # retile a neighbour on the driving area as well
STEPS = 18  # half of the draws near a changed cell step aside: to one of the 3x3 block, or stay
TRIES = 3  # to find that partner anywhere
NO_CELL = -1


@formula
def _draw_tile(board: Board, state: State, cell: int, asked: int, source: int) -> int:
    """Draw another tile for a cell, often its input tile, or `NO_TILE`, with seven bits."""
    old, own, palette = state.candidate[cell], board.layout[cell], board.palette[cell]
    drawn = board.choices[palette, asked, old, source & 63]
    if own == old or not board.fits[palette, asked, own]:
        return drawn
    # The input tile costs nothing: half of the draws go back to it, and all those of its role.
    alike = board.traits[drawn, Trait.ROLE] == board.traits[own, Trait.ROLE]
    return own if alike or source & 64 else drawn


@formula
def _pick(board: Board, state: State, source: np.uint64) -> int:
    """Pick a cell, mostly one that has changed or is beside one; it may be one that cannot."""
    changed = state.changed[0]
    if changed == 0 or bits(source, 0, 10) >= FOCUS:
        return board.free[below(source, 32, 32, board.free.size)]
    cell, step = state.changed[1 + below(source, 32, 32, changed)], below(source, 10, 10, STEPS)
    return cell + board.steps[step] if step < 8 else cell


@formula
def _partner(
    board: Board, state: State, cell: int, drives: int, seed: np.uint64, number: int
) -> int:
    """Find a free cell on or off the driving area, mostly beside `cell`, or `NO_CELL`."""
    source = word(seed, number)
    if bits(source, 0, 10) < NEXT_DOOR:
        ring = board.beside[cell] & (state.ring[cell] if drives else ~state.ring[cell])
        if ring == 0:
            return NO_CELL
        return cell + board.steps[SET_BITS[ring, 1 + below(source, 10, 10, SET_BITS[ring, 0])]]
    for attempt in range(1, TRIES + 1):
        other = board.free[below(word(seed, number + attempt), 32, 32, board.free.size)]
        if other != cell and board.traits[state.candidate[other], Trait.DRIVES] == drives:
            return other
    return NO_CELL


@kernel
def _release(board: Board, state: State, move: Move) -> int:
    """Retile the driving neighbours that the first change would leave wanting; returns changes.

    A shelf that goes may strand four endpoints: giving them up one by one would cost more at
    each step than the annealer pays.
    """
    traits, cell, changes = board.traits, move.cells[0], 1
    change = traits[move.new[0], Trait.UNIT] - traits[state.candidate[cell], Trait.UNIT]
    for place in (0, 2, 4, 6):
        side = cell + board.steps[place]
        own, tally, plain = state.candidate[side], state.tally[side], board.open_tile[side]
        idle = plain == own or not traits[own, Trait.DRIVES]
        if idle or plain == NO_TILE:
            continue
        if lacking(traits, own, tally + change) & ~lacking(traits, own, tally):
            move.cells[changes], move.new[changes] = side, plain
            changes += 1
    return changes


@inlined
def propose(board: Board, state: State, move: Move, seed: np.uint64, number: int) -> int:
    """Draw up to five changes into `move` with words from `number` on; returns how many."""
    source = word(seed, number)
    cell = _pick(board, state, source)
    new = _draw_tile(board, state, cell, Asked.EITHER, bits(source, 20, 7))
    if new == NO_TILE:
        return 0
    move.cells[0], move.new[0] = cell, new
    drives, other = board.traits[new, Trait.DRIVES], NO_CELL
    drove, changes = board.traits[state.candidate[cell], Trait.DRIVES], 1
    source = word(seed, number + 1)
    if drives != drove:
        early = state.tolls[0] * MUCH > board.free.size
        if bits(source, 0, 10) >= (PAIR_EARLY if early else PAIR):
            return _release(board, state, move)
        # Flip a partner the other way, so that the counts stay as they are.
        other = _partner(board, state, cell, drives, seed, number + 2)
        swap = NO_TILE
        if other != NO_CELL:
            swap = _draw_tile(board, state, other, drove, bits(source, 10, 7))
            if swap != board.layout[other] and bits(source, 46, 2) >= board.dear:
                swap = NO_TILE
        if swap != NO_TILE:
            move.cells[1], move.new[1] = other, swap
            changes = 2
    # An endpoint comes and goes with its shelf: retile a driving neighbour in the same move.
    if bits(source, 17, 10) < SIDE:
        place = 2 * bits(source, 27, 2)
        side = cell + board.steps[place]
        if state.ring[cell] >> place & 1 and side != other:
            new = _draw_tile(board, state, side, Asked.DRIVING, bits(source, 29, 7))
            if new != NO_TILE:
                move.cells[changes], move.new[changes] = side, new
                changes += 1
    return changes
