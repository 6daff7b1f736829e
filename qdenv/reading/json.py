"""JSON: limits before parsing, then every field against a record type."""

import json
import re
from pathlib import Path
from typing import Any, TypeVar

from qdenv.reading.files import MEGABYTE, damaged, read_text
from qdenv.reading.strict import structured

LARGEST = 32 * MEGABYTE
DEEPEST = 40  # brackets in brackets
MOST_VALUES = 1_000_000
LONGEST_NUMBER = 40  # characters
TOKEN = re.compile(r'[][{},]|"[^"\\]*(?:\\.[^"\\]*)*"?', re.DOTALL)
T = TypeVar("T")


def read_json(path: Path | str, kind: type[T], most: int = LARGEST) -> T:
    """Read a JSON file.

    Args:
        path: the file.
        kind: what it must hold: a NamedTuple (other fields are passed over) or ``dict[str, Any]``.
        most: bytes of the file.

    Raises:
        InputError: it cannot be read, or is damaged; the line names the file and the field.
    """
    return structured(parse_json(read_text(path, most, "JSON"), path), kind, path)


def parse_json(text: str, source: Path | str) -> Any:
    """Parse JSON of limited depth and size; numbers are finite or infinite, never NaN.

    Raises:
        DamagedError: it is none, or beyond the limits; the line names `source`.
    """
    check_limits(text, source)
    try:
        return json.loads(text, parse_int=_int, parse_constant=_constant, object_pairs_hook=_object)
    except ValueError as error:
        raise damaged(source, f"not a JSON file: {error}") from error


def check_limits(text: str, source: Path | str) -> None:
    """Refuse JSON that is nested too deeply or holds too many values, before it is parsed.

    Raises:
        DamagedError: it is.
    """
    depth = values = 0
    for token in TOKEN.finditer(text):
        first = text[token.start()]
        if first == '"':
            continue
        values += first in "[{,"
        depth += (first in "[{") - (first in "]}")
        if depth > DEEPEST or values > MOST_VALUES:
            what = f"more than {MOST_VALUES:,} values" if values > MOST_VALUES else "too deep"
            raise damaged(source, f"not a JSON file of ours: {what}")


def _int(text: str) -> int:
    if len(text) > LONGEST_NUMBER:
        raise ValueError(f"a number of {len(text)} digits")
    return int(text)


def _constant(text: str) -> float:
    if text == "NaN":
        raise ValueError("NaN is no number")
    return float(text)


def _object(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    content = dict(pairs)
    if len(content) < len(pairs):
        names = [name for name, _ in pairs]
        twice = next(name for name in content if names.count(name) > 1)
        raise ValueError(f"{twice!r} is there twice")
    return content
