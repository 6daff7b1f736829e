"""The annealer's inner loop, compiled by numba and free of the interpreter lock.

Cells live on a grid padded by one ring of walls, so that no neighbour test needs a border case.
Kernels take plain arrays: a record of arrays would count references at every access. All of them
stay in this file, because numba's disk cache watches only the file of the function it caches.

Arrays, N padded cells, K + 1 tiles (the last is the wall):

    tile    int8 [N], the layout               drive   int8 [N], 1 on the driving area
    near    int64 [N], tally of the four neighbours, three bits per tile
    home    int8 [N], the input                allowed int64 [N], bit k: tile k may stand here
    kinds   int64 [K + 1, ...], facts about tiles; columns below
    free    int64 [F], cells that may change
    cast    int64 [roles, 1 + K], how many tiles a role has, then these tiles
    limits  int64 [Q, 2], lowest and highest count of bound q; tiles count in bounds by FAMILY bits
    walk    int64 [8], steps to the eight neighbours, clockwise from the top
    parts   int64 [256], pieces that the open 4-neighbours of a ring pattern form
    move    int64 [3, 3], proposed (cell, new tile, old tile)
"""

import numpy as np

from qdenv.repair.topology import compiled, may_close, may_open

DRIVES, WORD, ROLE, FAMILY, NEEDS = range(5)  # columns of `kinds`; needs fill the rest
ALWAYS = 1 << 62  # a bit of every tally, so that a tile without needs has them met
_U7, _U13, _U17, _U32 = (np.uint64(bits) for bits in (7, 13, 17, 32))


@compiled
def _draw(rng, bound):
    """Draw from 0 .. bound - 1 (xorshift, high bits)."""
    x = rng[0]
    x ^= x << _U13
    x ^= x >> _U7
    x ^= x << _U17
    rng[0] = x
    return np.int64(((x >> _U32) * np.uint64(bound)) >> _U32)


@compiled
def _lacks(kinds, kind, tally):
    """Count the adjacency demands a tile breaks under a tally of its neighbours."""
    lacking = 0
    for place in range(NEEDS, kinds.shape[1]):
        lacking += (tally & kinds[kind, place]) == 0
    return lacking


@compiled
def _count(kinds, counts, limits, old, new):
    """Update the counts when a tile replaces another; returns the change in broken demands."""
    broken, differ = 0, kinds[old, FAMILY] ^ kinds[new, FAMILY]
    for bound in range(counts.size):
        if differ >> bound & 1:
            count = counts[bound]
            broken -= max(limits[bound, 0] - count, 0) + max(count - limits[bound, 1], 0)
            count += 1 if kinds[new, FAMILY] >> bound & 1 else -1
            broken += max(limits[bound, 0] - count, 0) + max(count - limits[bound, 1], 0)
            counts[bound] = count
    return broken


@compiled
def _put(tile, near, kinds, cell, new, stride):
    """Set one cell; returns the change in broken adjacency demands."""
    old = tile[cell]
    change = kinds[new, WORD] - kinds[old, WORD]
    broken = _lacks(kinds, new, near[cell]) - _lacks(kinds, old, near[cell])
    for step in (1, -1, stride, -stride):
        tally, kind = near[cell + step], tile[cell + step]
        broken += _lacks(kinds, kind, tally + change) - _lacks(kinds, kind, tally)
        near[cell + step] = tally + change
    tile[cell] = new
    return broken


@compiled
def _widen(drive, blocked, cover, aisle, stride, cell, opens):
    """Open or close a cell; returns the change in driving cells that no open square covers.

    `blocked` (int64 [N]): closed cells in the aisle square that starts here; `cover` (int64 [N]):
    open squares over the cell.
    """
    broken = -(drive[cell] == 1 and cover[cell] == 0)
    drive[cell] = opens
    broken += drive[cell] == 1 and cover[cell] == 0
    for corner_step in range(aisle * aisle):
        corner = cell - corner_step // aisle * stride - corner_step % aisle
        if corner < 0:
            continue
        before = blocked[corner] == 0
        blocked[corner] += -1 if opens else 1
        after = blocked[corner] == 0
        if before == after:
            continue
        for inside_step in range(aisle * aisle):
            inside = corner + inside_step // aisle * stride + inside_step % aisle
            broken -= drive[inside] == 1 and cover[inside] == 0
            cover[inside] += 1 if after else -1
            broken += drive[inside] == 1 and cover[inside] == 0
    return broken


@compiled
def _other_tile(tile, home, allowed, kinds, cast, rng, cell, drives):
    """Pick a tile for a cell, often its input tile, or -1; `drives` -1 asks for no area."""
    old, own = tile[cell], home[cell]
    fits = allowed[cell] >> own & 1 and (drives < 0 or kinds[own, DRIVES] == drives)
    if old != own and fits and _draw(rng, 2):
        return own
    role = _draw(rng, cast.shape[0])
    if drives >= 0 and kinds[cast[role, 1], DRIVES] != drives:
        return -1
    if role == kinds[old, ROLE] and (cast[role, 0] == 1 or _draw(rng, 4)):
        return -1
    if fits and kinds[own, ROLE] == role and own != old:
        return own
    new = cast[role, 1 + _draw(rng, cast[role, 0])]
    return new if new != old and allowed[cell] >> new & 1 else -1


@compiled
def _partner(drive, allowed, free, rng, cell, drives, stride):
    """Find a free cell on or off the driving area, near `cell` half the time, or -1."""
    near = _draw(rng, 2)
    for _ in range(6):
        other = free[_draw(rng, free.size)]
        if near:
            other = cell + (_draw(rng, 5) - 2) * stride + _draw(rng, 5) - 2
            if other < 0 or other >= drive.size:
                continue
        if other != cell and allowed[other] & (allowed[other] - 1) and drive[other] == drives:
            return other
    return -1


@compiled
def _propose(tile, drive, home, allowed, free, kinds, cast, walk, rng, move):
    """Draw up to three changes into `move`; returns how many."""
    changes, cell = 1, free[_draw(rng, free.size)]
    new = _other_tile(tile, home, allowed, kinds, cast, rng, cell, -1)
    if new < 0:
        return 0
    move[0, 0], move[0, 1] = cell, new
    drives = drive[cell]
    if kinds[new, DRIVES] != drives and _draw(rng, 10) < 7:
        other = _partner(drive, allowed, free, rng, cell, kinds[new, DRIVES], walk[4])
        swap = -1
        if other >= 0:
            swap = _other_tile(tile, home, allowed, kinds, cast, rng, other, drives)
        if swap >= 0:
            move[1, 0], move[1, 1] = other, swap
            changes = 2
    if _draw(rng, 3) == 0:
        side = cell + walk[2 * _draw(rng, 4)]
        several = allowed[side] & (allowed[side] - 1)
        if several and drive[side] and (changes == 1 or side != move[1, 0]):
            new = _other_tile(tile, home, allowed, kinds, cast, rng, side, 1)
            if new >= 0:
                move[changes, 0], move[changes, 1] = side, new
                changes += 1
    return changes


@compiled
def _stays_linked(drive, mark, queue, sides, kinds, walk, parts, move, changes):
    """Whether the proposed changes keep the driving area in one piece; opens before it closes."""
    for index in range(changes):
        if kinds[move[index, 1], DRIVES] and not drive[move[index, 0]]:
            if not may_open(drive, move[index, 0], walk[4]):
                return False
            drive[move[index, 0]] = 1
    for index in range(changes):
        if drive[move[index, 0]] and not kinds[move[index, 1], DRIVES]:
            if not may_close(drive, mark, queue, sides, walk, parts, move[index, 0]):
                return False
            drive[move[index, 0]] = 0
    return True


@compiled
def _apply(tile, near, counts, home, price, kinds, limits, move, changes, stride):
    """Make the proposed changes; returns the rise in price and in broken demands."""
    rise, breaks = 0.0, 0
    for index in range(changes):
        cell, new = move[index, 0], move[index, 1]
        old = tile[cell]
        move[index, 2] = old
        rise += price[cell] * ((new != home[cell]) * 1.0 - (old != home[cell]) * 1.0)
        breaks += _put(tile, near, kinds, cell, new, stride)
        breaks += _count(kinds, counts, limits, old, new)
    return rise, breaks


@compiled
def _undo(tile, near, counts, kinds, limits, move, changes, stride):
    """Take the proposed changes back."""
    for index in range(changes):
        cell, new, old = move[index, 0], move[index, 1], move[index, 2]
        _count(kinds, counts, limits, new, old)
        change = kinds[old, WORD] - kinds[new, WORD]
        for step in (1, -1, stride, -stride):
            near[cell + step] += change
        tile[cell] = old


@compiled
def _open_and_close(drive, blocked, cover, kinds, aisle, stride, move, changes, side):
    """Bring the driving area to the old (`side` 2) or new (1) tiles; returns the aisles' change."""
    broken = 0
    for index in range(changes):
        cell, opens = move[index, 0], kinds[move[index, side], DRIVES]
        if aisle > 1 and drive[cell] != opens:
            broken += _widen(drive, blocked, cover, aisle, stride, cell, opens)
        drive[cell] = opens
    return broken


@compiled
def cool(board, state, rng, moves, heats, pulls):
    """Anneal for a fixed number of moves; returns the price of the best feasible layout.

    Heat falls geometrically, the price of a broken demand rises linearly. `state.best` receives
    the cheapest layout that broke nothing; the price is infinite when there was none.
    """
    home, price, allowed, free, kinds, cast, limits, walk, parts, linked, aisle = board
    tile, drive, near, counts, blocked, cover, mark, queue, sides, move, best, cost, broken = state
    lowest, heat, pull, stride = np.inf, heats[0], pulls[0], walk[4]
    for index in range(moves):
        if index & 1023 == 0:
            done = index / moves
            heat = heats[0] * (heats[1] / heats[0]) ** done
            pull = pulls[0] + (pulls[1] - pulls[0]) * done
        if broken == 0 and cost < lowest:
            lowest = cost
            best[:] = tile
        changes = _propose(tile, drive, home, allowed, free, kinds, cast, walk, rng, move)
        rise, breaks = _apply(tile, near, counts, home, price, kinds, limits, move, changes, stride)
        if aisle > 1:
            breaks += _open_and_close(drive, blocked, cover, kinds, aisle, stride, move, changes, 1)
        slope = rise + pull * breaks
        accept = slope <= 0 or _draw(rng, 1 << 30) < np.exp(-slope / heat) * (1 << 30)
        if accept and linked:
            for change in range(changes):
                drive[move[change, 0]] = kinds[move[change, 2], DRIVES]
            accept = _stays_linked(drive, mark, queue, sides, kinds, walk, parts, move, changes)
            for change in range(changes):
                drive[move[change, 0]] = kinds[move[change, 1], DRIVES]
        if accept:
            cost += rise
            broken += breaks
        else:
            _undo(tile, near, counts, kinds, limits, move, changes, stride)
        _open_and_close(
            drive, blocked, cover, kinds, aisle, stride, move, changes, 1 if accept else 2
        )
    if broken == 0 and cost < lowest:
        lowest = cost
        best[:] = tile
    return lowest
