"""Rules on whole rectangles, as on aisles and racks: how many they break, and moves of rectangles.

Cell by cell a layout would break such a rule on every way from one that obeys it to the next. Here
a rectangle opens or closes at once, another of the same shape often does the opposite, and what
that leaves in need beside them is retiled. Compiled by numba.
"""

import numpy as np

from qdenv.native import formula, inlined, kernel
from qdenv.repairs.anneal.moves import put, unmet_needs
from qdenv.repairs.anneal.state import (
    LEVELS,
    MOST,
    NO_TILE,
    SIDES,
    AnnealState,
    Board,
    Covers,
    Move,
    TileGroup,
    Trait,
    random_u64,
    uniform_below,
    uniform_bits,
)

# Probabilities, in parts of `LEVELS`.
_RECTANGLES = round(0.35 * LEVELS)  # move rectangles at all
_NEAR_CHANGED = round(0.70 * LEVELS)  # one at a changed cell
_SHORTER = round(0.5 * LEVELS)  # not of a whole shape: a slice of it
_SHIFT = round(0.6 * LEVELS)  # a second one beside the first does the opposite
_MOVE = round(0.2 * LEVELS)  # a second one anywhere does
_TRIES = 4  # to find that

# Which bits of a random word decide what, as (first bit, number of bits). The word that `propose`
# and the acceptance leave alone:
_RECTANGLES_BITS = (0, 10)
_CELL_BITS = (32, 32)
_FOCUS_BITS = (10, 10)
# The one before; its first six bits draw the tile as well:
_SHAPE_BITS, _SHORTER_BITS, _AXIS_BITS = (0, 8), (8, 10), (18, 1)
_LENGTH_BITS, _ROW_BITS, _COL_BITS = (20, 8), (28, 8), (36, 8)
_SECOND_BITS, _SIDE_BITS, _DISTANCE_BITS = (44, 10), (54, 2), (56, 8)


@kernel
def set_covers(covers: Covers, cells: np.ndarray, tiles: np.ndarray, changes: int) -> int:
    """Bring the covers to `tiles` on `cells`; returns how much the uncovered weight grows."""
    member, whole, lacking, weights = covers.member, covers.whole, covers.lacking, covers.weights
    broken = 0
    for index in range(changes):
        cell = cells[index]
        for rule in range(member.shape[0]):
            old, new = member[rule, cell], covers.belongs[rule, tiles[index]]
            if old == new:
                continue
            member[rule, cell] = new
            if whole[rule, cell] == 0:
                broken += weights[rule, cell] * ((new & 1) - (old & 1))
            for shape in range(covers.shapes.shape[0]):
                if covers.shapes[shape, 0] != rule:
                    continue
                area = covers.shapes[shape, 1] * covers.shapes[shape, 2]
                for place in range(area):
                    needed = covers.needed[shape, place]
                    joins = new == needed
                    if joins == (old == needed):
                        continue
                    corner = cell - covers.offsets[shape, place]
                    before = lacking[shape, corner]
                    lacking[shape, corner] = before + (-1 if joins else 1)
                    # Only a rectangle that becomes whole, or no longer is, covers others.
                    if before != joins:
                        continue
                    for inside_place in range(area):
                        if covers.needed[shape, inside_place] != 1:
                            continue
                        inside = corner + covers.offsets[shape, inside_place]
                        count = whole[rule, inside] + (1 if joins else -1)
                        whole[rule, inside] = count
                        alone = count == (0 if not joins else 1)
                        if alone and member[rule, inside] == 1:
                            broken -= weights[rule, inside] * (1 if joins else -1)
    covers.broken[()] += broken
    return broken


@inlined
def _add(board: Board, state: AnnealState, move: Move, changes: int, cell: int, tile: int) -> int:
    """Make one more change and note it, or note another tile for a cell; returns how many."""
    for index in range(changes):
        if move.cells[index] == cell:
            move.new[index] = tile
            put(board, state, cell, tile)
            return changes
    if changes < MOST:
        move.cells[changes], move.new[changes] = cell, tile
        move.old[changes] = state.candidate[cell]
        put(board, state, cell, tile)
        changes += 1
    return changes


@kernel
def _turn(
    board: Board,
    state: AnnealState,
    move: Move,
    changes: int,
    box: tuple[int, int, int],
    drives: int,
    tile_bits: int,
) -> int:
    """Open or close a rectangle: (first corner, rows, columns); returns how many changes."""
    corner, rows, cols = box
    stride, first = board.steps[4], changes
    if corner < 0 or corner + (rows - 1) * stride + cols > state.candidate.size:
        return changes
    for place in range(rows * cols):
        cell = corner + place // cols * stride + place % cols
        tile_set, old, own = board.tile_set[cell], state.candidate[cell], board.layout[cell]
        if board.traits[old, Trait.DRIVES] == drives:
            continue
        new = board.open_tile[cell] if drives else NO_TILE
        if board.fits[tile_set, drives, own]:
            new = own
        elif new == NO_TILE:
            new = board.choices[tile_set, drives, old, tile_bits]
        if new == NO_TILE:
            continue
        for index in range(first):
            if move.cells[index] == cell:
                break
        else:
            changes = _add(board, state, move, changes, cell, new)
    return changes


@formula
def _server(board: Board, cell: int, unmet: int) -> int:
    """Find a driving tile for a cell that meets one of the needs, its input tile first."""
    tile_set, own = board.tile_set[cell], board.layout[cell]
    if board.fits[tile_set, TileGroup.DRIVING, own] and board.traits[own, Trait.UNIT] & unmet:
        return own
    found = NO_TILE
    for tile in range(board.traits.shape[0] - 1):
        serves = board.traits[tile, Trait.UNIT] & unmet
        if found == NO_TILE and serves and board.fits[tile_set, TileGroup.DRIVING, tile]:
            found = tile
    return found


@kernel
def _serve(board: Board, state: AnnealState, move: Move, changes: int, turn: int) -> int:
    """Retile what the changes leave in need on them and beside them; returns how many changes."""
    traits, steps, candidate = board.traits, board.steps, state.candidate
    for index in range(changes):
        for way in range(5):
            cell = move.cells[index] + (steps[2 * way] if way < 4 else 0)
            tile = candidate[cell]
            unmet = unmet_needs(traits, tile, state.tally[cell])
            if unmet == 0:
                continue
            if traits[tile, Trait.DRIVES]:
                plain = board.open_tile[cell]
                if plain != NO_TILE and plain != tile:
                    changes = _add(board, state, move, changes, cell, plain)
                continue
            best, best_tile = -1, NO_TILE
            for place in range(4):
                side = cell + steps[2 * (place + turn & 3)]
                if traits[candidate[side], Trait.DRIVES] == 0:
                    continue
                server = _server(board, side, unmet)
                if server != NO_TILE and (best < 0 or server == board.layout[side]):
                    best, best_tile = side, server
            if best >= 0:
                changes = _add(board, state, move, changes, best, best_tile)
    return changes


@kernel
def propose_rectangles(
    board: Board, state: AnnealState, covers: Covers, move: Move, seed: np.uint64, number: int
) -> int:
    """Draw changes of whole rectangles into `move`; returns how many, -1 to leave it to others."""
    source = random_u64(seed, number + 7)
    if uniform_bits(source, _RECTANGLES_BITS) >= _RECTANGLES:
        return -1
    changed, stride = state.num_changed[()], board.steps[4]
    if changed == 0 or uniform_bits(source, _FOCUS_BITS) >= _NEAR_CHANGED:
        cell = board.free[uniform_below(source, _CELL_BITS, board.free.size)]
    else:
        cell = state.changed[uniform_below(source, _CELL_BITS, changed)]
    drives = 1 - board.traits[state.candidate[cell], Trait.DRIVES]
    source = random_u64(seed, number + 6)
    shape = covers.shapes[uniform_below(source, _SHAPE_BITS, covers.shapes.shape[0])]
    rows, cols = shape[1], shape[2]
    if uniform_bits(source, _SHORTER_BITS) < _SHORTER:
        if uniform_bits(source, _AXIS_BITS):
            rows = 1 + uniform_below(source, _LENGTH_BITS, rows)
        else:
            cols = 1 + uniform_below(source, _LENGTH_BITS, cols)
    row, col = uniform_below(source, _ROW_BITS, rows), uniform_below(source, _COL_BITS, cols)
    corner, tile_bits = cell - row * stride - col, uniform_bits(source, (0, 6))
    changes = _turn(board, state, move, 0, (corner, rows, cols), drives, tile_bits)
    second, side = uniform_bits(source, _SECOND_BITS), uniform_bits(source, _SIDE_BITS)
    other = -1
    if second < _SHIFT:
        length = (rows if side & 1 == 0 else cols) + 2
        distance = 1 + uniform_below(source, _DISTANCE_BITS, length)
        other = corner + distance * board.steps[2 * side]
    elif second < _SHIFT + _MOVE:
        for attempt in range(_TRIES):
            source = random_u64(seed, number + 2 + attempt)
            place = board.free[uniform_below(source, _CELL_BITS, board.free.size)]
            if other < 0 and board.traits[state.candidate[place], Trait.DRIVES] == drives:
                other = place - row * stride - col
    if other >= 0:
        box = (other, rows, cols)
        changes = _turn(board, state, move, changes, box, 1 - drives, tile_bits)
    changes = _serve(board, state, move, changes, side)
    for index in range(changes):
        put(board, state, move.cells[index], move.old[index])
    # Each cell but the first opens beside one that drives: turn the order round where it does not.
    if changes > 1 and drives and state.ring[move.cells[0]] & SIDES == 0:
        for index in range(changes // 2):
            last = changes - 1 - index
            for field in (move.cells, move.new, move.old):
                field[index], field[last] = field[last], field[index]
    return changes
