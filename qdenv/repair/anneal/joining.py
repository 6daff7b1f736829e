"""Making the driving area one piece, at the least number of opened cells. Compiled by numba."""

from typing import NamedTuple

import numpy as np

from qdenv.native import compiled
from qdenv.repair.anneal.kernel import kernel
from qdenv.repair.anneal.state import NO_TILE

FAR = 1 << 30


class Front(NamedTuple):
    """Memory of the 0-1 search of `join_pieces` over N cells.

    Attributes:
        distance: int64 [N], closed cells between the joined area and the cell.
        came_from: int64 [N], the cell before on a cheapest path, -1 for none.
        joined: bool [N], the joined area.
        deque: int64 [8 N + 8], cells that wait, the nearer first.
        ends: int64 [2], where in `deque` its first cell stands, and where its next last one goes.
    """

    distance: np.ndarray
    came_from: np.ndarray
    joined: np.ndarray
    deque: np.ndarray
    ends: np.ndarray


@kernel
def _wait_first(front: Front, cell: int) -> None:
    """Queue a cell before all others."""
    if front.ends[0] > 0:
        front.ends[0] -= 1
        front.deque[front.ends[0]] = cell


@kernel
def _wait_last(front: Front, cell: int) -> None:
    """Queue a cell behind all others."""
    if front.ends[1] < front.deque.size:
        front.deque[front.ends[1]] = cell
        front.ends[1] += 1


@kernel
def _open_path(
    front: Front, candidate: np.ndarray, drives: np.ndarray, opened: np.ndarray, cell: int
) -> None:
    """Open the cheapest path from a piece's `cell` to the joined area, which then restarts here."""
    while cell >= 0 and not front.joined[cell]:
        front.joined[cell], front.distance[cell] = True, 0
        if drives[candidate[cell]] == 0:
            candidate[cell] = opened[cell]
        _wait_first(front, cell)
        cell = front.came_from[cell]


@kernel
def _spread(
    front: Front,
    candidate: np.ndarray,
    drives: np.ndarray,
    opened: np.ndarray,
    cell: int,
    stride: int,
) -> None:
    """Reach the neighbours of a cell: for nothing where they drive, else for one opened cell."""
    for step in (1, -1, stride, -stride):
        there = cell + step
        closed = drives[candidate[there]] == 0
        if closed and opened[there] == NO_TILE:
            continue
        distance = front.distance[cell] + closed
        if distance < front.distance[there]:
            front.distance[there], front.came_from[there] = distance, cell
            if closed:
                _wait_last(front, there)
                continue
            if front.distance[cell] == 0:
                front.joined[there] = True
            _wait_first(front, there)


@compiled
def join_pieces(
    candidate: np.ndarray, drives: np.ndarray, opened: np.ndarray, root: int, stride: int
) -> np.ndarray:
    """Open the cheapest paths that join every driving cell to `root`, in place.

    A 0-1 search whose front restarts from each piece it reaches: the shortest-path heuristic for
    Steiner trees (Takahashi and Matsuyama 1980).

    Args:
        candidate: int8 [N], changed in place.
        drives: int64 [K + 1], 1 for driving tiles.
        opened: int8 [N], what to put on an opened cell, `NO_TILE` where it must stay closed.
        root: the cell to start from.
        stride: from a cell to the one below it.

    Returns:
        The cells of the joined area (bool [N]).
    """
    size = candidate.size
    front = Front(
        np.full(size, FAR),
        np.full(size, -1),
        np.zeros(size, np.bool_),
        np.empty(8 * size + 8, np.int64),
        np.array([4 * size, 4 * size]),
    )
    if drives[candidate[root]] == 0:
        candidate[root] = opened[root]
    front.distance[root], front.joined[root] = 0, True
    _wait_last(front, root)
    while front.ends[0] < front.ends[1]:
        here = front.deque[front.ends[0]]
        front.ends[0] += 1
        if front.distance[here] > 0 and drives[candidate[here]] and not front.joined[here]:
            _open_path(front, candidate, drives, opened, here)
        else:
            _spread(front, candidate, drives, opened, here, stride)
    return front.joined
