"""CSV: the columns and every cell against a record type."""

import csv
import math
from collections.abc import Collection, Iterator
from pathlib import Path
from typing import Any, TypeVar, get_type_hints

from qdenv.io.files import damaged, read_text

# Far beyond what a run writes; a hostile file may not fill the memory.
_MAX_COLUMNS = 1000
_MAX_ROWS = 2_000_000
_MAX_DIGITS = 40  # characters
_TRUTH = {"True": True, "False": False}
_TYPE_NAMES = {int: "a whole number", float: "a number", bool: "True or False"}
T = TypeVar("T", bound=tuple)


def read_rows(path: Path | str) -> Iterator[dict[str, str]]:
    """Read a CSV file with a head; yield the cells of each row by the names of the columns.

    Raises InputError if it cannot be read, or is damaged, after the rows before the damage.
    """
    rows = csv.reader(read_text(path, what="CSV").splitlines(keepends=True), strict=True)
    number = 0
    try:
        head = next(rows, [])
        if len(set(head)) < len(head) or not 0 < len(head) <= _MAX_COLUMNS:
            raise damaged(path, "no table: columns need names of their own")
        for number, row in enumerate(rows, start=1):
            if len(row) != len(head):
                raise damaged(path, f"row {number} has {len(row)} cells, the head {len(head)}")
            if number > _MAX_ROWS:
                raise damaged(path, f"more than {_MAX_ROWS:,} rows")
            yield dict(zip(head, row, strict=True))
    except csv.Error as error:
        raise damaged(path, f"not a CSV file after row {number}: {error}") from error


def read_table(path: Path | str, kind: type[T], infinite: Collection[str] = ()) -> Iterator[T]:
    """Read a CSV file with a record per row; yield the records.

    `kind` is their NamedTuple: columns of fields that have defaults may be missing. The `infinite`
    columns may hold infinite numbers. Raises InputError as `read_rows`, with row and column.
    """
    hints = get_type_hints(kind)
    optional: Collection[str] = getattr(kind, "_field_defaults")  # noqa: B009
    for number, row in enumerate(read_rows(path), start=1):
        unlike = [name for name in row if name not in hints]
        unlike += [name for name in hints if name not in row and name not in optional]
        if unlike:
            raise damaged(path, f"columns {', '.join(row)}: {unlike[0]} is missing or unknown")
        cells = {}
        for name, text in row.items():
            try:
                cells[name] = parse_cell(text, hints[name], name in infinite)
            except ValueError as error:
                raise damaged(path, f"row {number}, {name}: {error}") from error
        yield kind(**cells)


def parse_cell(text: str, kind: type, infinite: bool = False) -> Any:
    """Turn a cell into an int, a float (finite, or not NaN), a bool or a str, or ValueError."""
    if kind is str:
        return text
    try:
        if len(text) > _MAX_DIGITS:
            raise ValueError
        value = _TRUTH[text] if kind is bool else kind(text)
    except (ValueError, KeyError):
        raise ValueError(f"{text[:_MAX_DIGITS]!r} is not {_TYPE_NAMES[kind]}") from None
    if kind is float and not (math.isfinite(value) or (infinite and not math.isnan(value))):
        raise ValueError(f"{text} is no finite number")
    if kind is int and abs(value) >= 2**63:
        raise ValueError(f"{text} is too large")
    return value
