"""What the annealer's kernels read and write: records of arrays; random numbers.

Cells live on a grid padded by one ring of walls, so that no neighbour test needs a border case:
N = (H + 2) (W + 2) cells in rows of `stride` = W + 2. Tiles are the K of the alphabet and the wall,
which is tile K. The eight neighbours of a cell are its places 0 to 7, clockwise from the top; the
even ones are its 4-neighbours. Arrays are as narrow as their numbers: those of a layout of the
paper's size stay in the fastest cache. Numbers that kernels change are arrays of shape [].
"""

from enum import IntEnum
from typing import NamedTuple

import numpy as np

from qdenv.native import Scalar, formula

MAX_KINDS = 20  # kinds of tile, more than any domain has: a set of them is a mask of bits
MAX_NEEDS = 7  # different needs: four bits each in one 32-bit tally of neighbours
MOST = 62  # cells that one move may change: a bit each in a mask of 64
NO_TILE = -1  # where a table or a draw has no tile to give
DRAWS = 64  # tiles in a row of `Board.choices`: six random bits draw one
SIDES = 0b01010101  # the 4-neighbours among the places of a ring
# (row, column) steps to the eight places
PLACES = np.array([(-1, 0), (-1, 1), (0, 1), (1, 1), (1, 0), (1, -1), (0, -1), (-1, -1)])

WORDS = 8  # random words that one move may use
LEVELS = 1024  # probabilities are multiples of 1 / LEVELS: ten random bits decide
# How far a rise in energy may go at temperature 1, for equally likely draws of exp(-rise): a table
# spares each move an exponential.
RISE_LIMITS = -np.log((np.arange(LEVELS) + 0.5) / LEVELS)
_GOLDEN = np.uint64(0x9E3779B97F4A7C15)
_MIX = (np.uint64(0xBF58476D1CE4E5B9), np.uint64(0x94D049BB133111EB))
_U27, _U30, _U31 = (np.uint64(bits) for bits in (27, 30, 31))


class Trait(IntEnum):
    """Columns of `Board.traits`."""

    DRIVES = 0  # 1 for a driving tile
    UNIT = 1  # what one such neighbour adds to a tally: 1 in the four bits of each need it meets
    NEEDS = 2  # the lowest bit of each need this tile has
    ROLE = 3  # index of its role, -1 for the wall
    BOUNDS = 4  # bit q: the tile counts in bound q


class TileGroup(IntEnum):
    """Which tiles a draw may give: the second axis of `Board.choices` and of `Board.fits`."""

    OBSTACLE = 0  # off the driving area
    DRIVING = 1  # on it
    ANY = 2


class Board(NamedTuple):
    """The rules and the input of one repair; nothing here changes."""

    layout: np.ndarray  # int8 [N], the input layout
    change_cost: np.ndarray  # float32 [N], the cost of a cell that differs from the input
    free: np.ndarray  # int32 [F], the cells that may change
    free_ring: np.ndarray  # uint8 [N], bit p: the neighbour at place p may change
    # int8 [N], the default open tile: the driving tile with the fewest adjacency demands that may
    # stand here, or `NO_TILE`
    open_tile: np.ndarray
    tile_set: np.ndarray  # int16 [N], which of the S sets of tiles a cell allows
    # int8 [S, 3, K + 1, DRAWS], tiles to draw from, of a `TileGroup` and other than the one that
    # stands here; roles as `_tabulate_choices` shares them
    choices: np.ndarray
    fits: np.ndarray  # int8 [S, 3, K + 1], 1 for tiles that are allowed and of the `TileGroup`
    traits: np.ndarray  # int32 [K + 1, 5], facts about tiles; `Trait` names them
    # int64 [Q, 2], lowest and highest number of tiles that count in bound q
    count_bounds: np.ndarray
    steps: np.ndarray  # int64 [8], from a cell to its places
    # how many missing tiles weigh as much as a tile without a neighbour it needs
    demand_weight: int
    connected: bool  # whether the driving area must be one piece
    # of four partners in a move that would leave their input tile, how many may
    leave_quarters: int


class AnnealState(NamedTuple):
    """One layout being annealed, with everything its energy needs."""

    candidate: np.ndarray  # int8 [N], the layout
    ring: np.ndarray  # uint8 [N], bit p: the neighbour at place p drives
    # int32 [N], how many of the four neighbours meet each need, four bits per need
    tally: np.ndarray
    counts: np.ndarray  # int64 [Q], how many cells count in each bound
    cost: Scalar  # float64 [], summed costs of the changed cells
    violations: Scalar  # int64 [], broken demands: of neighbours, counts and covers
    changed: np.ndarray  # int32 [N], first the cells that differ from the input
    num_changed: Scalar  # int64 [], how many these are
    place: np.ndarray  # int32 [N], 1 + where in `changed` a cell stands, 0 for nowhere
    best: np.ndarray  # int8 [N], the cheapest layout so far that broke no rule
    best_cost: Scalar  # float64 [], its cost
    since: np.ndarray  # int32 [N + 1], first the cells of all changes since `best`
    num_since: Scalar  # int64 [], how many these are; N + 1 stands for all cells
    feasible_period: Scalar  # int64 [], the last period with a layout that broke no rule
    boost: Scalar  # float64 [], how far the penalty is raised beyond its schedule
    walkers: np.ndarray  # int64 [3, 4], buffer of the connectivity test: cells, headings, ends


class Covers(NamedTuple):
    """The Q rules on whole rectangles, of Z shapes in all, and how the candidate stands to them."""

    belongs: np.ndarray  # int8 [Q, K + 1], 1 for the tiles that a rule covers, 2 for those at ends
    weights: np.ndarray  # int8 [Q, N], demands that a member without any breaks, 0 if it needs none
    shapes: np.ndarray  # int64 [Z, 3], of each shape the rule, rows and columns
    offsets: np.ndarray  # int64 [Z, area], from its first corner to its cells; 0 beyond the last
    needed: np.ndarray  # int8 [Z, area], what `belongs` says of the tiles that must be there
    member: np.ndarray  # int8 [Q, N], what it says of the candidate's tile
    lacking: np.ndarray  # int32 [Z, N], other cells in the rectangle whose first corner is here
    whole: np.ndarray  # int32 [Q, N], rectangles over the cell that lack none
    broken: Scalar  # int64 [], summed weights of members without any


class Move(NamedTuple):
    """Up to `MOST` cells that change together."""

    cells: np.ndarray  # int64 [MOST], the cells
    new: np.ndarray  # int64 [MOST], the tiles they get
    old: np.ndarray  # int64 [MOST], the tiles they had


class Schedule(NamedTuple):
    """How a run cools down and grows strict."""

    temperatures: tuple[float, float]  # the first and the last
    penalty_weights: tuple[float, float]  # the first and the last cost of a broken demand
    moves: int = 0  # proposed moves
    period: int = 1  # moves between two steps of the schedule
    periods: int = 1  # how many of them there are
    enough: float = -np.inf  # a cost that no layout undercuts: the run ends where one reaches it


@formula
def random_u64(seed: np.uint64, number: int) -> np.uint64:
    """Draw 64 random bits: a hash of the seed and a number.

    SplitMix64 (Steele, Lea and Flood 2014, https://doi.org/10.1145/2660193.2660195): no draw waits
    for the one before it, and a run cut into pieces draws what it would have drawn in one.
    """
    x = np.uint64(seed) + np.uint64(number) * _GOLDEN
    x = (x ^ (x >> _U30)) * _MIX[0]
    x = (x ^ (x >> _U27)) * _MIX[1]
    return x ^ (x >> _U31)


@formula
def uniform_bits(source: np.uint64, bits: tuple[int, int]) -> int:
    """Take some of 64 random bits as a number: (the first of them, how many)."""
    first, count = bits
    return int(np.int64(source >> np.uint64(first)) & ((1 << count) - 1))


@formula
def uniform_below(source: np.uint64, bits: tuple[int, int], bound: int) -> int:
    """Draw from 0 .. bound - 1 with some of 64 random bits, by their high end: no division."""
    return uniform_bits(source, bits) * bound >> bits[1]
