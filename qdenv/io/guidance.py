"""Costs of moves in files, as published beside the paper on guidance graphs.

Zhang et al. 2024 (https://arxiv.org/abs/2402.01446) write them in two ways. In JSON `weights` is a
flat list: the cost of waiting, one for all cells or one for each free cell, then of each free cell
the costs of its moves to other free cells in the order right, up, left, down; cells row by row. In
CSV each cell has a line, with `inf` where there is no move.
"""

import csv
import io
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from qdenv.grid import DOWN, LEFT, NUM_MOVES, RIGHT, UP, WAIT
from qdenv.guidance import existing_moves
from qdenv.io.files import damaged
from qdenv.types import InputError

_ORDER = [RIGHT, UP, LEFT, DOWN]
_NOT_ALLOWED = -1.0  # in JSON, which has no infinity: a move to a free cell that is not allowed
_NAMES = ("id", "type", "x", "y")  # x is the row, y the column
_MOVES = [f"weight_to_{name}" for name in ("RIGHT", "UP", "LEFT", "DOWN")] + ["weight_for_WAIT"]
TABLE_HEAD = ",".join((*_NAMES, *_MOVES))  # the first line of a CSV file


def costs_of(weights: Sequence[float], traversable: np.ndarray) -> np.ndarray:
    """Spread a list of weights over the moves of a floor (bool [H, W] -> float [5, H, W]).

    Raises InputError if they are not as many as the floor's moves, or no costs of them.
    """
    exists = np.moveaxis(existing_moves(traversable)[_ORDER], 0, -1)
    free, moves, values = int(traversable.sum()), int(exists.sum()), np.array(weights, float)
    if len(values) not in (1 + moves, free + moves):
        own = f"{free} free cells have {moves} moves, and 1 or {free} costs of waiting come first"
        raise InputError(f"{len(values)} weights are not those of this layout: its {own}")
    values[values == _NOT_ALLOWED] = np.inf
    if not (values > 0).all() or np.isinf(values[: len(values) - moves]).any():
        raise InputError("costs of moves must be above zero, and finite for waiting")
    ways = np.full(exists.shape, np.inf)
    ways[exists] = values[-moves or len(values) :]
    costs = np.full((NUM_MOVES, *traversable.shape), np.inf)
    costs[_ORDER] = np.moveaxis(ways, -1, 0)
    costs[WAIT, traversable] = values[: len(values) - moves]
    return costs


def weights_of(costs: np.ndarray) -> list[float]:
    """List the costs of a floor (float [5, H, W]), the inverse of `costs_of`.

    Cells where waiting costs infinity are obstacles.
    """
    free = np.isfinite(costs[WAIT])
    exists = np.moveaxis(existing_moves(free)[_ORDER], 0, -1)
    waits, ways = costs[WAIT, free], np.moveaxis(costs[_ORDER], 0, -1)[exists]
    if len(np.unique(waits)) == 1:
        waits = waits[:1]
    return [*waits.tolist(), *np.where(np.isinf(ways), _NOT_ALLOWED, ways).tolist()]


def read_table(path: Path, lines: Sequence[str], above: int) -> tuple[list[str], list[float]]:
    """Read the lines below the head of a CSV file (`TABLE_HEAD`): rows of symbols, and weights.

    Raises DamagedError, which names the file `path` and a line, with `above` lines before these, if
    they are not one line for each cell.
    """
    symbols, cells, values = [], [], []
    reader = csv.reader(lines, strict=True)
    try:
        for _, symbol, row, column, *prices in reader:
            symbols.append(symbol)
            cells.append((int(row), int(column)))
            values.append([float(price) for price in prices])
        # A line too short or too long leaves no array.
        table = np.array(values, float).reshape(len(cells), NUM_MOVES)
    except (ValueError, csv.Error) as error:
        line = f"line {above + reader.line_num} is not a cell with costs"
        raise damaged(path, f"{line}: fill the columns of the head") from error
    rows, cols = (1 + max(0, *axis) for axis in zip(*cells, strict=True)) if cells else (0, 0)
    complete = rows * cols == len(cells) and sorted(cells) == list(np.ndindex(rows, cols))
    if not complete or {*map(len, symbols)} != {1}:
        raise damaged(path, f"not one line, with one tile, for each cell of {rows} x {cols}")
    places = np.lexsort(np.transpose(cells)[::-1])
    drawn = "".join(symbols[place] for place in places)
    costs = np.full((NUM_MOVES, rows, cols), np.inf)
    costs[[*_ORDER, WAIT]] = table[places].T.reshape(NUM_MOVES, rows, cols)
    return [drawn[begin : begin + cols] for begin in range(0, len(drawn), cols)], weights_of(costs)


def write_table(rows: Sequence[str], costs: np.ndarray) -> str:
    """Write rows of symbols and their costs (float [5, H, W]) as `read_table` reads them."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow((*_NAMES, *_MOVES))
    for number, (row, column) in enumerate(np.ndindex(costs.shape[1:])):
        values = costs[[*_ORDER, WAIT], row, column].tolist()
        writer.writerow((number, rows[row][column], row, column, *values))
    return text.getvalue()
