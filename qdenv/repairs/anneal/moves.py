"""The annealer's moves: up to five cells that change together, and what that changes.

A move that broke one rule for the sake of another would rarely be accepted; cells that depend on
one another are therefore changed at once. Cost and broken demands are kept up to date by
differences; nothing is counted again. Compiled by numba.
"""

import numpy as np

from qdenv.native import formula, inlined, kernel
from qdenv.repairs.anneal.connectivity import SET_BITS
from qdenv.repairs.anneal.state import (
    LEVELS,
    NO_TILE,
    AnnealState,
    Board,
    Move,
    TileGroup,
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
_MUCH = 25  # fewer free cells per broken demand: a driving area that must grow first
_STEPS = 18  # half of the draws near a changed cell step aside: to one of the 3x3 block, or stay
_TRIES = 3  # to find a partner anywhere
_NO_CELL = -1
_FIELDS = 0x1111111  # the lowest bit of each of a tally's needs

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
def unmet_needs(traits: np.ndarray, tile: int, tally: int) -> int:
    """Mark the needs a tile has and a tally of its neighbours does not meet, one bit for each."""
    # A need is met at most four times: three bits tell.
    return traits[tile, Trait.NEEDS] & ~(tally | tally >> 1 | tally >> 2)


@formula
def _count_unmet(traits: np.ndarray, tile: int, tally: int) -> int:
    """Count the needs of a tile that a tally of its neighbours does not meet."""
    # The product gathers the sum of all fields in the highest of them.
    return unmet_needs(traits, tile, tally) * _FIELDS >> 24 & 7


@formula
def _draw_tile(board: Board, state: AnnealState, cell: int, group: int, source: int) -> int:
    """Draw another tile for a cell, often its input tile, or `NO_TILE`, with seven bits."""
    old, own, tile_set = state.candidate[cell], board.layout[cell], board.tile_set[cell]
    drawn = board.choices[tile_set, group, old, source & 63]
    if own == old or not board.fits[tile_set, group, own]:
        return drawn
    # The input tile costs nothing: half of the draws go back to it, and all those of its role.
    alike = board.traits[drawn, Trait.ROLE] == board.traits[own, Trait.ROLE]
    return own if alike or source & 64 else drawn


@formula
def _partner(
    board: Board, state: AnnealState, cell: int, drives: int, seed: np.uint64, number: int
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
def _release(board: Board, state: AnnealState, move: Move) -> int:
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
def propose(board: Board, state: AnnealState, move: Move, seed: np.uint64, number: int) -> int:
    """Draw up to five changes into `move` with words from `number` on; returns how many."""
    source, changed = random_u64(seed, number), state.num_changed[()]
    if changed == 0 or uniform_bits(source, _FOCUS_BITS) >= _NEAR_CHANGED:
        cell = board.free[uniform_below(source, _CELL_BITS, board.free.size)]
    else:
        cell = state.changed[uniform_below(source, _CELL_BITS, changed)]
        step = uniform_below(source, _STEP_BITS, _STEPS)
        # A step may lead to a cell that cannot change: no tile is drawn there.
        cell = cell + board.steps[step] if step < 8 else cell
    new = _draw_tile(board, state, cell, TileGroup.ANY, uniform_bits(source, _TILE_BITS))
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
            new = _draw_tile(board, state, side, TileGroup.DRIVING, tile_bits)
            if new != NO_TILE:
                move.cells[changes], move.new[changes] = side, new
                changes += 1
    return changes


@inlined
def put(board: Board, state: AnnealState, cell: int, new: int) -> None:
    """Set one cell; rings, covers and the lists of changes are brought up to date elsewhere."""
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
def weigh(board: Board, state: AnnealState, move: Move, changes: int) -> tuple[float, int]:
    """Weigh the proposed changes; returns the rise in cost and in broken demands.

    All but the last are made: each is weighed where the ones before it stand.
    """
    rise, broken, traits = 0.0, 0, board.traits
    for index in range(changes):
        if index:
            put(board, state, move.cells[index - 1], move.new[index - 1])
        cell, new = move.cells[index], move.new[index]
        old, own, here = state.candidate[cell], board.layout[cell], state.tally[cell]
        move.old[index] = old
        rise += board.change_cost[cell] * ((new != own) * 1.0 - (old != own) * 1.0)
        # Adjacency: what the tile needs, and what its neighbours need of it.
        unmet = _count_unmet(traits, new, here) - _count_unmet(traits, old, here)
        change = traits[new, Trait.UNIT] - traits[old, Trait.UNIT]
        if change:
            for place in (0, 2, 4, 6):
                side = cell + board.steps[place]
                tile, tally = state.candidate[side], state.tally[side]
                unmet += _count_unmet(traits, tile, tally + change)
                unmet -= _count_unmet(traits, tile, tally)
        broken += unmet * board.demand_weight
        # Counts: how far they are outside their bounds.
        before, after = traits[old, Trait.BOUNDS], traits[new, Trait.BOUNDS]
        if before != after:
            for bound in range(state.counts.size):
                count = state.counts[bound]
                more = (after >> bound & 1) - (before >> bound & 1)
                low, high = board.count_bounds[bound, 0], board.count_bounds[bound, 1]
                broken += max(low - count - more, 0) + max(count + more - high, 0)
                broken -= max(low - count, 0) + max(count - high, 0)
    return rise, broken
