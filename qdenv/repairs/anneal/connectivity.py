"""Keeping the driving area in one piece: the ring test and the walk along the walls.

Compiled by numba and free of the interpreter lock. A cell may close without a search where it is a
simple point of digital topology (Kong and Rosenfeld 1989,
https://doi.org/10.1016/0734-189X(89)90147-3), which its eight neighbours tell. Elsewhere walkers
leave it with their left hand on the wall. On a plane a walker that comes back from where it left
has gone round a part that nothing else joins to the rest.
"""

import numpy as np
from scipy import ndimage, sparse
from scipy.sparse.csgraph import connected_components, minimum_spanning_tree

from qdenv.native import formula, kernel
from qdenv.repairs.anneal.state import AnnealState, Board

_MAX_STEPS = 200  # of one walker, before the move is refused
_STRIDE = 8  # steps a walker makes in one go

# All 3x3 patterns by number: which of the eight neighbours are open, in clockwise order from the
# top. The sides are the 4-neighbours; two of them hang together when the corner between them is
# open, too, and so form a piece.
_OPEN = np.arange(256)[:, None] >> np.arange(8) & 1 == 1  # bool [256, 8]
_SIDES, _CORNERS = _OPEN[:, ::2], _OPEN[:, 1::2]  # the corner behind each side
# The first side of a piece from the left: an open one that hangs together with none to its left.
_LEFT_ENDS = _SIDES & ~np.roll(_SIDES & _CORNERS, 1, 1)
# int8 [256], the number of pieces; where it is 1, the cell in the middle may be closed
RING_PIECES = np.where(_OPEN.all(1), 1, _LEFT_ENDS.sum(1)).astype(np.int8)
# int8 [256, 4], the left ends of the pieces, in their order
_STARTS = np.argsort(~_LEFT_ENDS, 1, kind="stable").astype(np.int8)
# int8 [256, 4], the piece of each open side; those before the first left end belong to the last
_PIECE_OF = ((_LEFT_ENDS.cumsum(1) - 1) % np.maximum(RING_PIECES, 1)[:, None]).astype(np.int8)
# int8 [256, 9], how many neighbours are open, then which
SET_BITS = np.column_stack([_OPEN.sum(1), np.argsort(~_OPEN, 1, kind="stable")]).astype(np.int8)
# int8 [4, 256], the next heading of a walker with its left hand on the wall, from its heading
# (clockwise from the top) and the pattern around it: left if that is open, else straight on, else
# right, else back. The last of these turns that is written wins.
_TURNS = np.zeros((4, 256), np.int8)
for _heading in range(4):
    for _turn in (2, 1, 0, 3):
        _TURNS[_heading, _SIDES[:, (_heading + _turn) % 4]] = (_heading + _turn) % 4


@formula
def may_close(board: Board, state: AnnealState, cell: int) -> bool:
    """Return True if the driving area stays in one piece without this cell of it."""
    pieces = RING_PIECES[state.ring[cell]]
    # True of most cells: only pieces that the ring leaves apart need walkers.
    return pieces == 1 or (pieces > 1 and _pieces_meet(board, state, cell, pieces))


@kernel
def _pieces_meet(board: Board, state: AnnealState, cell: int, pieces: int) -> bool:
    """Walk from all pieces in lockstep until it is known how the walls lead from one to another.

    The walk from each piece ends at one of them, and all walks together form rings; the pieces meet
    if that is a single ring. Lockstep makes the cost that of the smallest part, or of the way round
    the nearest obstacle.
    """
    ring, steps, pattern = state.ring, board.steps, state.ring[cell]
    cells, headings, ends = state.walkers[0], state.walkers[1], state.walkers[2]
    for piece in range(pieces):
        cells[piece], headings[piece], ends[piece] = cell, _STARTS[pattern, piece], -1
    walking, missing = pieces, pieces * (pieces - 1) // 2
    for _ in range(_MAX_STEPS // _STRIDE):
        for piece in range(pieces):
            if ends[piece] >= 0:
                continue
            here, heading = cells[piece], headings[piece]
            for _ in range(_STRIDE):
                here += steps[2 * heading]
                if here == cell:
                    break
                heading = _TURNS[heading, ring[here]]
            cells[piece], headings[piece] = here, heading
            if here != cell:
                continue
            ends[piece] = _PIECE_OF[pattern, heading + 2 & 3]
            walking -= 1
            missing -= ends[piece]
            if ends[piece] == piece:
                return False
            if walking == 1:
                # The last walk can only end where no other did: in the piece that is missing in
                # the sum. Follow the walks from the first piece until they are back there.
                reached = 0
                for length in range(1, pieces + 1):
                    reached = ends[reached] if ends[reached] >= 0 else missing
                    if reached == 0:
                        return length == pieces
                return False
    return False


def join_pieces(
    driving: np.ndarray, may_open: np.ndarray, root: int, stride: int
) -> tuple[np.ndarray, np.ndarray]:
    """Choose cells to open that join every driving cell to `root`, as far as cells may open.

    A minimum spanning tree over the ways between neighbouring pieces, which is at most twice as
    long as a shortest Steiner tree (Mehlhorn 1988, https://doi.org/10.1016/0020-0190(88)90066-X).
    The time grows with the cells. `driving` and `may_open` (bool [N], the latter also where a cell
    is open) are those of a padded grid in which the next row is `stride` cells on. Returns the
    cells that drive now and those that hang together with the root (bool [N] each).
    """
    driving = driving.copy()
    driving[root] = True
    # Reach out from all pieces at once, a cell at a time: which piece (from 1 on; 0 for cells that
    # none can reach) is nearest to each cell, how many closed cells lie on the way there (the cell
    # included), and the cell before on it (-1 in the pieces themselves).
    owner = ndimage.label(driving.reshape(-1, stride))[0].ravel()
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
    # Where the reaches of two pieces touch, a way leads from one to the other.
    pieces = int(owner.max()) + 1
    inside = np.flatnonzero(owner > 0)
    pairs = []
    for step in (1, stride):
        far = inside + step
        meets = (owner[far] > 0) & (owner[far] != owner[inside])
        pairs.append(np.stack([inside[meets], far[meets]]))
    cells = np.concatenate(pairs, axis=1)
    # Of several ways between two pieces the shortest: sparse arrays would add them up.
    low, high = np.sort(owner[cells].astype(np.int64), axis=0)
    length = distance[cells].sum(0)
    order = np.lexsort((length, high, low))
    best = order[np.unique((low * pieces + high)[order], return_index=True)[1]]
    between = np.stack([low, high]).astype(np.int32)[:, best]  # older versions take no int64
    ways = sparse.csr_array((length[best], tuple(between)), shape=(pieces, pieces))
    tree = sparse.coo_array(minimum_spanning_tree(ways))
    chosen = np.isin(low[best] * pieces + high[best], tree.row.astype(np.int64) * pieces + tree.col)
    # Open the chosen ways, from where they meet back to the pieces.
    ends = cells[:, best[chosen]].ravel()
    while ends.size:
        driving[ends] = True
        ends = came_from[ends]
        ends = ends[ends >= 0]
    _, groups = connected_components(sparse.csr_array(tree), directed=False)
    return driving, driving & (groups[owner] == groups[owner[root]])
