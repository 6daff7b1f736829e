"""Demand by place: how likely each cell is to be a robot's next goal, from files or zones.

The map belongs to places, not to goods: shelves may move, the odds of an endpoint are what the map
holds at its cell. It comes as

* a table (CSV) of the plan's shape with a number in each cell, 0 where it is empty;
* zones, rectangles of rows and columns with a weight: ``0:10,0:20=3 12:18,4:9=0.5``; other cells
  have the weight 1, where zones overlap the last one counts;
* order lines (CSV) with the columns ``row`` and ``column``, or ``place`` with a second file that
  says where each place is (``place,row,column``): ``orders.csv,places.csv``. A column ``count`` or
  ``quantity`` counts a line several times;
* a scenario of MovingAI (.scen) or a problem of the League of Robot Runners (.json): a cell is as
  likely as it is among their goals.
"""

import os.path
import re
from collections import defaultdict
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from qdenv.grid import MOVES, rectangle
from qdenv.io.files import damaged, read_text
from qdenv.io.layouts import read_drawing, split_cells
from qdenv.lazy import ndimage
from qdenv.types import InputError, about

_CELL = (("row",), ("column", "col"))  # names of columns that mean the same
_AMOUNT = ("count", "quantity")
_FORM = "write zones as ROWS,COLUMNS=WEIGHT, like 0:10,0:20=3, or name a CSV file"


def read_demand(source: str | Path, endpoints: np.ndarray) -> np.ndarray:
    """Read how likely each cell is to be a goal (float [H, W]) from a file, or zones.

    `endpoints` (bool [H, W]) are the cells of the plan that order lines may lead to; those of a
    shelf are divided among the endpoints beside it. Order lines say nothing of other cells, which
    get what the nearest endpoint has. Raises InputError if the source is none of these, or
    does not fit the plan.
    """
    text = str(source)
    if "=" in text and not os.path.isfile(text):  # `Path.is_file` raises for a long text
        odds = np.ones(endpoints.shape)
        for zone in re.split(r"[\s;]+", text.strip()):
            place, sign, weight = zone.partition("=")
            with about("zone"):
                found = rectangle(place, odds.shape)
            if not (found and sign):
                raise InputError(f"zone {zone!r}: {_FORM}")
            odds[found] = _number(weight, f"zone {zone!r}")
        return odds
    if text.lower().endswith((".scen", ".json")):
        return _goals(text, endpoints.shape)
    orders, _, places = (text, "", "") if os.path.isfile(text) else text.partition(",")
    if not orders.lower().endswith(".csv"):
        raise InputError(f"{text!r} is not a demand: {_FORM}")
    table = _cells(Path(orders))
    lines = [line for line in table if any(line[1])]
    with about(orders):
        if "row" in lines[0][1] or "place" in lines[0][1]:
            return _spread(_count(lines, places), endpoints)
        if places:
            raise InputError("no column place in its first line, which a file of places is for")
        rows = [
            [_number(cell or "0", f"line {line}, column {col}") for col, cell in enumerate(cells)]
            for line, cells in table
        ]
        widths, shape = {len(row) for row in rows}, endpoints.shape
        if (len(rows), *widths) != shape:
            cols = " or ".join(map(str, sorted(widths)))
            raise InputError(f"{len(rows)} x {cols} numbers, the plan has {shape[0]} x {shape[1]}")
        return np.array(rows)


def demand_in(folder: Path, fact: Any) -> str | tuple[str, ...]:
    """Return demand as a plan in `folder` states it: rows of numbers, zones, or files there."""
    if isinstance(fact, list):
        return tuple(map(str, fact))
    if os.path.isfile(folder / str(fact).partition(",")[0]):
        return ",".join(str(folder / file) for file in str(fact).split(","))
    return str(fact)


def _goals(path: str, shape: tuple[int, ...]) -> np.ndarray:
    """Count how often each cell is a goal of a benchmark's tasks."""
    drawing = read_drawing(path)
    goals = np.array([cell for task in drawing.tasks for cell in task], int)
    if not goals.size:
        raise InputError(f"{path}: the file holds no goals of robots")
    theirs = (len(drawing.rows), max(map(len, drawing.rows), default=0))
    if theirs != shape:
        sizes = "{} x {}, the plan has {} x {}".format(*theirs, *shape)
        raise InputError(f"{path}: goals on a map of {sizes}")
    if not 0 <= goals.min() <= goals.max() < shape[0] * shape[1]:
        raise damaged(path, f"a goal is not a cell of the map, 0 to {shape[0] * shape[1] - 1}")
    return np.bincount(goals, minlength=shape[0] * shape[1]).reshape(shape).astype(float)


def _cells(path: Path) -> list[tuple[int, list[str]]]:
    """List the lines of a spreadsheet that have cells: number, and cells in lower case."""
    table = split_cells(path, read_text(path, what="CSV").splitlines())
    lines = [
        (number, [cell.strip().lower() for cell in cells]) for number, cells in enumerate(table, 1)
    ]
    if not any(any(cells) for _, cells in lines):
        raise damaged(path, "the file is empty")
    return [line for line in lines if len(line[1]) > 1 or any(line[1])]


def _count(table: list[tuple[int, list[str]]], file: str) -> dict[tuple[int, int], float]:
    """Count the order lines of each cell (row, column); a `file` may say where places are."""
    places: dict[str, tuple[int, int]] = {}
    if file:
        (_, head), *lines = (line for line in _cells(Path(file)) if any(line[1]))
        with about(file):
            name, *where = (_find(head, *names) for names in (("place",), *_CELL))
            for line, cells in lines:
                place = "".join(cells[name:][:1])  # a line may end before the name
                cell = _cell(cells, where, line)
                if places.setdefault(place, cell) != cell and place:
                    raise InputError(f"line {line}: place {place!r} has another cell above")
    (_, head), *lines = table
    counts: dict[tuple[int, int], float] = defaultdict(float)
    amount = _find(head, *_AMOUNT) if {*_AMOUNT} & {*head} else None
    by_name = bool(places) or "row" not in head
    columns = [_find(head, *names) for names in ([("place",)] if by_name else _CELL)]
    for line, cells in lines:
        cells += [""] * (len(head) - len(cells))
        if by_name:
            place = cells[columns[0]]
            if place not in places:
                cure = "name a second file with place, row and column, as orders.csv,places.csv"
                raise InputError(f"line {line}: place {place!r} is unknown: {cure}")
            cell = places[place]
        else:
            cell = _cell(cells, columns, line)
        counts[cell] += 1 if amount is None else _number(cells[amount], f"line {line}")
    return counts


def _find(head: list[str], *names: str) -> int:
    """Find the column that has one of the names."""
    found = [index for index, cell in enumerate(head) if cell in names]
    if len(found) != 1:
        many = "several columns" if found else "no column"
        raise InputError(f"{many} {' or '.join(names)} in its first line, which names the columns")
    return found[0]


def _cell(cells: list[str], columns: list[int], line: int) -> tuple[int, int]:
    try:
        row, column = (int(cells[index]) for index in columns)
        return row, column
    except (ValueError, IndexError):
        raise InputError(f"line {line}: row and column must be whole numbers from 0") from None


def _number(text: str, where: str) -> float:
    try:
        number = float(text.replace(",", "."))
    except ValueError:
        number = np.nan
    # A comma before three digits may part thousands, or be a decimal one.
    if not 0 <= number < np.inf or re.fullmatch(r"[1-9]\d{0,2}(,\d{3})+", text):
        raise InputError(f"{where}: {text!r} is not a weight: give a number like 1200 or 1.2")
    return number


def _spread(counts: Mapping[tuple[int, int], float], endpoints: np.ndarray) -> np.ndarray:
    """Give each cell the count of its nearest endpoint; a shelf's is divided among those beside."""
    odds, (rows, cols) = np.zeros(endpoints.shape), endpoints.shape
    found = {(row, column) for row, column in np.argwhere(endpoints).tolist()}
    for (row, column), count in counts.items():
        beside = [(row + down, column + right) for down, right in MOVES]
        near = {(row, column)} & found or {*beside} & found
        if not (0 <= row < rows and 0 <= column < cols and near):
            what = "neither an endpoint of the plan nor beside one: count both from 0"
            raise InputError(f"row {row}, column {column} is {what}")
        for cell in near:
            odds[cell] += count / len(near)
    away = ndimage.distance_transform_edt(~endpoints, return_distances=False, return_indices=True)
    return odds[tuple(away)]
