"""Keeping the driving area in one piece: the ring test, the lockstep search, the joining of parts.

Compiled by numba and free of the interpreter lock. Cells live on a grid padded by one ring of
walls, so that no neighbour test needs a border case; `kernels` explains the arrays.
"""

import numpy as np

from qdenv.native import compiled

SEARCH = 4000  # cells a connectivity search may visit before the move is refused


def ring_parts() -> np.ndarray:
    """Count, for each 3x3 ring pattern, the pieces its open 4-neighbours form (int64 [256]).

    Bit b is ring place b, clockwise from the top; even places are 4-neighbours. Two neighbouring
    even places hang together when the corner between them is open. One piece: a simple point.
    """
    bits = np.array([[pattern >> place & 1 for place in range(8)] for pattern in range(256)])
    joined = [bits[:, p] & bits[:, p + 1] & bits[:, (p + 2) % 8] for p in (0, 2, 4, 6)]
    return np.where(bits.all(1), 1, bits[:, ::2].sum(1) - sum(joined)).astype(np.int64)


@compiled
def may_open(drive, cell, stride):
    """Whether a closed cell touches the driving area."""
    return drive[cell + 1] + drive[cell - 1] + drive[cell + stride] + drive[cell - stride] > 0


@compiled
def may_close(drive, mark, queue, sides, walk, parts, cell):
    """Whether the driving area stays in one piece without this cell of it."""
    pattern = 0
    for place in range(8):
        pattern |= drive[cell + walk[place]] << place
    pieces = parts[pattern]
    return pieces == 1 or (pieces > 1 and _meet(drive, mark, queue, sides, walk, cell, pattern))


@compiled
def _cut_off(sides):
    """Whether a group of sides has nowhere left to search."""
    heads, tails, group = sides[0], sides[1], sides[2]
    for side in range(4):
        waiting = 0
        for other in range(4):
            if group[other] == group[side]:
                waiting += tails[other] - heads[other]
        if tails[side] > 0 and waiting == 0:
            return True
    return False


@compiled
def _meet(drive, mark, queue, sides, walk, cell, pattern):
    """Search from all open neighbours in lockstep until they meet or one is cut off.

    Lockstep makes the cost that of the smallest piece, or of the way round the obstacle.
    `mark` (int64 [N + 1]) holds stamps, its last entry is the clock; `queue` is int64 [4, N],
    `sides` int64 [3, 4] the queues' heads, tails and groups.
    """
    clock = mark[-1] + 4
    mark[-1] = clock
    heads, tails, group = sides[0], sides[1], sides[2]
    groups, visited = 0, 0
    for side in range(4):
        heads[side], tails[side], group[side] = 0, 0, side
        if pattern >> 2 * side & 1:
            queue[side, 0] = cell + walk[2 * side]
            mark[cell + walk[2 * side]] = clock + side
            tails[side] = 1
            groups += 1
    while visited < SEARCH:
        for side in range(4):
            if heads[side] == tails[side]:
                continue
            here = queue[side, heads[side]]
            heads[side] += 1
            visited += 1
            for place in (0, 2, 4, 6):
                there = here + walk[place]
                if drive[there] == 0 or there == cell:
                    continue
                if mark[there] < clock:
                    mark[there] = clock + side
                    queue[side, tails[side]] = there
                    tails[side] += 1
                elif group[mark[there] - clock] != group[side]:
                    lost = group[mark[there] - clock]
                    for other in range(4):
                        if group[other] == lost:
                            group[other] = group[side]
                    groups -= 1
        if groups == 1:
            return True
        if _cut_off(sides):
            return False
    return False


@compiled
def join(tile, drives, open_tile, root, stride):
    """Open the cheapest paths that join every driving cell to `root`, in place.

    A 0-1 search whose front restarts from each part it reaches. `drives` (int64 [K + 1]) marks
    the driving tiles, `open_tile` (int64 [N]) is what to put on an opened cell, -1 where it must
    stay closed. Returns the cells of the joined area (bool [N]).
    """
    size = tile.size
    far = np.full(size, 1 << 30)
    came = np.full(size, -1)
    deque = np.empty(8 * size + 8, np.int64)
    head = tail = 4 * size
    joined = np.zeros(size, np.bool_)
    if drives[tile[root]] == 0:
        tile[root] = open_tile[root]
    far[root], deque[tail], joined[root] = 0, root, True
    tail += 1
    while head < tail:
        here = deque[head]
        head += 1
        if far[here] > 0 and drives[tile[here]] and not joined[here]:
            back = here
            while back >= 0 and not joined[back]:
                joined[back], far[back] = True, 0
                if drives[tile[back]] == 0:
                    tile[back] = open_tile[back]
                if head > 0:
                    head -= 1
                    deque[head] = back
                back = came[back]
            continue
        for step in (1, -1, stride, -stride):
            there = here + step
            closed = drives[tile[there]] == 0
            if closed and open_tile[there] < 0:
                continue
            price = far[here] + closed
            if price < far[there]:
                far[there], came[there] = price, here
                if not closed and far[here] == 0:
                    joined[there] = True
                if closed and tail < deque.size:
                    deque[tail] = there
                    tail += 1
                elif not closed and head > 0:
                    head -= 1
                    deque[head] = there
    return joined
