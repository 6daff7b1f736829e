"""The annealer's inner loop, compiled by numba and free of the interpreter lock.

Cells live on a grid padded by one ring of walls, so that no neighbour test needs a border case.
Kernels take plain arrays: a record of arrays would count references at every access. numba's disk
cache watches only the file of the outermost function: after editing `moves` or `topology`, touch
this file.

Arrays, N padded cells, K + 1 tiles (the last is the wall):

    tile    int8 [N], the layout               drive   int8 [N], 1 on the driving area
    near    int64 [N], tally of the four neighbours, three bits per tile
    home    int8 [N], the input                allowed int64 [N], bit k: tile k may stand here
    kinds   int64 [K + 1, ...], facts about tiles; columns below
    free    int64 [F], cells that may change
    calm    int8 [N], the driving tile with the fewest demands that may stand here, or -1
    cast    int64 [roles, 1 + K], how many tiles a role has, then these tiles
    limits  int64 [Q, 2], lowest and highest count of bound q; tiles count in bounds by FAMILY bits
    walk    int64 [8], steps to the eight neighbours, clockwise from the top
    parts   int64 [256], pieces that the open 4-neighbours of a ring pattern form
    move    int64 [5, 3], proposed (cell, new tile, old tile)
    changed int64 [1 + N], how many cells differ from the input, then these cells
    place   int64 [N], where in `changed` a cell stands, 0 for nowhere
"""

import numpy as np

from qdenv.native import compiled
from qdenv.repair.moves import DRIVES, FAMILY, NEEDS, WORD, draw, propose
from qdenv.repair.topology import may_close, may_open

ALWAYS = 1 << 62  # a bit of every tally, so that a tile without needs has them met


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
def _track(changed, place, tile, home, move, changes):
    """Keep the list of changed cells up to date after accepted changes."""
    for index in range(changes):
        cell = move[index, 0]
        if tile[cell] != home[cell] and place[cell] == 0:
            changed[0] += 1
            changed[changed[0]] = cell
            place[cell] = changed[0]
        elif tile[cell] == home[cell] and place[cell] > 0:
            last = changed[changed[0]]
            changed[place[cell]], place[last] = last, place[cell]
            place[cell] = 0
            changed[0] -= 1


@compiled
def _paint(drive, kinds, move, changes, side):
    """Set the driving area to the old (`side` 2) or new (1) tiles, without the aisles."""
    for index in range(changes):
        drive[move[index, 0]] = kinds[move[index, side], DRIVES]


@compiled
def _dares(rng, slope):
    """Accept a worse layout with probability exp(-slope)."""
    return draw(rng, 1 << 30) < np.exp(-slope) * (1 << 30)


@compiled
def _insist(boost, done, waited):
    """Raise the price of broken demands when no feasible layout came by for 5 % of the moves.

    A demand may be worth more than the schedule pays, as where every shelf has four endpoints of
    its own. Earlier in the run breaches are welcome: they are the way over the hills.
    """
    return min(1.05 * boost, 20.0) if done > 0.85 and waited > 50 else boost


@compiled
def cool(board, state, rng, moves, heats, pulls):
    """Anneal for a fixed number of moves; returns the price of the best feasible layout.

    Heat falls geometrically, the price of a broken demand rises linearly, and faster while no
    feasible layout comes by. `state.best` receives
    the cheapest layout that broke nothing; the price is infinite when there was none.
    """
    home, price, allowed, free, calm, kinds, cast, limits, walk, parts, linked, aisle = board
    tile, drive, near, counts, blocked, cover, mark, queue, sides = state[:9]
    move, changed, place, best, cost, broken = state[9:]
    lowest, heat, pull, stride = np.inf, heats[0], pulls[0], walk[4]
    boost, obeyed, period = 1.0, 0, max(moves // 1000, 1)
    for index in range(moves):
        if index % period == 0:
            done = index / moves
            boost = _insist(boost, done, (index - obeyed) // period)
            heat = heats[0] * (heats[1] / heats[0]) ** done
            pull = boost * (pulls[0] + (pulls[1] - pulls[0]) * done)
        if broken == 0:
            obeyed = index
            if cost < lowest:
                lowest = cost
                best[:] = tile
        changes = propose(
            tile, drive, near, home, allowed, free, calm, changed, kinds, cast, walk, rng, move
        )
        rise, breaks = _apply(tile, near, counts, home, price, kinds, limits, move, changes, stride)
        if aisle > 1:
            breaks += _open_and_close(drive, blocked, cover, kinds, aisle, stride, move, changes, 1)
        slope = rise + pull * breaks
        accept = slope <= 0 or (slope < 20 * heat and _dares(rng, slope / heat))
        if accept and linked:
            _paint(drive, kinds, move, changes, 2)
            accept = _stays_linked(drive, mark, queue, sides, kinds, walk, parts, move, changes)
            _paint(drive, kinds, move, changes, 1)
        if accept:
            cost += rise
            broken += breaks
            _track(changed, place, tile, home, move, changes)
        else:
            _undo(tile, near, counts, kinds, limits, move, changes, stride)
        _open_and_close(
            drive, blocked, cover, kinds, aisle, stride, move, changes, 1 if accept else 2
        )
    if broken == 0 and cost < lowest:
        lowest = cost
        best[:] = tile
    return lowest
