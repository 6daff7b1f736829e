"""How the annealer draws its moves: up to five cells that change together.

Compiled by numba; `kernels` explains the arrays.
"""

import numpy as np

from qdenv.native import compiled

DRIVES, WORD, ROLE, FAMILY, NEEDS = range(5)  # columns of `kinds`; needs fill the rest
# How moves are drawn, in per cent; measured on published and random layouts at equal numbers of
# moves: drawing near changed cells, and partners next door, each save about two thirds of them.
FOCUS = 70  # start at a changed cell or beside one
PAIR = 85  # flip another cell the other way when a cell joins or leaves the driving area
NEXT_DOOR = 90  # look for that partner among the eight neighbours
SIDE = 33  # retile a neighbour on the driving area as well
_U7, _U13, _U17, _U32 = (np.uint64(bits) for bits in (7, 13, 17, 32))


@compiled
def draw(rng, bound):
    """Draw from 0 .. bound - 1 (xorshift, high bits)."""
    x = rng[0]
    x ^= x << _U13
    x ^= x >> _U7
    x ^= x << _U17
    rng[0] = x
    return np.int64(((x >> _U32) * np.uint64(bound)) >> _U32)


@compiled
def _other_tile(tile, home, allowed, kinds, cast, rng, cell, drives):
    """Pick a tile for a cell, often its input tile, or -1; `drives` -1 asks for no area."""
    old, own = tile[cell], home[cell]
    fits = allowed[cell] >> own & 1 and (drives < 0 or kinds[own, DRIVES] == drives)
    if old != own and fits and draw(rng, 2):
        return own
    role = draw(rng, cast.shape[0])
    if drives >= 0 and kinds[cast[role, 1], DRIVES] != drives:
        return -1
    if role == kinds[old, ROLE] and (cast[role, 0] == 1 or draw(rng, 4)):
        return -1
    if fits and kinds[own, ROLE] == role and own != old:
        return own
    new = cast[role, 1 + draw(rng, cast[role, 0])]
    return new if new != old and allowed[cell] >> new & 1 else -1


@compiled
def _partner(drive, allowed, free, rng, cell, drives, stride):
    """Find a free cell on or off the driving area, mostly beside `cell`, or -1."""
    near = draw(rng, 100) < NEXT_DOOR
    for _ in range(6):
        other = free[draw(rng, free.size)]
        if near:
            other = cell + (draw(rng, 3) - 1) * stride + draw(rng, 3) - 1
        if other != cell and allowed[other] & (allowed[other] - 1) and drive[other] == drives:
            return other
    return -1


@compiled
def _pick(allowed, free, changed, rng, stride):
    """Pick a cell that may change, mostly one that did or is beside one; -1 where it may not."""
    if changed[0] == 0 or draw(rng, 100) >= FOCUS:
        return free[draw(rng, free.size)]
    cell = changed[1 + draw(rng, changed[0])]
    if draw(rng, 2):
        cell += (draw(rng, 3) - 1) * stride + draw(rng, 3) - 1
    return cell if allowed[cell] & (allowed[cell] - 1) else -1


@compiled
def _release(tile, near, allowed, calm, kinds, walk, move):
    """Retile the driving neighbours that the first change would leave wanting; returns changes.

    A shelf that goes may strand four endpoints: giving them up one by one would cost more at
    each step than the annealer pays.
    """
    cell, new, changes = move[0, 0], move[0, 1], 1
    change = kinds[new, WORD] - kinds[tile[cell], WORD]
    for place in (0, 2, 4, 6):
        side = cell + walk[place]
        own, tally = tile[side], near[side]
        if calm[side] < 0 or calm[side] == own or not kinds[own, DRIVES]:
            continue
        for need in range(NEEDS, kinds.shape[1]):
            if tally & kinds[own, need] and not (tally + change) & kinds[own, need]:
                move[changes, 0], move[changes, 1] = side, calm[side]
                changes += 1
                break
    return changes


@compiled
def propose(tile, drive, near, home, allowed, free, calm, changed, kinds, cast, walk, rng, move):
    """Draw up to five changes into `move`; returns how many."""
    changes, cell = 1, _pick(allowed, free, changed, rng, walk[4])
    if cell < 0:
        return 0
    new = _other_tile(tile, home, allowed, kinds, cast, rng, cell, -1)
    if new < 0:
        return 0
    move[0, 0], move[0, 1] = cell, new
    drives = drive[cell]
    if kinds[new, DRIVES] != drives:
        if draw(rng, 100) >= PAIR:
            return _release(tile, near, allowed, calm, kinds, walk, move)
        other = _partner(drive, allowed, free, rng, cell, kinds[new, DRIVES], walk[4])
        swap = -1
        if other >= 0:
            swap = _other_tile(tile, home, allowed, kinds, cast, rng, other, drives)
        if swap >= 0:
            move[1, 0], move[1, 1] = other, swap
            changes = 2
    if draw(rng, 100) < SIDE:
        side = cell + walk[2 * draw(rng, 4)]
        several = allowed[side] & (allowed[side] - 1)
        if several and drive[side] and (changes == 1 or side != move[1, 0]):
            new = _other_tile(tile, home, allowed, kinds, cast, rng, side, 1)
            if new >= 0:
                move[changes, 0], move[changes, 1] = side, new
                changes += 1
    return changes
