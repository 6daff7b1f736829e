"""How the annealer draws its moves: up to five cells that change together. Compiled by numba.

A move that broke one rule for the sake of another would rarely be accepted; cells that depend on
one another are therefore changed at once.
"""

import numpy as np

from qdenv.native import formula, inlined, kernel
from qdenv.repair.anneal.connectivity import SET_BITS
from qdenv.repair.anneal.energy import unmet_needs
from qdenv.repair.anneal.state import (
    LEVELS,
    NO_TILE,
    Board,
    Group,
    Move,
    State,
    Trait,
    random_u64,
    uniform_below,
    uniform_bits,
)

# Probabilities, in parts of `LEVELS`; measured on published and random layouts at equal numbers of
# moves: drawing near changed cells, and partners next door, each save two thirds of them.
_NEAR_CHANGED = round(0.70 * LEVELS)  # start at a changed cell or beside one
_PAIR = round(0.85 * LEVELS)  # flip another cell the other way where one opens or closes
_PAIR_EARLY = round(0.35 * LEVELS)  # the same while there is much to mend
_NEXT_DOOR = round(0.90 * LEVELS)  # look for that partner among the eight neighbours
_RETILE = round(0.33 * LEVELS)  # retile a neighbour on the driving area as well
_MUCH = 25  # one broken demand to so many cells: a driving area that must grow first
_STEPS = 18  # half of the draws near a changed cell step aside: to one of the 3x3 block, or stay
_TRIES = 3  # to find a partner anywhere
_NO_CELL = -1

# Which bits of a random word decide what, as (first bit, number of bits); no draws share a bit.
# The first word of a move:
_FOCUS_BITS = (0, 10)  # near a changed cell with probability NEAR_CHANGED
_STEP_BITS = (10, 10)  # one of `_STEPS` steps aside, equally likely
_TILE_BITS = (20, 7)  # the cell's new tile
_CELL_BITS = (32, 32)  # which cell, all equally likely
# The second; `loop` takes bits 36 to 45 of it to accept the move or not:
_PAIR_BITS = (0, 10)  # with a partner with probability PAIR, early PAIR_EARLY
_SWAP_BITS = (10, 7)  # the partner's new tile
_RETILE_BITS = (17, 10)  # with a retiled neighbour with probability RETILE
_SIDE_BITS = (27, 2)  # which of the four neighbours that is
_SIDE_TILE_BITS = (29, 7)  # its new tile
_LEAVE_BITS = (46, 2)  # whether the partner may leave its input tile: leave_quarters of four
# The third:
_NEXT_DOOR_BITS = (0, 10)  # the partner is a neighbour with probability NEXT_DOOR
_NEIGHBOUR_BITS = (10, 10)  # which of those that fit


@formula
def _draw_tile(board: Board, state: State, cell: int, group: int, source: int) -> int:
    """Draw another tile for a cell, often its input tile, or `NO_TILE`, with seven bits."""
    old, own, tile_set = state.candidate[cell], board.layout[cell], board.tile_set[cell]
    drawn = board.choices[tile_set, group, old, source & 63]
    if own == old or not board.fits[tile_set, group, own]:
        return drawn
    # The input tile costs nothing: half of the draws go back to it, and all those of its role.
    alike = board.traits[drawn, Trait.ROLE] == board.traits[own, Trait.ROLE]
    return own if alike or source & 64 else drawn


@formula
def _pick(board: Board, state: State, source: np.uint64) -> int:
    """Pick a cell, mostly one that has changed or is beside one; it may be one that cannot."""
    changed = state.num_changed[()]
    if changed == 0 or uniform_bits(source, _FOCUS_BITS) >= _NEAR_CHANGED:
        return board.free[uniform_below(source, _CELL_BITS, board.free.size)]
    cell = state.changed[uniform_below(source, _CELL_BITS, changed)]
    step = uniform_below(source, _STEP_BITS, _STEPS)
    return cell + board.steps[step] if step < 8 else cell


@formula
def _partner(
    board: Board, state: State, cell: int, drives: int, seed: np.uint64, number: int
) -> int:
    """Find a free cell on or off the driving area, mostly beside `cell`, or `_NO_CELL`."""
    source = random_u64(seed, number)
    if uniform_bits(source, _NEXT_DOOR_BITS) < _NEXT_DOOR:
        ring = board.free_ring[cell] & (state.ring[cell] if drives else ~state.ring[cell])
        if ring == 0:
            return _NO_CELL
        # `SET_BITS` lists how many bits are set, then which.
        place = SET_BITS[ring, 1 + uniform_below(source, _NEIGHBOUR_BITS, SET_BITS[ring, 0])]
        return cell + board.steps[place]
    for attempt in range(1, _TRIES + 1):
        source = random_u64(seed, number + attempt)
        other = board.free[uniform_below(source, _CELL_BITS, board.free.size)]
        if other != cell and board.traits[state.candidate[other], Trait.DRIVES] == drives:
            return other
    return _NO_CELL


@kernel
def _release(board: Board, state: State, move: Move) -> int:
    """Retile the driving neighbours that the first change would leave in need; returns changes.

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
        if unmet_needs(traits, own, tally + change) & ~unmet_needs(traits, own, tally):
            move.cells[changes], move.new[changes] = side, plain
            changes += 1
    return changes


@inlined
def propose(board: Board, state: State, move: Move, seed: np.uint64, number: int) -> int:
    """Draw up to five changes into `move` with words from `number` on; returns how many."""
    source = random_u64(seed, number)
    cell = _pick(board, state, source)
    new = _draw_tile(board, state, cell, Group.ANY, uniform_bits(source, _TILE_BITS))
    if new == NO_TILE:
        return 0
    move.cells[0], move.new[0] = cell, new
    drives, other = board.traits[new, Trait.DRIVES], _NO_CELL
    was_driving, changes = board.traits[state.candidate[cell], Trait.DRIVES], 1
    source = random_u64(seed, number + 1)
    if drives != was_driving:
        early = state.violations[()] * _MUCH > board.free.size
        if uniform_bits(source, _PAIR_BITS) >= (_PAIR_EARLY if early else _PAIR):
            return _release(board, state, move)
        # Flip a partner the other way, so that the counts stay as they are.
        other = _partner(board, state, cell, drives, seed, number + 2)
        swap = NO_TILE
        if other != _NO_CELL:
            swap = _draw_tile(board, state, other, was_driving, uniform_bits(source, _SWAP_BITS))
            leaves = swap != board.layout[other]
            if leaves and uniform_bits(source, _LEAVE_BITS) >= board.leave_quarters:
                swap = NO_TILE
        if swap != NO_TILE:
            move.cells[1], move.new[1] = other, swap
            changes = 2
    # An endpoint comes and goes with its shelf: retile a driving neighbour in the same move.
    if uniform_bits(source, _RETILE_BITS) < _RETILE:
        place = 2 * uniform_bits(source, _SIDE_BITS)
        side = cell + board.steps[place]
        if state.ring[cell] >> place & 1 and side != other:
            tile_bits = uniform_bits(source, _SIDE_TILE_BITS)
            new = _draw_tile(board, state, side, Group.DRIVING, tile_bits)
            if new != NO_TILE:
                move.cells[changes], move.new[changes] = side, new
                changes += 1
    return changes
