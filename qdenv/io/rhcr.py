"""Maps and grids of RHCR (https://github.com/Jiaoyang-Li/RHCR, KivaGraph.cpp).

A .map begins with four lines: rows and columns, the numbers of endpoints and of homes of robots,
and a number of timesteps. A .grid has a line for each cell: its type and the costs of its moves, in
the order of `io.guidance`, whatever their names; sorting centres have the name of a station, too.
"""

import re
from collections.abc import Mapping
from pathlib import Path

from qdenv.guidance import existing_moves
from qdenv.io.files import damaged, write_atomically
from qdenv.io.formats import redraw
from qdenv.io.guidance import TABLE_HEAD, costs_of, read_table, write_table
from qdenv.io.layouts import Drawing, check_size, free_cells, read_lines
from qdenv.types import InputError, Tile

HEAD = re.compile(r"\d{1,5}\s*,\s*\d{1,5}")  # the first line of a .map: rows, columns
_NUMBER = re.compile(r"\d{1,9}")
_HOME = "r"
_TYPES = {
    "Travel": ".",
    "Obstacle": "@",
    "Endpoint": "e",
    "Home": _HOME,
    "Induct": "i",
    "Eject": "o",
}
_MAXTIME = 5000


def read_rhcr(path: Path) -> Drawing:
    """Read a .map or .grid; homes become the places where robots start."""
    lines = read_lines(path, "map")
    grid = bool(lines) and lines[0].startswith("Grid size")
    sizes = lines[1 if grid else 0].strip() if len(lines) > 3 else ""
    if not HEAD.fullmatch(sizes):
        raise damaged(path, "not a map of RHCR: the number of rows and columns come first")
    height, width = map(int, sizes.split(","))
    check_size(height, width, f"{path}: ")
    if grid:
        rows, listed = _read_grid(path, lines[2:])
        weights = None if {*listed} == {1.0} else listed  # no move is dearer than another
        details: dict[str, int] = {}
    else:
        rows, weights = lines[4:], None
        details = {"maxtime": int(lines[3])} if _NUMBER.fullmatch(lines[3].strip()) else {}
    if [*map(len, rows)] != [width] * height:
        raise damaged(path, f"the head says {height} x {width}, the rows are others")
    homes = [place for place, symbol in enumerate("".join(rows)) if symbol == _HOME]
    rows = [row.replace(_HOME, ".") for row in rows]
    return Drawing(rows, weights=weights, details=details, starts=tuple(homes))


def _read_grid(path: Path, lines: list[str]) -> tuple[list[str], list[float]]:
    """Read a grid's lines, the head first: as a table of costs with symbols for types."""
    station = lines[0].split(",")[2:3] == ["station"]
    cells = [line.split(",") for line in lines[1:]]
    unknown = {cell[1] for cell in cells if len(cell) > 1} - _TYPES.keys()
    if unknown or any(len(cell) != 9 + station for cell in cells):
        what = f"unknown type {min(unknown)!r}" if unknown else "a line is no cell with its costs"
        raise damaged(path, f"{what}: types are {', '.join(_TYPES)}")
    table = [[cell[0], _TYPES[cell[1]], *cell[2 + station :]] for cell in cells]
    # An obstacle is not waited on, whatever is written there.
    table = [[*cell[:-1], "inf"] if cell[1] == "@" else cell for cell in table]
    try:
        return read_table([TABLE_HEAD, *(",".join(cell) for cell in table)])
    except InputError as error:
        raise damaged(path, error) from error


def write_rhcr(path: Path, drawing: Drawing, meanings: Mapping[str, Tile]) -> list[str]:
    """Write a .map, or with costs of moves a .grid."""
    grid = path.suffix.lower() == ".grid"
    stations = {"i": "i", "o": "o", "w": "e"} if grid else {"w": "w", "i": "w", "o": "w"}
    rows, lost = redraw(drawing.rows, meanings, {"e": "e"} | stations, ".@")
    cols = len(rows[0])
    tiles = [[*row] for row in rows]
    for start in drawing.starts:
        if tiles[start // cols][start % cols] == ".":
            tiles[start // cols][start % cols] = _HOME
    rows = ["".join(row) for row in tiles]
    if "".join(rows).count(_HOME) < len(drawing.starts):
        lost.append("starts on other tiles than floor are")
    drawn, free = "".join(rows), free_cells(drawing.rows, meanings)
    if grid:
        names = {symbol: name for name, symbol in _TYPES.items()}
        weights = drawing.weights or [1.0] * int(1 + existing_moves(free)[1:].sum())
        head, *cells = write_table(rows, costs_of(weights, free)).splitlines()
        parts = [cell.split(",", 2) for cell in cells]
        body = [f"{number},{names[symbol]},{rest}" for number, symbol, rest in parts]
        lines = ["Grid size (x, y)", f"{len(rows)},{cols}", head, *body]
    else:
        maxtime = drawing.details.get("maxtime", _MAXTIME)
        counts = [drawn.count("e"), drawn.count(_HOME), maxtime]
        lines = [f"{len(rows)},{cols}", *map(str, counts), *rows]
    write_atomically(path, ("\n".join(lines) + "\n").encode())
    return lost
