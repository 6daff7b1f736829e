"""Keeping the driving area in one piece: the ring test and the lockstep search.

Compiled by numba and free of the interpreter lock. A cell may close without a search where it is a
simple point of digital topology (Kong and Rosenfeld 1989,
https://doi.org/10.1016/0734-189X(89)90147-3), which its eight neighbours tell.
"""

import numpy as np

from qdenv.repair.anneal.kernel import kernel
from qdenv.repair.anneal.state import Board, Search

SEARCH_LIMIT = 4000  # cells a connectivity search may visit before the move is refused


def tabulate_ring_pieces() -> np.ndarray:
    """Count, for each 3x3 ring pattern, the pieces its open 4-neighbours form (int64 [256]).

    Bit b of a pattern is neighbour b, clockwise from the top. Two neighbouring 4-neighbours hang
    together when the corner between them is open. One piece: a simple point.
    """
    bits = np.array([[pattern >> place & 1 for place in range(8)] for pattern in range(256)])
    linked = [bits[:, p] & bits[:, p + 1] & bits[:, (p + 2) % 8] for p in (0, 2, 4, 6)]
    return np.where(bits.all(1), 1, bits[:, ::2].sum(1) - sum(linked)).astype(np.int64)


@kernel
def may_open(driving: np.ndarray, cell: int, stride: int) -> bool:
    """Whether a closed cell touches the driving area."""
    across = driving[cell + 1] + driving[cell - 1]
    return across + driving[cell + stride] + driving[cell - stride] > 0


@kernel
def may_close(board: Board, driving: np.ndarray, search: Search, cell: int) -> bool:
    """Whether the driving area stays in one piece without this cell of it."""
    pattern = 0
    for place in range(8):
        pattern |= driving[cell + board.offsets[place]] << place
    pieces = board.ring_pieces[pattern]
    # Most cells are simple points: only pieces that the ring leaves apart need a search.
    return pieces == 1 or (pieces > 1 and _pieces_meet(board, driving, search, cell, pattern))


@kernel
def _start_queues(board: Board, search: Search, cell: int, pattern: int) -> int:
    """Start a queue at each open 4-neighbour of `cell`; returns how many."""
    # Four stamps a search, one for each queue; older stamps are smaller and mean "not seen".
    search.clock[0] += 4
    started = 0
    for side in range(4):
        search.heads[side], search.tails[side], search.groups[side] = 0, 0, side
        if pattern >> 2 * side & 1:
            neighbour = cell + board.offsets[2 * side]
            search.queues[side, 0] = neighbour
            search.stamps[neighbour] = search.clock[0] + side
            search.tails[side] = 1
            started += 1
    return started


@kernel
def _merge(groups: np.ndarray, side: int, lost: int) -> None:
    """Give the queues of group `lost` the group of queue `side`."""
    for other in range(4):
        if groups[other] == lost:
            groups[other] = groups[side]


@kernel
def _cut_off(search: Search) -> bool:
    """Whether a group of queues has nowhere left to search."""
    for side in range(4):
        waiting = 0
        for other in range(4):
            if search.groups[other] == search.groups[side]:
                waiting += search.tails[other] - search.heads[other]
        if search.tails[side] > 0 and waiting == 0:
            return True
    return False


@kernel
def _pieces_meet(
    board: Board, driving: np.ndarray, search: Search, cell: int, pattern: int
) -> bool:
    """Search from all open neighbours in lockstep until they meet or one is cut off.

    Lockstep makes the cost that of the smallest piece, or of the way round the obstacle (Even and
    Shiloach 1981, https://doi.org/10.1145/322234.322235).
    """
    groups, visited = _start_queues(board, search, cell, pattern), 0
    stamps, clock = search.stamps, search.clock[0]
    while visited < SEARCH_LIMIT:
        for side in range(4):
            if search.heads[side] == search.tails[side]:
                continue
            here = search.queues[side, search.heads[side]]
            search.heads[side] += 1
            visited += 1
            for place in (0, 2, 4, 6):
                there = here + board.offsets[place]
                if driving[there] == 0 or there == cell:
                    continue
                if stamps[there] < clock:
                    stamps[there] = clock + side
                    search.queues[side, search.tails[side]] = there
                    search.tails[side] += 1
                elif search.groups[stamps[there] - clock] != search.groups[side]:
                    _merge(search.groups, side, search.groups[stamps[there] - clock])
                    groups -= 1
        if groups == 1:
            return True
        if _cut_off(search):
            return False
    return False
