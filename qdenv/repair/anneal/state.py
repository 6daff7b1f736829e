"""What the annealer's kernels read and write: records of arrays, explained here and nowhere else.

Cells live on a grid padded by one ring of walls, so that no neighbour test needs a border case:
N = (H + 2) (W + 2) cells in rows of `stride` = W + 2. Tiles are the K of the alphabet and the wall,
which is tile K. The eight neighbours of a cell are numbered clockwise from the top; the even ones
are its 4-neighbours.
"""

from enum import IntEnum
from typing import NamedTuple

import numpy as np

MAX_KINDS = 20  # kinds of tile: three bits each in one 64-bit tally of neighbours
ALWAYS = 1 << 62  # a bit of every tally, so that a tile without needs has them met
NO_TILE = -1  # where a table or a draw has no tile to give


class Column(IntEnum):
    """Columns of `Board.tile_table`."""

    DRIVES = 0  # 1 for a driving tile
    UNIT = 1  # what one such neighbour adds to a tally: 1 in the three bits of this tile
    ROLE = 2  # index of its role, -1 for the wall
    BOUNDS = 3  # bit q: the tile counts in bound q
    NEEDS = 4  # from here on: tallies of which one bit must be set around the tile


class Board(NamedTuple):
    """The rules and the input of one repair; nothing here changes.

    Attributes:
        layout: int8 [N], the input layout.
        change_cost: float64 [N], the cost of a cell that differs from the input.
        allowed: int64 [N], bit k: tile k may stand here.
        free: int64 [F], the cells that may change.
        open_tile: int8 [N], the default open tile: the driving tile with the fewest adjacency
            demands that may stand here, or `NO_TILE`.
        tile_table: int64 [K + 1, ...], facts about tiles; `Column` names them.
        role_members: int64 [roles, 1 + K], how many tiles a role has, then these tiles.
        count_bounds: int64 [Q, 2], lowest and highest number of tiles that count in bound q.
        offsets: int64 [8], steps to the eight neighbours.
        ring_pieces: int64 [256], the simple-point table of `tabulate_ring_pieces`.
        stride: int, from a cell to the one below it.
        connected: bool, whether the driving area must be one piece.
        aisle: int, side of the squares that must cover the driving area.
    """

    layout: np.ndarray
    change_cost: np.ndarray
    allowed: np.ndarray
    free: np.ndarray
    open_tile: np.ndarray
    tile_table: np.ndarray
    role_members: np.ndarray
    count_bounds: np.ndarray
    offsets: np.ndarray
    ring_pieces: np.ndarray
    stride: int
    connected: bool
    aisle: int


class Search(NamedTuple):
    """Memory of one connectivity search: four queues, one for each 4-neighbour of a cell.

    Attributes:
        stamps: int64 [N], `clock` + queue of the search that saw a cell last.
        clock: int64 [1], larger than any stamp of an earlier search, so that none is erased.
        queues: int64 [4, N], cells in the order they were seen.
        heads: int64 [4], the first cell of each queue that still waits.
        tails: int64 [4], the end of each queue; 0 where none was started.
        groups: int64 [4], queues that have met share a number.
    """

    stamps: np.ndarray
    clock: np.ndarray
    queues: np.ndarray
    heads: np.ndarray
    tails: np.ndarray
    groups: np.ndarray


class State(NamedTuple):
    """One layout under way, with everything its energy needs.

    Attributes:
        candidate: int8 [N], the layout under way.
        driving: int8 [N], the driving mask: 1 where `candidate` holds a driving tile.
        tally: int64 [N], how many of the four neighbours hold each tile, three bits per tile.
        counts: int64 [Q], how many cells count in each bound.
        closed: int64 [N], closed cells in the aisle square whose top left corner is here.
        cover: int64 [N], open aisle squares over the cell.
        changed: int64 [1 + N], how many cells differ from the input, then these cells.
        place: int64 [N], where in `changed` a cell stands, 0 for nowhere.
        best: int8 [N], the cheapest layout so far that broke no rule.
        search: memory of the connectivity search.
        cost: float, summed costs of the changed cells, at the start.
        broken: int, broken demands (neighbours, counts, aisles), at the start.
    """

    candidate: np.ndarray
    driving: np.ndarray
    tally: np.ndarray
    counts: np.ndarray
    closed: np.ndarray
    cover: np.ndarray
    changed: np.ndarray
    place: np.ndarray
    best: np.ndarray
    search: Search
    cost: float
    broken: int


class Move(NamedTuple):
    """Up to five cells that change together.

    Attributes:
        cells: int64 [5], the cells.
        new: int64 [5], the tiles they get.
        old: int64 [5], the tiles they had.
    """

    cells: np.ndarray
    new: np.ndarray
    old: np.ndarray


def no_search(cells: int) -> Search:
    """Make the memory of searches on `cells` cells."""
    ends = np.zeros((3, 4), np.int64)
    clock, stamps = np.zeros(1, np.int64), np.zeros(cells, np.int64)
    return Search(stamps, clock, np.zeros((4, cells), np.int64), *ends)


def no_move() -> Move:
    """Make an empty move."""
    return Move(*np.zeros((3, 5), np.int64))
