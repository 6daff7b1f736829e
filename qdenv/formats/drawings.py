"""Drawings in files: rows of symbols as JSON, plain text, a spreadsheet's CSV or MovingAI's map."""

import codecs
import csv
import json
from pathlib import Path
from typing import Any, NamedTuple, TypeGuard

from qdenv.types import InputError

ENDINGS = (".json", ".txt", ".csv", ".map")  # of layout files; any other ending is JSON's
MAX_BYTES = 32 * 2**20
MAX_SIDE = 1000  # rows or columns; nothing larger was tried
DELIMITERS = ";,\t"
UTF_16 = (codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)
# Swamp is open ground, water is none: nobody gets there from the ground.
OPEN, BLOCKED = ".GS", "@OTW"
MOVING_AI = str.maketrans({**dict.fromkeys(OPEN, "."), **dict.fromkeys(BLOCKED, "#")})


class Drawing(NamedTuple):
    """What a file draws; nobody has looked at the symbols yet.

    Attributes:
        rows: the drawing.
        domain: whose drawing the file says it is; None where it says nothing.
        keep: which cells must stay, as the file says; empty where it says nothing.
    """

    rows: list[str]
    domain: str | None = None
    keep: tuple[str, ...] = ()


def read_drawing(path: str | Path) -> Drawing:
    """Read a drawing; the ending of its name says how it is written.

    A byte-order mark, any kind of line ending and blank lines around the drawing are fine.

    Raises:
        InputError: the file is missing, too big, or not what its ending says.
    """
    ending = Path(path).suffix.lower()
    try:
        if ending == ".txt":
            drawing = Drawing(trim(_read_text(path, "text")))
        elif ending == ".csv":
            drawing = Drawing(_cells(_read_text(path, "CSV")))
        elif ending == ".map":
            drawing = Drawing(_moving_ai(_read_text(path, "map")))
        else:
            drawing = _json(_read_text(path, "JSON"))
        if any(drawing.rows):
            check_size(len(drawing.rows), max(map(len, drawing.rows)))
    except InputError as error:
        raise InputError(f"{path}: {error}") from error
    return drawing


def check_size(rows: int, cols: int) -> None:
    """Refuse sizes that no layout may have.

    Raises:
        InputError: there are too many rows or columns, or less than one.
    """
    if max(rows, cols) > MAX_SIDE:
        raise InputError(f"{rows} x {cols}: more than {MAX_SIDE} rows or columns are not supported")
    if min(rows, cols) < 1:
        raise InputError(f"{rows} x {cols}: give 1 row and 1 column or more")


def trim(text: str) -> list[str]:
    """Split text into lines, without the blank ones around them.

    A line of blanks as wide as the widest line is a row: mazes draw empty cells like that.
    """
    lines = text.replace("\r\n", "\n").replace("\r", "\n").split("\n")
    width = max(map(len, lines))
    drawn = [i for i, line in enumerate(lines) if line.strip() or 0 < len(line) == width]
    return lines[drawn[0] : drawn[-1] + 1] if drawn else []


def _read_text(path: str | Path, what: str) -> str:
    """Read a text file of a sensible size, as UTF-8 or as the UTF-16 of Windows' shell."""
    try:
        if Path(path).stat().st_size > MAX_BYTES:
            raise InputError(f"bigger than {MAX_BYTES >> 20} MB, this is no layout file")
        content = Path(path).read_bytes()
        return content.decode("utf-16" if content.startswith(UTF_16) else "utf-8-sig")
    except OSError as error:
        raise InputError(f"cannot be read ({error.strerror or error})") from error
    except UnicodeDecodeError as error:
        raise InputError(f"not a {what} file ({error})") from error


def _json(text: str) -> Drawing:
    """Find the rows in an object with "layout", or in a plain list."""
    try:
        content = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise InputError(
            f"not a JSON file ({error}): layouts end in {', '.join(ENDINGS)}"
        ) from error
    content = content if isinstance(content, dict) else {"layout": content}
    rows, domain, keep = (content.get(name) for name in ("layout", "domain", "keep"))
    if not _are_rows(rows):
        raise InputError('expected an object with a list of strings under "layout", or the list')
    kept = tuple(keep) if _are_rows(keep) else ()
    return Drawing(rows, domain if isinstance(domain, str) else None, kept)


def _are_rows(value: Any) -> TypeGuard[list[str]]:
    return isinstance(value, list) and all(isinstance(row, str) for row in value)


def _cells(text: str) -> list[str]:
    """Join a table's cells, one tile each; lines of one cell are rows as they are."""
    lines, delimiter = trim(text), max(DELIMITERS, key=text.count)
    if lines and lines[0].lower().startswith("sep="):  # Excel's own hint
        lines, delimiter = lines[1:], lines[0][4:5] or delimiter
    try:
        table = list(csv.reader(lines, delimiter=delimiter, strict=True))
    except csv.Error as error:
        raise InputError(f"not a CSV file ({error})") from error
    if all(len(line) == 1 for line in table):
        return [line[0] for line in table]
    return [
        "".join(_tile(cell, row, col) for col, cell in enumerate(line))
        for row, line in enumerate(table)
    ]


def _tile(cell: str, row: int, col: int) -> str:
    """Read one cell of a table; an empty one is a blank."""
    tile = cell.strip() or " "
    if len(tile) > 1:
        raise InputError(f"{cell!r} at row {row}, column {col}: a cell holds one tile")
    return tile


def _moving_ai(text: str) -> list[str]:
    """Read a map of the MovingAI benchmarks: a head that ends with the line ``map``, then rows.

    Open ground becomes ``.`` and everything blocked ``#``; other symbols stay as they are.
    """
    lines = trim(text)
    words = [line.split() for line in lines]
    if ["map"] not in words:
        raise InputError("not a MovingAI map: the lines type, height, width and map come first")
    end = words.index(["map"])
    head = dict(line for line in words[:end] if len(line) == 2)
    rows = [line.translate(MOVING_AI) for line in lines[end + 1 :]]
    found = {"height": len(rows), "width": max(map(len, rows), default=0)}
    for name, number in found.items():
        if head.get(name, str(number)) != str(number):
            raise InputError(f"the head says {name} {head[name]}, the map has {number}: mend one")
    return rows
