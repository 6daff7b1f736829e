"""Keeping the driving area in one piece: the ring test and the walk along the walls.

Compiled by numba and free of the interpreter lock. A cell may close without a search where it is a
simple point of digital topology (Kong and Rosenfeld 1989,
https://doi.org/10.1016/0734-189X(89)90147-3), which its eight neighbours tell. Elsewhere walkers
leave it with their left hand on the wall. On a plane a walker that comes back from where it left
has gone round a part that nothing else joins to the rest.
"""

from typing import NamedTuple

import numpy as np
from scipy import ndimage, sparse
from scipy.sparse.csgraph import connected_components, minimum_spanning_tree

from qdenv.native import formula, kernel
from qdenv.repair.anneal.state import Board, State

_MAX_STEPS = 200  # of one walker, before the move is refused
_STRIDE = 8  # steps a walker makes in one go


def _ring_bits() -> np.ndarray:
    """List the bits of all 3x3 ring patterns (int64 [256, 8])."""
    return np.arange(256)[:, None] >> np.arange(8) & 1


def tabulate_ring_pieces() -> np.ndarray:
    """Count, for each 3x3 ring pattern, the pieces its open 4-neighbours form (int8 [256]).

    Two neighbouring 4-neighbours hang together when the corner between them is open. One piece: a
    simple point.
    """
    bits = _ring_bits()
    linked = [bits[:, p] & bits[:, p + 1] & bits[:, (p + 2) % 8] for p in (0, 2, 4, 6)]
    return np.where(bits.all(1), 1, bits[:, ::2].sum(1) - sum(linked)).astype(np.int8)


def _tabulate_set_bits() -> np.ndarray:
    """List, for each pattern, how many bits are set, then which (int8 [256, 9])."""
    table = np.zeros((256, 9), np.int8)
    for pattern, bits in enumerate(_ring_bits()):
        places = np.flatnonzero(bits)
        table[pattern, : 1 + places.size] = [places.size, *places]
    return table


def _tabulate_turns() -> np.ndarray:
    """Tell a walker with its left hand on the wall where to go next (int8 [4, 256]).

    Headings are clockwise from the top; from one and the pattern of the cell comes the next: left
    if that is open, else straight on, else right, else back.
    """
    table = np.zeros((4, 256), np.int8)
    for heading in range(4):
        for turn in (2, 1, 0, 3):
            towards = (heading + turn) % 4
            table[heading, _ring_bits()[:, 2 * towards] == 1] = towards
    return table


RING_PIECES = tabulate_ring_pieces()
SET_BITS = _tabulate_set_bits()
TURNS = _tabulate_turns()


@formula
def flip_driving(board: Board, ring: np.ndarray, cell: int) -> None:
    """Tell the eight neighbours of a cell that it has opened or closed."""
    for place in range(8):
        ring[cell + board.steps[place]] ^= 1 << (place + 4 & 7)


@formula
def may_close(board: Board, state: State, cell: int) -> bool:
    """Whether the driving area stays in one piece without this cell of it."""
    pieces = RING_PIECES[state.ring[cell]]
    # Most cells are simple points: only pieces that the ring leaves apart need walkers.
    return pieces == 1 or (pieces > 1 and _pieces_meet(board, state, cell, pieces))


@formula
def _is_left_end(pattern: int, side: int) -> bool:
    """Whether an open side of a ring hangs together with none to its left."""
    left = pattern >> (2 * side + 6 & 7) & pattern >> (2 * side + 7 & 7) & 1
    return pattern >> 2 * side & 1 == 1 and left == 0


@formula
def _send_walkers(
    cells: np.ndarray, headings: np.ndarray, ends: np.ndarray, cell: int, pattern: int
) -> None:
    """Send a walker into each piece of a ring, along its left end."""
    sent = 0
    for side in range(4):
        if _is_left_end(pattern, side):
            cells[sent], headings[sent], ends[sent] = cell, side, -1
            sent += 1


@formula
def _piece_of(pattern: int, heading: int, pieces: int) -> int:
    """Number the piece of a ring from which a walker arrives that heads for the middle."""
    piece = -1
    for side in range((heading + 2 & 3) + 1):
        piece += _is_left_end(pattern, side)
    # The sides before the first left end belong to the last piece.
    return piece if piece >= 0 else pieces - 1


@formula
def _is_single_ring(ends: np.ndarray, pieces: int) -> bool:
    """Whether the walks, of which one has not ended, lead through all pieces."""
    missing = pieces * (pieces - 1) // 2
    for piece in range(pieces):
        missing -= max(ends[piece], 0)
    piece = 0
    for length in range(1, pieces + 1):
        # The last walk can only end where no other did.
        piece = ends[piece] if ends[piece] >= 0 else missing
        if piece == 0:
            return length == pieces
    return False


@kernel
def _pieces_meet(board: Board, state: State, cell: int, pieces: int) -> bool:
    """Walk from all pieces in lockstep until it is known how the walls lead from one to another.

    The walk from each piece ends at one of them, and all walks together form rings; the pieces meet
    if that is a single ring. Lockstep makes the cost that of the smallest part, or of the way round
    the nearest obstacle.
    """
    ring, steps, pattern = state.ring, board.steps, state.ring[cell]
    cells, headings, ends = state.walkers[0], state.walkers[1], state.walkers[2]
    _send_walkers(cells, headings, ends, cell, pattern)
    walking = pieces
    for _ in range(_MAX_STEPS // _STRIDE):
        for piece in range(pieces):
            if ends[piece] >= 0:
                continue
            here, heading = cells[piece], headings[piece]
            for _ in range(_STRIDE):
                here += steps[2 * heading]
                if here == cell:
                    break
                heading = TURNS[heading, ring[here]]
            cells[piece], headings[piece] = here, heading
            if here != cell:
                continue
            ends[piece] = _piece_of(pattern, heading, pieces)
            walking -= 1
            if ends[piece] == piece:
                return False
            if walking == 1:
                return _is_single_ring(ends, pieces)
    return False


class _Reach(NamedTuple):
    """Which piece of the driving area is nearest to each of N cells."""

    owner: np.ndarray  # int32 [N], the piece, from 1 on; 0 for cells that none can reach
    distance: np.ndarray  # int32 [N], closed cells from there to the cell, itself included
    came_from: np.ndarray  # int64 [N], the cell before on the way, -1 in the pieces themselves


def join_pieces(
    driving: np.ndarray, may_open: np.ndarray, root: int, stride: int
) -> tuple[np.ndarray, np.ndarray]:
    """Choose cells to open that join every driving cell to `root`, as far as cells may open.

    A minimum spanning tree over the ways between neighbouring pieces, which is at most twice as
    long as a shortest Steiner tree (Mehlhorn 1988, https://doi.org/10.1016/0020-0190(88)90066-X).
    The time grows with the cells.

    Args:
        driving: bool [N], cells of a padded grid.
        may_open: bool [N], cells that may open, or are open.
        root: the cell to join the others to.
        stride: from a cell to the one below it.

    Returns:
        The cells that drive now (bool [N]), and those that hang together with the root (bool [N]).
    """
    driving = driving.copy()
    driving[root] = True
    reach = _reach(driving, may_open, stride)
    ends, tree = _choose_ways(reach, stride)
    while ends.size:
        driving[ends] = True
        ends = reach.came_from[ends]
        ends = ends[ends >= 0]
    _, groups = connected_components(tree, directed=False)
    return driving, driving & (groups[reach.owner] == groups[reach.owner[root]])


def _reach(driving: np.ndarray, may_open: np.ndarray, stride: int) -> _Reach:
    """Reach out from all pieces at once, a cell at a time."""
    owner, _ = ndimage.label(driving.reshape(-1, stride))
    owner = owner.ravel()
    distance, came_from = np.zeros(owner.size, np.int32), np.full(owner.size, -1)
    front, level = np.flatnonzero(driving), 0
    while front.size:
        level += 1
        reached = []
        for step in (1, -1, stride, -stride):
            new = may_open[front + step] & (owner[front + step] == 0)
            there = front[new] + step
            owner[there], came_from[there], distance[there] = owner[front[new]], front[new], level
            reached.append(there)
        front = np.concatenate(reached)
    return _Reach(owner, distance, came_from)


def _choose_ways(reach: _Reach, stride: int) -> tuple[np.ndarray, sparse.csr_array]:
    """Choose where pieces meet: the shortest ways that join them all."""
    pieces = int(reach.owner.max()) + 1
    inside = np.flatnonzero(reach.owner > 0)
    pairs = []
    for step in (1, stride):
        far = inside + step
        meets = (reach.owner[far] > 0) & (reach.owner[far] != reach.owner[inside])
        pairs.append(np.stack([inside[meets], far[meets]]))
    cells = np.concatenate(pairs, axis=1)
    # Of several ways between two pieces the shortest: sparse arrays would add them up.
    low, high = np.sort(reach.owner[cells].astype(np.int64), axis=0)
    length = reach.distance[cells].sum(0)
    order = np.lexsort((length, high, low))
    _, first = np.unique((low * pieces + high)[order], return_index=True)
    best = order[first]
    ways = sparse.csr_array((length[best], (low[best], high[best])), shape=(pieces, pieces))
    tree = sparse.coo_array(minimum_spanning_tree(ways))
    chosen = np.isin(low[best] * pieces + high[best], tree.row * np.int64(pieces) + tree.col)
    return cells[:, best[chosen]].ravel(), sparse.csr_array(tree)
