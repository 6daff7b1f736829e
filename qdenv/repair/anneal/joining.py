"""Making the driving area one piece, at few opened cells."""

from typing import NamedTuple

import numpy as np
from scipy import ndimage, sparse
from scipy.sparse.csgraph import connected_components, minimum_spanning_tree

CROSS = ndimage.generate_binary_structure(2, 1)


class Reach(NamedTuple):
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


def _reach(driving: np.ndarray, may_open: np.ndarray, stride: int) -> Reach:
    """Reach out from all pieces at once, a cell at a time."""
    owner, _ = ndimage.label(driving.reshape(-1, stride), CROSS)
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
    return Reach(owner, distance, came_from)


def _choose_ways(reach: Reach, stride: int) -> tuple[np.ndarray, sparse.csr_array]:
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
