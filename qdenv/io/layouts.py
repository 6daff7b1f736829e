"""Layout files: rows of symbols as JSON, plain text or a spreadsheet's CSV; the record of a file.

JSON has the shape of the layouts published with the paper, an object with a list of equally long
rows under "layout"; other keys are details. Headers that contradict the rows are ignored, too: the
rows are what is simulated. JSON and a CSV of another form hold costs of moves as well, see
`io.guidance`. Other formats are listed in `io.formats`.
"""

import csv
import tomllib
from collections.abc import Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import Annotated, Any, NamedTuple, cast

import numpy as np
from annotated_types import Interval

from qdenv.grid import draw, parse
from qdenv.io.facts import FENCE, facts_beside, make_facts
from qdenv.io.files import MEGABYTE, damaged, parsing, read_text, write_atomically, write_json
from qdenv.io.formats import ALL_ENDINGS, LIBRARIES, READ_ENDINGS, find_reader, holds, write_drawing
from qdenv.io.guidance import TABLE_HEAD, costs_of, read_table, weights_of, write_table
from qdenv.io.records import parse_json, structured
from qdenv.ranges import check_range
from qdenv.types import Array, DamagedError, InputError, Tile, about

ENDINGS = (".json", ".txt", ".csv", ".map")  # of layout files; `io.formats` has the others
_MAX_BYTES = 32 * MEGABYTE
MAX_SIDE = 1000  # rows or columns; nothing larger was tried
_MAX_LINES = 20 * MAX_SIDE  # blank ones around a drawing with them
_DELIMITERS = ";,\t"
_TABLES = (TABLE_HEAD, "Grid size")  # files with a line for each cell begin so


class Drawing(NamedTuple):
    """What a layout file holds."""

    rows: list[str]  # whose symbols are not checked yet; empty where a file holds weights alone
    domain: str | None = None  # whose layout it is; None where the file does not say so
    keep: tuple[str, ...] = ()  # rows of what must stay; empty where nothing must
    # costs of moves (`io.guidance`); None where the file states none
    weights: Sequence[float] | None = None
    details: Mapping[str, Any] = MappingProxyType({})  # what else the file states, JSON-ready
    starts: tuple[int, ...] = ()  # cell (row * columns + column) of each robot; empty where unknown
    tasks: tuple[tuple[int, ...], ...] = ()  # the cells of each task, in order of visits
    lost: tuple[str, ...] = ()  # what of the file is left out, a few words each


def read_drawing(path: str | Path, form: str | None = None) -> Drawing:
    """Read a drawing in any format of `io.formats`, that of the name `form` unless it is None.

    Otherwise the ending of the file's name says how it is written. A byte-order mark, any kind of
    line ending and blank lines around the drawing are fine. Raises InputError if the file is
    missing, too big, or not what its ending says.
    """
    path, reader = Path(path), find_reader(Path(path), form)
    try:
        drawing: Drawing = reader(path)
        own = structured(drawing.details.get("facts", {}), dict[str, Any], f"{path}, facts")
    except DamagedError as error:
        if path.suffix.lower() in READ_ENDINGS:
            raise
        raise InputError(f"{error}: layouts end in {', '.join(READ_ENDINGS)}") from error
    facts = facts_beside(path) | own  # a file's own facts count more
    if facts:
        stated = make_facts(facts, path if own else path.with_suffix(".toml"))
        legend = str.maketrans(dict(stated.legend))
        details = {**drawing.details, "facts": {**facts, "legend": {}}}
        drawing = drawing._replace(
            rows=[row.translate(legend) for row in drawing.rows],
            domain=drawing.domain or stated.domain,
            keep=drawing.keep or stated.drawing,
            details=details if stated.cell is None else details | {"cell": stated.cell},
        )
    if any(drawing.rows):
        check_size(len(drawing.rows), max(map(len, drawing.rows)), f"{path}: ")
    return drawing


def check_size(rows: int, cols: int, place: str = "") -> None:
    """Raise InputError, which begins with `place`, for a size that no layout may have."""
    for name, side in (("rows", rows), ("columns", cols)):
        check_range(name, side, Annotated[int, Interval()])
    if max(rows, cols) > MAX_SIDE:
        reason = f"more than {MAX_SIDE} rows or columns are not supported"
        raise InputError(f"{place}{rows} x {cols}: {reason}")
    if min(rows, cols) < 1:
        raise InputError(f"{place}{rows} x {cols}: give 1 row and 1 column or more")


def read_lines(path: Path, what: str) -> list[str]:
    """Read the lines of a text file, without the blank ones around them."""
    text = read_text(path, _MAX_BYTES, what)
    if text.count("\n") + text.count("\r") > _MAX_LINES and not text.startswith(_TABLES):
        raise damaged(path, f"more than {_MAX_LINES:,} lines, this is not a layout file")
    lines = text.replace("\r\n", "\n").replace("\r", "\n").split("\n")
    width = max(map(len, lines))
    # A line of blanks as wide as the widest line is a row: mazes draw empty cells like that.
    drawn = [i for i, line in enumerate(lines) if line.strip() or 0 < len(line) == width]
    return lines[drawn[0] : drawn[-1] + 1] if drawn else []


def read_text_rows(path: Path) -> Drawing:
    """Read the rows of a text file, and the facts above them (`io.facts`)."""
    rows, facts = read_lines(path, "text"), {}
    if rows and rows[0].rstrip() == FENCE:
        ends = [number for number, row in enumerate(rows) if row.rstrip() == FENCE]
        if len(ends) != 2:
            raise damaged(path, f"one line {FENCE} begins facts, a second one ends them")
        with parsing(path, "TOML"):
            facts = tomllib.loads("\n".join(rows[1 : ends[1]]))
        rows = rows[ends[1] + 1 :]
        while rows and not rows[0].strip():
            del rows[0]
    return Drawing(rows, details={"facts": facts} if facts else {})


def read_json_rows(path: Path) -> Drawing:
    """Find the rows in an object with "layout" or "weights", or in a plain list."""
    content = parse_json(read_text(path, _MAX_BYTES, "JSON"), path)
    content = content if isinstance(content, dict) else {"layout": content}
    if "mapFile" in content:  # a problem of the League of Robot Runners
        return cast(Drawing, find_reader(path, "lorr")(path))
    weights = content.get("weights")
    rows = content.get("layout", None if weights is None else [])
    if not isinstance(rows, list) or not all(isinstance(row, str) for row in rows):
        raise damaged(path, 'expected an object with a list of strings under "layout", or the list')
    if weights is not None:
        weights = structured(weights, list[float], f"{path}, weights", infinite=True)
    domain = content["domain"] if isinstance(content.get("domain"), str) else None
    keep = structured(content.get("keep", []), tuple[str, ...], f"{path}, keep")
    starts = structured(content.get("starts", []), tuple[int, ...], f"{path}, starts")
    tasks = structured(content.get("tasks", []), tuple[tuple[int, ...], ...], f"{path}, tasks")
    if not all(tasks):
        raise damaged(path, "a task has no cell")
    own = ("n_row", "n_col", "layout", "weights", "domain", "keep", "starts", "tasks")
    details = {name: value for name, value in content.items() if name not in own}
    return Drawing(rows, domain, keep, weights, details, starts, tasks)


def read_csv_rows(path: Path) -> Drawing:
    """Join a table's cells, one tile each; lines of one cell are rows as they are."""
    lines = read_lines(path, "CSV")
    if lines and lines[0] == TABLE_HEAD:
        rows, weights = read_table(path, lines[1:], 1)
        return Drawing(rows, weights=weights)
    table = split_cells(path, lines)
    if all(len(line) == 1 for line in table):
        return Drawing([line[0] for line in table])
    return Drawing(join_cells(path, table))


def split_cells(path: Path, lines: Sequence[str]) -> list[list[str]]:
    """Split the lines of a CSV file into cells; the most frequent delimiter is the file's.

    Semicolons separate a table of numbers that holds any; its commas are decimal.
    Raises DamagedError for what is no CSV, InputError for more columns than a layout may have.
    """
    counts = {one: sum(line.count(one) for line in lines) for one in _DELIMITERS}
    delimiter = max(_DELIMITERS, key=counts.__getitem__)
    if counts[";"] and not "".join(lines).strip("0123456789+-eE.,; "):  # the commas are decimal
        delimiter = ";"
    if lines and lines[0].lower().startswith("sep="):  # Excel's own hint
        hint, *lines = lines
        delimiter = hint[4:5] if hint[4:5] in (*_DELIMITERS, "|") else delimiter
    # Before it is split: a line of delimiters would fill the memory with empty cells.
    widest = max((line.count(delimiter) for line in lines), default=0)
    check_size(1, 1 + widest, f"{path}: ")
    with parsing(path, "a CSV file"):
        return list(csv.reader(lines, delimiter=delimiter, strict=True))


def join_cells(path: Path, table: Sequence[Sequence[str]]) -> list[str]:
    """Join the cells of a table, one tile each; an empty one is a blank."""
    rows = []
    for row, line in enumerate(table):
        tiles = [cell.strip() or " " for cell in line]
        for col, (cell, tile) in enumerate(zip(line, tiles, strict=True)):
            if len(tile) > 1:
                shown = cell if len(cell) < MAX_SIDE else f"{cell[:MAX_SIDE]}..."
                raise damaged(path, f"{shown!r} at row {row}, column {col}: a cell holds one tile")
        rows.append("".join(tiles))
    return rows


BLANKS = " ."  # empty cells, drawn either way


def to_layout(
    rows: Sequence[str], path: str | Path, tiles: str, meanings: Mapping[str, Tile], whose: str
) -> np.ndarray:
    """Turn the drawn rows of a file into a layout (int8 [H, W]).

    `tiles` is the domain's alphabet, `meanings` what its symbols mean, and what else draws them.
    Where a blank draws an obstacle, which is around a building, it fills short lines of text and
    CSV. Raises InputError, which names the file `path` and the domain `whose`, if the drawing is
    empty or ragged, or holds a symbol that means nothing.
    """
    known = aliases(tiles, meanings)
    outside = meanings.get(known.get(" ", ""))
    if outside and outside.obstacle and Path(path).suffix.lower() in (".txt", ".csv"):
        width = max(map(len, rows), default=0)
        rows = [row.ljust(width) for row in rows]
    table = str.maketrans(known)
    drawn = [row.translate(table) for row in rows]
    with about(str(path)):
        return parse(drawn, tiles, f"{whose} knows {alphabet(tiles, meanings)}")


def alphabet(tiles: str, meanings: Mapping[str, Tile]) -> str:
    """List the symbols of an alphabet with what they mean, in a line."""
    names = {symbol: f" {tile.name}" for symbol, tile in meanings.items()}
    return ", ".join(f"{symbol!r}{names.get(symbol, '')}" for symbol in tiles)


def aliases(tiles: str, meanings: Mapping[str, Tile]) -> dict[str, str]:
    """List what else may be drawn for which symbol: ``#`` for a wall, a blank for a dot."""
    known = {other: symbol for symbol, tile in meanings.items() for other in tile.also}
    blanks = {other: symbol for symbol in BLANKS if symbol in tiles for other in BLANKS}
    return {other: symbol for other, symbol in (blanks | known).items() if other not in tiles}


def endings_for(tiles: str, meanings: Mapping[str, Tile], costs: bool = False) -> tuple[str, ...]:
    """List endings of files that hold every tile of an alphabet, and costs of moves if `costs`."""
    every = set(tiles) <= _on_map(tiles, meanings).keys()
    plain = [ending for ending in ENDINGS if every or ending != ".map"]
    return tuple(one for one in (*plain, *LIBRARIES) if not costs or holds(one, "weights"))


def write_layout(
    path: str | Path,
    layout: Array,
    tiles: str,
    meanings: Mapping[str, Tile] = MappingProxyType({}),
    costs: np.ndarray | None = None,
    /,
    **details: Any,
) -> list[str]:
    """Write a layout (int8 [H, W]) atomically, in the usual format of its ending.

    A map needs the `meanings` of the symbols: what is an obstacle. `costs` are those of moves,
    float [5, H, W], where waiting on an obstacle costs infinity. `details` are JSON-ready facts
    beside the rows; JSON alone holds all. Returns what is left out, a line each. Raises
    InputError if no layout may be so large, a .map would lose tiles or any file costs, no format
    has its ending, or it cannot be written.
    """
    path, rows = Path(path), draw(layout, tiles)
    ending = path.suffix.lower()
    check_size(len(rows), len(rows[0]))
    if costs is not None and not holds(ending, "weights"):
        raise InputError(f"{path}: a {ending} holds no costs of moves: write a .json or .csv")
    if ending == ".map":
        table = _on_map(tiles, meanings)
        used = "".join(rows)
        lost = "".join(symbol for symbol in tiles if symbol not in table and symbol in used)
        if lost:
            also = f"this layout also has {alphabet(lost, meanings)}: write a .json, .txt or .csv"
            raise InputError(f"{path}: a .map tells open ground from obstacles only, {also}")
    weights = None if costs is None else weights_of(costs)
    if costs is not None:  # these say where robots drive, whatever the tiles mean
        blocked = {tiles[kind] for kind in np.unique(np.asarray(layout)[np.isinf(costs[0])])}
        meanings = {
            symbol: meanings.get(symbol, Tile(symbol))._replace(obstacle=symbol in blocked)
            for symbol in tiles
        }
    drawing = Drawing(rows, weights=weights, details=details)
    return write_drawing(path, drawing, meanings, None if ending in ALL_ENDINGS else "json")


def write_json_rows(path: Path, drawing: Drawing, _: Mapping[str, Tile]) -> None:
    """Write rows with their size, all details, and the costs of moves."""
    rows = drawing.rows
    size = {"n_row": len(rows), "n_col": len(rows[0])}
    parts = {"starts": drawing.starts, "tasks": drawing.tasks, "weights": drawing.weights}
    stated = {name: part for name, part in parts.items() if part}
    write_json(path, {**size, **drawing.details, "layout": rows, **stated})


def write_text_rows(path: Path, drawing: Drawing, _: Mapping[str, Tile]) -> None:
    """Write rows as they are."""
    write_atomically(path, ("\n".join(drawing.rows) + "\n").encode())


def write_csv_rows(path: Path, drawing: Drawing, meanings: Mapping[str, Tile]) -> None:
    """Write one tile in each cell; where moves have costs, a line for each tile."""
    rows = drawing.rows
    if drawing.weights is None:
        text = "\n".join(",".join(row) for row in rows) + "\n"
    else:
        text = write_table(rows, costs_of(drawing.weights, free_cells(rows, meanings)))
    write_atomically(path, text.encode())


def free_cells(rows: Sequence[str], meanings: Mapping[str, Tile]) -> np.ndarray:
    """Find the cells that robots may drive on (bool [H, W])."""
    blocked = {symbol for symbol, tile in meanings.items() if tile.obstacle}
    return np.array([[symbol not in blocked for symbol in row] for row in rows])


def _on_map(tiles: str, meanings: Mapping[str, Tile]) -> dict[str, Any]:
    """Pair the symbols that a map can hold with MovingAI's: those that read back as they were."""
    known = {symbol: symbol for symbol in tiles} | aliases(tiles, meanings)
    return {known[read]: drawn for read, drawn in ((".", "."), ("#", "@")) if read in known}
