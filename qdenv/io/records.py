"""JSON and CSV of limited size, as records: fields have their types, defaults may be missing."""

import csv
import dataclasses
import json
import math
import re
from collections import Counter
from collections.abc import Iterator, Mapping
from functools import lru_cache
from pathlib import Path
from types import MappingProxyType, NoneType, UnionType
from typing import Any, Literal, TypeVar, Union, get_args, get_origin, get_type_hints

from qdenv.io.files import MEGABYTE, damaged, read_text
from qdenv.registry import Registry
from qdenv.types import InputError

_MAX_BYTES = 32 * MEGABYTE  # of a file
_MAX_DEPTH = 40  # nested brackets
_MAX_VALUES = 1_000_000
_MAX_DIGITS = 40  # of a whole number, characters of a cell
_MAX_COLUMNS, _MAX_ROWS = 1000, 2_000_000  # of a table, far beyond what a run writes
_MAX_SHOWN = 40  # characters of a wrong value in a message
_INT_LIMIT = 2**63  # what an array can hold
# Possessive quantifiers: without them the engine stores a state for every escaped character, which
# took 1.7 GB for a string of 31 MB.
_TOKEN = re.compile(r'[][{},]|"[^"\\]*+(?:\\.[^"\\]*+)*+"?', re.DOTALL)
_TYPE_NAMES = {
    int: "a whole number",
    float: "a number",
    str: "a word",
    bool: "true or false",
    NoneType: "null",
}
# Fields that hold the settings of a registered choice, wherever a field of this name stands.
Choices = Mapping[str, Registry]
_NO_CHOICES: Choices = MappingProxyType({})
T = TypeVar("T")
Row = TypeVar("Row", bound=tuple)


def read_json(path: Path | str, kind: type[T]) -> T:
    """Read a JSON file as a record of type `kind`, see `structured`.

    Raises InputError, which names the file and the field, if it cannot be read, or is damaged.
    """
    return structured(parse_json(read_text(path, _MAX_BYTES, "JSON"), path), kind, path)


def parse_json(text: str, source: Path | str, most: int = _MAX_VALUES) -> Any:
    """Parse JSON of limited depth and `most` values; numbers are finite or infinite, never NaN.

    Raises DamagedError, which names `source`, if the text is not JSON, or beyond the limits.
    """

    def parse_int(digits: str) -> int:
        if len(digits) > _MAX_DIGITS:  # converting digits takes quadratic time
            raise ValueError(f"a number of {len(digits)} digits")
        return int(digits)

    def parse_constant(name: str) -> float:
        if name == "NaN":
            raise ValueError("NaN is not allowed")
        return float(name)

    def parse_object(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
        content = dict(pairs)
        if len(content) < len(pairs):
            ((twice, _),) = Counter(name for name, _ in pairs).most_common(1)
            raise ValueError(f"{twice!r} is there twice")
        return content

    # Before the parser runs, which allocates for every bracket.
    depth = values = 0
    for token in _TOKEN.finditer(text):
        first = text[token.start()]
        if first == '"':
            continue
        values += first in "[{,"
        depth += (first in "[{") - (first in "]}")
        if depth > _MAX_DEPTH or values > most:
            what = f"more than {most:,} values" if values > most else "too deep"
            raise damaged(source, f"not a JSON file of ours: {what}")
    try:
        return json.loads(
            text, parse_int=parse_int, parse_constant=parse_constant, object_pairs_hook=parse_object
        )
    except ValueError as error:
        raise damaged(source, f"not a JSON file: {error}") from error


def structured(
    content: Any,
    kind: type[T],
    source: Path | str,
    infinite: bool = False,
    choices: Choices = _NO_CHOICES,
) -> T:
    """Turn parsed JSON into a record, strictly: only whole numbers become fractions.

    Dataclasses refuse unknown fields, NamedTuples ignore them. The type of a field of `choices` is
    that of the choice registered under its ``name``. Raises DamagedError, which names the `source`
    and the field that is missing, unknown or of the wrong type, like ``domain.rows: must be a whole
    number, not "many"``; or a fraction that is infinite, unless these are allowed.
    """
    try:
        return _Reader(infinite, choices).read(content, kind, "")
    except InputError as error:
        raise damaged(source, error) from error


def unstructured(record: Any, choices: Choices) -> Any:
    """Turn a dataclass of dataclasses, tuples and plain values into what `structured` reads."""
    if not dataclasses.is_dataclass(record):
        return record
    content = {}
    for field in dataclasses.fields(record):
        value = getattr(record, field.name)
        content[field.name] = unstructured(value, choices)
        if field.name in choices:
            name = choices[field.name].name_of(value)
            content[field.name] = {"name": name} | content[field.name]
    return content


class _Reader:
    """Reads values of a type; `place` is where in the file they stand."""

    def __init__(self, infinite: bool, choices: Choices) -> None:
        self.infinite, self.choices = infinite, choices

    def read(self, value: Any, kind: Any, place: str) -> Any:
        origin, parts = get_origin(kind), get_args(kind)
        if kind is Any:
            return value
        if dataclasses.is_dataclass(kind) or hasattr(kind, "_fields"):
            return self.read_record(value, kind, place)
        if origin is dict or origin is Mapping:
            content = _demand(value, dict, place)
            return {k: self.read(one, parts[1], f"{place}[{k!r}]") for k, one in content.items()}
        if origin is list or origin is tuple:
            items = _demand(value, list, place)
            same = origin is list or parts[-1] is Ellipsis
            if not same and len(items) != len(parts):
                raise _wrong(place, f"must be {len(parts)} values, not {len(items)}")
            kinds = [parts[0]] * len(items) if same else parts
            pairs = enumerate(zip(items, kinds, strict=True))
            return origin(self.read(one, part, f"{place}[{i}]") for i, (one, part) in pairs)
        return self.read_plain(value, _plain_kinds(kind), place)

    def read_record(self, value: Any, kind: Any, place: str) -> Any:
        content = _demand(value, dict, place)
        hints, optional = _fields_of(kind)
        record = {}
        for name, hint in hints.items():
            inside = f"{place}.{name}".lstrip(".")
            if name not in content:
                if name not in optional:
                    raise _wrong(inside, "is missing")
            elif name in self.choices:
                settings = dict(_demand(content[name], dict, inside))
                chosen = settings.pop("name", None)
                if not isinstance(chosen, str):
                    raise _wrong(inside, "name must be a word")
                record[name] = self.read(settings, self.choices[name].entry(chosen).config, inside)
            else:
                record[name] = self.read(content[name], hint, inside)
        unknown = sorted(content.keys() - hints)
        if unknown and dataclasses.is_dataclass(kind):
            raise _wrong(place, f"has no setting {', '.join(map(repr, unknown))}")
        try:
            return kind(**record)
        except InputError as error:  # a range that the record itself checks
            raise _wrong(place, error) from error

    def read_plain(self, value: Any, kinds: tuple[type, ...], place: str) -> Any:
        kind = type(value)
        numeric = int in kinds or float in kinds
        if kind is int and numeric and not -_INT_LIMIT <= value < _INT_LIMIT:
            raise _wrong(place, f"must be a number that fits into 64 bits, not {_shown(value)}")
        if kind is int and int not in kinds and float in kinds:
            return float(value)
        if kind is float and float in kinds and not (self.infinite or math.isfinite(value)):
            raise _wrong(place, f"must be a finite number, not {_shown(value)}")
        if kind not in kinds:
            names = " or ".join(name for one, name in _TYPE_NAMES.items() if one in kinds)
            if kinds == (float,) and not self.infinite:
                names = "a finite number"
            raise _wrong(place, f"must be {names}, not {_shown(value)}")
        return value


@lru_cache(maxsize=256)
def _fields_of(kind: Any) -> tuple[dict[str, Any], frozenset[str]]:
    """Return the types of a record's fields, and the names of those that have defaults."""
    hints = get_type_hints(kind)
    if not dataclasses.is_dataclass(kind):
        return hints, frozenset(kind._field_defaults)
    missing = dataclasses.MISSING
    fields = [field for field in dataclasses.fields(kind) if field.init]
    optional = [f.name for f in fields if (f.default, f.default_factory) != (missing, missing)]
    return {field.name: hints[field.name] for field in fields}, frozenset(optional)


def _plain_kinds(kind: Any) -> tuple[type, ...]:
    """List the types that an int, a union or a Literal allows."""
    # Of a Literal the type is checked, not the value: it may name what a user has registered.
    if get_origin(kind) is Literal:
        return tuple({type(value) for value in get_args(kind)})
    if get_origin(kind) in (Union, UnionType):
        return tuple(one for part in get_args(kind) for one in _plain_kinds(part))
    return (kind,)


def _demand(value: Any, form: type[dict] | type[list], place: str) -> Any:
    if not isinstance(value, dict if form is dict else (list, tuple)):  # a string is not a list
        name = "an object" if form is dict else "a list"
        raise _wrong(place, f"must be {name}, not {_shown(value)}")
    return value


def _wrong(place: str, reason: object) -> InputError:
    return InputError(f"{place}: {reason}" if place else str(reason))


def _shown(value: Any) -> str:
    text = json.dumps(value, default=str)
    return text if len(text) <= _MAX_SHOWN else f"{text[:_MAX_SHOWN]}..."


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


def read_table(path: Path | str, kind: type[Row]) -> Iterator[Row]:
    """Read a CSV file with a record per row; yield the records.

    `kind` is their NamedTuple: columns of fields that have defaults may be missing. Raises
    InputError as `read_rows`, with row and column.
    """
    hints, optional = _fields_of(kind)
    for number, row in enumerate(read_rows(path), start=1):
        unlike = [name for name in row if name not in hints]
        unlike += [name for name in hints if name not in row and name not in optional]
        if unlike:
            raise damaged(path, f"columns {', '.join(row)}: {unlike[0]} is missing or unknown")
        cells = {}
        for name, text in row.items():
            try:
                cells[name] = parse_cell(text, hints[name])
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
        value = {"True": True, "False": False}[text] if kind is bool else kind(text)
    except (ValueError, KeyError):
        names = _TYPE_NAMES | {bool: "True or False"}
        raise ValueError(f"{text[:_MAX_DIGITS]!r} is not {names[kind]}") from None
    if kind is float and not (math.isfinite(value) or (infinite and not math.isnan(value))):
        raise ValueError(f"{text} is not a finite number")
    if kind is int and abs(value) >= _INT_LIMIT:
        raise ValueError(f"{text} is too large")
    return value
