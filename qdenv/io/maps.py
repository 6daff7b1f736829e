"""Maps of benchmarks: MovingAI, League of Robot Runners, RHCR, POGEMA; with starts and tasks.

MovingAI (https://movingai.com/benchmarks/formats.html) tells open ground from obstacles. The League
of Robot Runners (https://github.com/MAPF-Competition/Start-Kit, Input_Output_Format.md) adds
emitters E, where goods are delivered, and service points S, where they are picked up. Its problem
is a JSON file that names a map, the cells where robots start, and tasks: the cells to visit in
order. POGEMA (https://github.com/Cognitive-AI-Systems/pogema) draws maps with ``.`` and ``#``.

A .map of RHCR (https://github.com/Jiaoyang-Li/RHCR, KivaGraph.cpp) begins with four lines: rows and
columns, the numbers of endpoints and of homes of robots, and a number of timesteps. A .grid has a
line for each cell: its type and the costs of its moves, in the order of `io.guidance`, whatever
their names; sorting centres have the name of a station, too.
"""

import json
import os.path
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from qdenv.guidance import existing_moves
from qdenv.io.files import damaged, parsing, read_text, write_atomically
from qdenv.io.formats import redraw
from qdenv.io.guidance import costs_of, read_table, write_table
from qdenv.io.layouts import Drawing, check_size, free_cells, read_lines
from qdenv.io.records import parse_json, structured
from qdenv.lazy import ndimage
from qdenv.types import InputError, Tile

# Swamp is open ground; water is none, as it cannot be entered from the ground.
_MOVING_AI = str.maketrans({**dict.fromkeys(".GS", "."), **dict.fromkeys("@OTW", "#")})
_RUNNERS = str.maketrans({"S": "e", "E": "w", "T": "#", "G": ".", "O": "#", "W": "#"})
_ON_RUNNERS: dict[str, Any] = {"e": "S", "w": "E", "i": "E", "o": "E", "#": "T", "X": "T"}
_RHCR_HEAD = re.compile(r"\d{1,5}\s*,\s*\d{1,5}")  # the first line of a .map: rows, columns
_HOME = "r"
_TYPES = dict(Travel=".", Obstacle="@", Endpoint="e", Home=_HOME, Induct="i", Eject="o")


def read_map(path: Path) -> Drawing:
    """Read a .map of MovingAI, the League of Robot Runners, or RHCR, as its lines tell.

    On MovingAI's, open ground becomes ``.``, all that blocks ``#``. On the League's, which have
    emitters, a block of obstacles is shelves if a service point lies beside it, else walls.
    """
    lines = read_lines(path, "map")
    if lines and _RHCR_HEAD.fullmatch(lines[0].strip()):
        return read_rhcr(path)
    names = [line.strip() for line in lines]
    if "map" not in names:
        raise damaged(path, "not a MovingAI map: type, height, width and map come first")
    end = names.index("map")
    parts = [line.split(maxsplit=2) for line in lines[:end]]
    head = dict(line for line in parts if len(line) == 2)
    rows = lines[end + 1 :]
    sizes = {"height": len(rows), "width": max(map(len, rows), default=0)}
    for name, number in sizes.items():
        if head.get(name, str(number)) != str(number):
            raise damaged(path, f"the head says {name} {head[name]}, the map has {number}")
    return Drawing(_read_signs(rows))


def _read_signs(rows: Sequence[str]) -> list[str]:
    """Turn the signs of a map into symbols."""
    if not any("E" in row for row in rows) or len({*map(len, rows)}) > 1:
        return [row.translate(_MOVING_AI) for row in rows]
    signs = np.array([[*row.translate(_RUNNERS)] for row in rows])
    blocks, _ = ndimage.label(signs == "@")
    served = np.unique(blocks[ndimage.binary_dilation(signs == "e")])
    signs[(signs == "@") & ~np.isin(blocks, served)] = "#"
    return ["".join(row) for row in signs]


def _write_map(path: Path, rows: Sequence[str]) -> None:
    """Write rows under the head of a MovingAI map."""
    head = f"type octile\nheight {len(rows)}\nwidth {len(rows[0])}\nmap\n"
    write_atomically(path, (head + "\n".join(rows) + "\n").encode())


def write_movingai(path: Path, drawing: Drawing, meanings: Mapping[str, Tile]) -> list[str]:
    """Write a .map: open ground and obstacles."""
    rows, lost = redraw(drawing.rows, meanings, {}, ".@")
    _write_map(path, rows)
    return lost


def read_scen(path: Path) -> Drawing:
    """Read starts and goals, and the map beside them; a line is a robot with one task."""
    lines = read_lines(path, "scenario")
    if not lines or not lines[0].startswith("version"):
        raise damaged(path, "not a MovingAI scenario: the first line is its version")
    fields = [line.split("\t") if "\t" in line else line.split() for line in lines[1:] if line]
    if not fields or any(len(line) != 9 for line in fields):
        raise damaged(path, "a line is bucket, map, width, height, start x, y, goal x, y, length")
    names = {line[1] for line in fields}
    if len(names) > 1:
        raise damaged(path, f"starts on {len(names)} maps: only those of one map are read")
    below = path.parent / names.pop()
    # Scenarios name maps by their place in the benchmarks; people have them beside the scenario.
    drawing = read_map(below if os.path.isfile(below) else path.parent / below.name)
    with parsing(path, "a whole number"):
        points = np.array([[int(number) for number in line[2:8]] for line in fields])
    cols = len(drawing.rows[0]) if drawing.rows else 0
    if (points[:, [1, 0]] != (len(drawing.rows), cols)).any():
        raise damaged(path, f"the map is {len(drawing.rows)} x {cols}, not what a line says")
    if (points[:, 2:] < 0).any() or (points[:, 2:] >= points[:, [0, 1, 0, 1]]).any():
        raise damaged(path, "a start or goal lies outside of the map")
    starts, goals = (points[:, [3, 5]] * cols + points[:, [2, 4]]).T.tolist()
    lost = ("buckets and lengths of paths are",)
    return drawing._replace(starts=tuple(starts), tasks=tuple((one,) for one in goals), lost=lost)


def write_scen(path: Path, drawing: Drawing, meanings: Mapping[str, Tile]) -> list[str]:
    """Write robots' starts with the first place of their tasks, and the map beside it."""
    if not drawing.starts or not drawing.tasks:
        raise InputError(f"{path}: starts and goals of robots are missing: write a .map")
    beside = path.with_suffix(".map")
    lost = write_movingai(beside, drawing, meanings)
    rows, cols = len(drawing.rows), len(drawing.rows[0])
    lines = ["version 1"]
    for start, task in zip(drawing.starts, drawing.tasks, strict=False):
        (y, x), (goal_y, goal_x) = divmod(start, cols), divmod(task[0], cols)
        lines.append(f"0\t{beside.name}\t{cols}\t{rows}\t{x}\t{y}\t{goal_x}\t{goal_y}\t0")
    write_atomically(path, ("\n".join(lines) + "\n").encode())
    if len(drawing.tasks) != len(drawing.starts) or any(len(task) > 1 for task in drawing.tasks):
        lost.append("all but one robot for each task, and the first place of each task, are")
    return [*lost, "lengths of paths (written as 0) are"]


def read_lorr(path: Path) -> Drawing:
    """Read a map of the League of Robot Runners, or a problem with its robots and tasks."""
    if path.suffix.lower() == ".map":
        return read_map(path)
    content = structured(
        parse_json(read_text(path, what="JSON"), path), dict[str, Any], f"{path}, problem"
    )
    files = {}
    for name in ("mapFile", "agentFile", "taskFile"):
        if not isinstance(content.get(name), str):
            raise damaged(path, f"a problem names its {name}")
        files[name] = path.parent / content.pop(name)
    drawing, team = read_map(files["mapFile"]), content.pop("teamSize", None)
    cells = len(drawing.rows) * max(map(len, drawing.rows), default=0)
    starts = [line[0] for line in _read_cells(files["agentFile"], cells)]
    tasks = _read_cells(files["taskFile"], cells)
    lost = []
    if isinstance(team, int) and 0 <= team < len(starts):
        lost = [f"{len(starts) - team} robots beyond the team's size are"]
        starts = starts[:team]
    domain = content.pop("domain", None)
    return drawing._replace(
        domain=domain if isinstance(domain, str) else None,
        keep=structured(content.pop("keep", []), tuple[str, ...], f"{path}, keep"),
        starts=tuple(starts),
        tasks=tuple(tasks),
        details=content,
        lost=(*drawing.lost, *lost),
    )


def _read_cells(path: Path, cells: int) -> list[tuple[int, ...]]:
    """Read lists of cells, one a line; their number comes first."""
    lines = [line.partition("#")[0].strip() for line in read_text(path, what="list").splitlines()]
    try:
        (count,), *places = [tuple(map(int, line.split(","))) for line in lines if line]
    except (ValueError, OverflowError) as error:
        raise damaged(path, "the number of lines comes first, then cells, a list a line") from error
    if count != len(places):
        raise damaged(path, f"{count} lines are announced, there are {len(places)}")
    for place in (place for line in places for place in line):
        if not 0 <= place < cells:
            raise damaged(path, f"cell {place} is not on the map, whose last one is {cells - 1}")
    return places


def write_lorr(path: Path, drawing: Drawing, meanings: Mapping[str, Tile]) -> list[str]:
    """Write a map, or a problem with the map, the robots' starts and the tasks beside it."""
    rows, lost = redraw(drawing.rows, meanings, _ON_RUNNERS, ".@")
    # Endpoints without stations are swamp on MovingAI's maps, shelves without endpoints walls.
    back = "".join(_read_signs(rows)).translate(str.maketrans(_ON_RUNNERS))
    cells = zip("".join(drawing.rows), "".join(rows), back, strict=True)
    if other := {symbol for symbol, sign, read in cells if sign != read}:
        names = sorted({meanings.get(symbol, Tile(symbol)).name for symbol in other})
        lost.append(f"what some cells are ({', '.join(names)}) is")
    if path.suffix.lower() == ".map":
        _write_map(path, rows)
        return lost
    if not drawing.starts or not drawing.tasks:
        raise InputError(f"{path}: a problem needs robots' starts and tasks: write a .map")
    lists = {".agents": [(start,) for start in drawing.starts], ".tasks": drawing.tasks}
    _write_map(path.with_suffix(".map"), rows)
    for ending, places in lists.items():
        lines = [str(len(places)), *(",".join(map(str, line)) for line in places)]
        write_atomically(path.with_suffix(ending), ("\n".join(lines) + "\n").encode())
    stem = {f"{name}File": f"{path.stem}.{name}s" for name in ("agent", "task")}
    content = {"mapFile": f"{path.stem}.map", **stem, "teamSize": len(drawing.starts)}
    text = json.dumps({"numTasksReveal": 1.5, **drawing.details, **content}, indent=4)
    write_atomically(path, f"{text}\n".encode())
    return lost


def read_pogema(path: Path) -> Drawing:
    """Read a map with robots a, b, ... and their goals A, B, ..."""
    rows = [line.strip() for line in read_lines(path, "map")]
    cols = max(map(len, rows), default=0)
    letters = {
        symbol: row * cols + col
        for row, line in enumerate(rows)
        for col, symbol in enumerate(line)
        if symbol.isascii() and symbol.isalpha()
    }
    starts = sorted(symbol for symbol in letters if symbol.islower())
    if [symbol.upper() for symbol in starts] != sorted({*letters} - {*starts}):
        raise damaged(path, "a robot a has a goal A, and each goal a robot")
    tasks = tuple((letters[symbol.upper()],) for symbol in starts)
    marked = any(symbol in row for row in rows for symbol in "@$!")
    lost = ("where robots may start and goals may be (@ $ !) are",) * marked
    plain = str.maketrans(dict.fromkeys((*letters, *"@$!"), "."))
    drawn = [row.translate(plain) for row in rows]
    return Drawing(drawn, starts=tuple(letters[one] for one in starts), tasks=tasks, lost=lost)


def write_pogema(path: Path, drawing: Drawing, meanings: Mapping[str, Tile]) -> list[str]:
    """Write free cells as ``.``, obstacles as ``#``."""
    rows, lost = redraw(drawing.rows, meanings, {}, ".#")
    write_atomically(path, ("\n".join(rows) + "\n").encode())
    return lost


def read_rhcr(path: Path) -> Drawing:
    """Read a .map or .grid; homes become the places where robots start."""
    lines = read_lines(path, "map")
    grid = bool(lines) and lines[0].startswith("Grid size")
    sizes = lines[1 if grid else 0].strip() if len(lines) > 3 else ""
    if not _RHCR_HEAD.fullmatch(sizes):
        raise damaged(path, "not a map of RHCR: the number of rows and columns come first")
    height, width = map(int, sizes.split(","))
    check_size(height, width, f"{path}: ")
    if grid:
        rows, listed = _read_grid(path, lines[2:])
        weights = None if {*listed} == {1.0} else listed  # no move is dearer than another
        details: dict[str, int] = {}
    else:
        rows, weights = lines[4:], None
        details = {"maxtime": int(lines[3])} if re.fullmatch(r"\d{1,9}", lines[3].strip()) else {}
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
        what = f"unknown type {min(unknown)!r}" if unknown else "a line is not a cell with costs"
        raise damaged(path, f"{what}: types are {', '.join(_TYPES)}")
    table = [[cell[0], _TYPES[cell[1]], *cell[2 + station :]] for cell in cells]
    # An obstacle is not waited on, whatever is written there.
    table = [[*cell[:-1], "inf"] if cell[1] == "@" else cell for cell in table]
    return read_table(path, [",".join(cell) for cell in table], 3)


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
    drawn = "".join(rows)
    if drawn.count(_HOME) < len(drawing.starts):
        lost.append("starts on other tiles than floor are")
    if grid:
        free = free_cells(drawing.rows, meanings)
        names = {symbol: name for name, symbol in _TYPES.items()}
        weights = drawing.weights or [1.0] * int(1 + existing_moves(free)[1:].sum())
        head, *cells = write_table(rows, costs_of(weights, free)).splitlines()
        if {"i", "o"} & {*drawn}:  # a sorting centre, whose stations have names
            head = head.replace("type", "type,station")
            names = {symbol: f"{name},None" for symbol, name in names.items()}
            names |= {"i": "Induct,{0}", "o": "Eject,{0}"}
        parts = [cell.split(",", 2) for cell in cells]
        body = [f"{cell},{names[symbol].format(cell)},{rest}" for cell, symbol, rest in parts]
        lines = ["Grid size (x, y)", f"{len(rows)},{cols}", head, *body]
    else:
        counts = [drawn.count("e"), drawn.count(_HOME), drawing.details.get("maxtime", 5000)]
        lines = [f"{len(rows)},{cols}", *map(str, counts), *rows]
    write_atomically(path, ("\n".join(lines) + "\n").encode())
    return lost
