"""Layouts people design by hand, at any size: the baselines of appendix D.2, as drawings.

Each function draws the area that a generator would draw; the domains add their frames.
"""

import numpy as np

from qdenv.types import InputError

_SHELVES = 10  # shelves of one block
_BAND = 4  # rows from one line of blocks to the next
_STATION_BLOCK = 6  # columns of a block of two stations and its share of the lanes
# Figure 11a: the kinds of the stations in each line.
_BY_LINE = (*("0" * 11, "1" * 10, "1" * 10, "111222221111"), *["2" * 12] * 3, "2" * 14)
_SIZE_S = (33, 36)
STATION_SHARE = 93 / (33 * 36)  # stations per cell there
_STAND_ALONE_FROM = 50  # rows and columns from which stations stand alone
_SPACING = (3, 2)  # rows and columns from one stand-alone station to the next


def shelf_blocks(rows: int, cols: int) -> list[str]:
    """Draw blocks of 1 x 10 shelves with endpoints above and below (Figures 10a, 14a).

    Lanes of one cell run between the blocks; the last block of a line is cut where the columns
    end, rows that hold no full line stay empty. Returns `rows` strings of `cols` symbols out of
    ``.@e``, or raises InputError if no line of blocks fits.
    """
    lines = (rows - 1) // _BAND
    if lines < 1 or cols < 1:
        raise InputError(f"no block of shelves fits into {rows} x {cols}: give 5 rows or more")
    picture = np.full((rows, cols), ".")
    blocks = np.arange(cols) % (_SHELVES + 1) < _SHELVES
    for top in range(1, _BAND * lines, _BAND):
        picture[top : top + 3, blocks] = [["e"], ["@"], ["e"]]
    return ["".join(row) for row in picture]


def stations(rows: int, cols: int, ratio: tuple[int, ...]) -> list[str]:
    """Draw a hand-made factory: blocks of stations where it is small, single ones where large.

    The kinds of station, drawn as ``0``, ``1``, ..., follow one another in row-major order, in
    numbers as near to the proportions of `ratio` (a 0 counts as 1) as whole stations allow
    (appendix D.2); at 33 x 36 two groups of a line are exchanged as in Figure 11a. Returns `rows`
    strings of `cols` symbols: digits, ``e`` and ``.``; raises InputError if a kind gets no station.
    """
    if min(rows, cols) < _STAND_ALONE_FROM:
        picture = station_blocks(rows, cols)
    else:
        # Single stations with lanes, and endpoints above and below if rows are left (Figure 14b).
        picture = np.full((rows, cols), ".")
        for row, symbol in enumerate("ese"):
            picture[row :: _SPACING[0], 1 : cols - 1 : _SPACING[1]] = symbol
        if rows % _SPACING[0] == 1:
            picture[-1] = "."  # endpoints whose station would lie outside
    places = picture == "s"
    numbers = apportion(int(places.sum()), tuple(max(1, one) for one in ratio))
    if 0 in numbers:
        few = f"{places.sum()} stations by hand, too few for every kind"
        raise InputError(f"a factory of {rows} x {cols} holds {few}: give a larger size")
    kinds = "".join(str(kind) * number for kind, number in enumerate(numbers))
    if (rows, cols) == _SIZE_S and sorted(kinds) == sorted("".join(_BY_LINE)):
        kinds = "".join(_BY_LINE)
    picture[places] = list(kinds)
    return ["".join(row) for row in picture]


def station_blocks(rows: int, cols: int) -> np.ndarray:
    """Draw pairs of stations ringed by endpoints, with a lane around each ring (Figure 11a).

    Symbols [rows, cols] out of ``.es``, where ``s`` is a station. Each line spreads its pairs
    evenly over the columns; at other sizes than the figure's the lines share the figure's number of
    stations per cell.
    """
    picture = np.full((rows, cols), ".")
    block = np.array([list("..ee.."), list(".esse."), list("..ee..")])
    tops = range(1, rows - 3, _BAND)
    fitting = 2 * len(tops) * (cols // _STATION_BLOCK)
    lines = apportion(min(round(rows * cols * STATION_SHARE), fitting), (1,) * len(tops))
    if (rows, cols) == _SIZE_S:
        lines = [len(line) for line in _BY_LINE]
    for top, stations in zip(tops, lines, strict=True):
        lefts = np.linspace(0, cols - _STATION_BLOCK, -(-stations // 2)).round().astype(int)
        for left in lefts:
            picture[top : top + 3, left : left + _STATION_BLOCK] = block
        if stations % 2:  # the last one stands alone
            picture[top : top + 3, left + 3 : left + 5] = [list(".."), list("e."), list("..")]
    return picture


def apportion(total: int, ratio: tuple[int, ...]) -> list[int]:
    """Split `total` in the proportions of `ratio`, the largest remainders rounded up."""
    exact = np.array(ratio) * total / sum(ratio)
    numbers = exact.astype(int)
    numbers[np.argsort(numbers - exact, kind="stable")[: total - numbers.sum()]] += 1
    return numbers.tolist()
