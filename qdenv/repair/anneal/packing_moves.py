"""Moves that pack obstacles: cells open and close, pieces of the driving area come and go.

A piece too many costs as much as an obstacle that nothing serves. Compiled by numba and free of the
interpreter lock.
"""

from typing import NamedTuple

import numpy as np

from qdenv.native import formula, inlined, kernel
from qdenv.repair.anneal.chance import LEVELS, LIMITS, below, bits, word
from qdenv.repair.anneal.connectivity import RING_PIECES, SIDES

TEMPERATURES = (0.6, 0.08)  # the first and the last, in broken demands
SWAP = round(0.7 * LEVELS)  # of `LEVELS`: change a second cell near the first one the other way
REACH = 2  # cells away in each direction
_WORDS = 2  # random words that one move uses
_SIDE = 2 * REACH + 1


class Ground(NamedTuple):
    """What is being packed; N cells with a ring around the layout."""

    free: np.ndarray  # int32 [F], the cells that may drive or not
    flips: np.ndarray  # bool [N], the same
    inside: np.ndarray  # bool [N], off the ring
    serves: np.ndarray  # bool [N], whether it may serve the obstacles beside it where it drives
    drives: np.ndarray  # bool [N], where robots drive now
    ring: np.ndarray  # uint8 [N], which of the eight neighbours drive
    steps: np.ndarray  # int64 [8], to these neighbours
    seen: np.ndarray  # int32 [N], number of the last search that came by
    front: np.ndarray  # int32 [N], room for a search
    tolls: np.ndarray  # int64 [4]: obstacles, unserved ones, pieces, searches so far


@formula
def _is_unserved(ground: Ground, cell: int) -> int:
    """Whether an obstacle stands on a cell and none of its neighbours serves it."""
    alone = ground.inside[cell] and not ground.drives[cell]
    for place in (0, 2, 4, 6):
        side = cell + ground.steps[place]
        alone = alone and not (ground.drives[side] and ground.serves[side])
    return int(alone)


@inlined
def _flip(ground: Ground, cell: int) -> None:
    """Open or close a cell; pieces are `_weigh_pieces`'s."""
    steps, unserved = ground.steps, -_is_unserved(ground, cell)
    for place in (0, 2, 4, 6):
        side = cell + steps[place]
        if ground.inside[side]:
            unserved -= _is_unserved(ground, side)
    ground.drives[cell] = not ground.drives[cell]
    ground.tolls[0] += -1 if ground.drives[cell] else 1
    unserved += _is_unserved(ground, cell)
    for place in (0, 2, 4, 6):
        side = cell + steps[place]
        if ground.inside[side]:
            unserved += _is_unserved(ground, side)
    ground.tolls[1] += unserved
    for place in range(8):
        ground.ring[cell + steps[place]] ^= 1 << (place + 4 & 7)


@kernel
def _count_around(ground: Ground, cell: int) -> int:
    """Count the pieces beside a cell, were it closed."""
    sides = ground.ring[cell] & SIDES
    if sides == 0 or RING_PIECES[ground.ring[cell]] == 1:
        return int(sides != 0)
    pieces, first = 0, ground.tolls[3] + 1
    for place in (0, 2, 4, 6):
        root = cell + ground.steps[place]
        if not sides >> place & 1 or ground.seen[root] >= first:
            continue
        pieces += 1
        ground.tolls[3] += 1
        ground.seen[root], ground.front[0], size = first, root, 1
        while size:
            size -= 1
            here = ground.front[size]
            for towards in (0, 2, 4, 6):
                there = here + ground.steps[towards]
                if ground.drives[there] and there != cell and ground.seen[there] < first:
                    ground.seen[there], ground.front[size] = first, there
                    size += 1
    return pieces


@inlined
def _weigh_pieces(ground: Ground, cell: int) -> None:
    """Bring the number of pieces up to date after a cell has opened or closed."""
    change = _count_around(ground, cell) - 1
    ground.tolls[2] += -change if ground.drives[cell] else change


@formula
def _break_count(ground: Ground, low: int, high: int) -> int:
    """Count the obstacles that are missing, are too many, or are unserved."""
    obstacles, unserved = ground.tolls[0], ground.tolls[1]
    return max(low - obstacles, 0) + max(obstacles - high, 0) + unserved


@formula
def _draw_partner(ground: Ground, cell: int, source: np.uint64) -> int:
    """Draw a cell near another, which may be off the ground."""
    step = below(source, 10, 10, _SIDE * _SIDE)
    return cell + (step // _SIDE - REACH) * ground.steps[4] + step % _SIDE - REACH


@inlined
def _try_flips(ground: Ground, cell: int, other: int, limit: float, low: int, high: int) -> None:
    """Change a cell, and another unless that is the same, if the energy stays within a limit."""
    pieces = ground.tolls[2]
    _flip(ground, cell)
    if other != cell:
        _flip(ground, other)
    # The dearest test comes last; pieces are weighed after one change, then after both.
    accept = _break_count(ground, low, high) <= limit - max(pieces - 1, 0)
    if accept:
        if other != cell:
            _flip(ground, other)
        _weigh_pieces(ground, cell)
        if other != cell:
            _flip(ground, other)
            _weigh_pieces(ground, other)
        accept = _break_count(ground, low, high) + ground.tolls[2] <= limit
    if not accept:
        _flip(ground, cell)
        if other != cell:
            _flip(ground, other)
        ground.tolls[2] = pieces


@kernel
def pack_moves(
    ground: Ground, low: int, high: int, seed: np.uint64, first: int, last: int, moves: int
) -> bool:
    """Make the moves `first` to `last` - 1; where a run is cut makes no difference.

    Args:
        ground: where to start; ends where the last move led.
        low: obstacles, at least.
        high: obstacles, at most.
        seed: of all draws.
        first: number of the first move.
        last: number of the one after the last.
        moves: of the whole run, during which the temperature falls geometrically.

    Returns:
        Whether nothing is broken; the run ends there.
    """
    hot, cold = TEMPERATURES
    for index in range(first, last):
        if _break_count(ground, low, high) == 0 and ground.tolls[2] <= 1:
            return True
        source = word(seed, _WORDS * index)
        cell = ground.free[below(source, 32, 32, ground.free.size)]
        other = cell
        if bits(source, 0, 10) < SWAP:
            other = _draw_partner(ground, cell, source)
            if not 0 <= other < ground.flips.size or not ground.flips[other]:
                continue
            if ground.drives[other] == ground.drives[cell]:
                continue
        temperature = hot * (cold / hot) ** (index / moves)
        limit = temperature * LIMITS[bits(word(seed, _WORDS * index + 1), 36, 10)]
        limit += _break_count(ground, low, high) + ground.tolls[2]
        _try_flips(ground, cell, other, limit, low, high)
    return _break_count(ground, low, high) == 0 and ground.tolls[2] <= 1
