"""Records from what JSON said: every field is there, known, and of its own type."""

import dataclasses
import json
import math
from collections.abc import Callable, Mapping
from functools import cache
from pathlib import Path
from types import GenericAlias, NoneType, UnionType
from typing import Any, Literal, TypeVar, Union, get_args, get_origin

import cattrs
from cattrs.cols import is_namedtuple, namedtuple_dict_structure_factory
from cattrs.gen import make_dict_structure_fn

from qdenv.reading.files import damaged
from qdenv.types import InputError

SHOWN = 3  # reasons in a message
LONGEST_SHOWN = 40  # characters of a wrong value
LARGEST = 2**63  # of a whole number: what an array can hold
WORDS = {
    int: "a whole number",
    float: "a number",
    str: "a word",
    bool: "true or false",
    NoneType: "null",
}
T = TypeVar("T")
Hook = Callable[[Any, Any], Any]


def structured(
    content: Any, kind: type[T], source: Path | str, converter: cattrs.Converter | None = None
) -> T:
    """Turn what JSON said into a record, strictly.

    Args:
        content: as parsed.
        kind: of the record.
        source: for the message.
        converter: another one than that of `strict_converter`.

    Raises:
        DamagedError: a field is missing, unknown or of the wrong type; the line names it.
    """
    try:
        return (converter or _plain_converter()).structure(content, kind)
    except (cattrs.BaseValidationError, InputError) as error:
        raise damaged(source, _reasons(error)) from error


@cache
def _plain_converter() -> cattrs.Converter:
    return strict_converter()


def strict_converter(infinite: bool = False) -> cattrs.Converter:
    """Make a converter that changes no value's type but whole numbers to fractions.

    Records that are dataclasses refuse fields they do not have; NamedTuples pass them over.

    Args:
        infinite: whether fractions may be infinite.
    """
    converter = cattrs.Converter(forbid_extra_keys=True)
    for kind in (int, str, bool):
        converter.register_structure_hook(kind, _exactly(kind))
    converter.register_structure_hook(float, lambda value, _: _number(value, infinite))
    converter.register_structure_hook_factory(dataclasses.is_dataclass, _dataclass)
    converter.register_structure_hook_factory(is_namedtuple, _record)
    converter.register_structure_hook_func(_is_choice, _choice)
    converter.register_structure_hook_factory(lambda kind: get_origin(kind) is list, _list)
    converter.register_structure_hook_factory(lambda kind: get_origin(kind) is tuple, _tuple)
    converter.register_structure_hook_factory(
        lambda kind: get_origin(kind) in (dict, Mapping), _mapping
    )
    return converter


def demand(value: Any, form: type[dict] | type[list]) -> Any:
    """Refuse what is no object (`dict`) or no `list`: a word is no list of letters.

    Raises:
        InputError: it is another thing.
    """
    if not isinstance(value, dict if form is dict else (list, tuple)):
        what = "an object" if form is dict else "a list"
        raise InputError(f"must be {what}, not {_shown(value)}")
    return value


def _exactly(kind: type) -> Hook:
    def check(value: Any, _: Any) -> Any:
        if type(value) is not kind:
            raise InputError(f"must be {WORDS[kind]}, not {_shown(value)}")
        if isinstance(value, int) and not -LARGEST <= value < LARGEST:
            raise InputError(f"must be a number that fits into 64 bits, not {_shown(value)}")
        return value

    return check


def _number(value: Any, infinite: bool) -> float:
    fits = type(value) is float or (type(value) is int and abs(value) < LARGEST)
    if not fits or not (infinite or math.isfinite(value)):
        raise InputError(f"must be a {'' if infinite else 'finite '}number, not {_shown(value)}")
    return float(value)


def _shown(value: Any) -> str:
    text = json.dumps(value, default=str)
    return text if len(text) <= LONGEST_SHOWN else f"{text[:LONGEST_SHOWN]}..."


def _dataclass(kind: Any, converter: cattrs.Converter) -> Hook:
    fill: Hook = make_dict_structure_fn(kind, converter, _cattrs_forbid_extra_keys=True)
    return lambda value, _: fill(demand(value, dict), kind)


def _record(kind: Any, converter: cattrs.Converter) -> Hook:
    fill = namedtuple_dict_structure_factory(kind, converter)
    return lambda value, _: fill(demand(value, dict), kind)


def _is_choice(kind: Any) -> bool:
    return get_origin(kind) in (Union, UnionType, Literal)


def _choice(value: Any, kind: Any) -> Any:
    """Check the type of a value, not the word: it may name what a user has registered."""
    kinds = _kinds_in(kind)
    as_number = float in kinds and type(value) is int
    if as_number or type(value) not in kinds:
        if as_number:
            return _number(value, infinite=False)
        words = " or ".join(word for one, word in WORDS.items() if one in kinds)
        raise InputError(f"must be {words}, not {_shown(value)}")
    return value


def _kinds_in(kind: Any) -> set[type]:
    """List the types that a choice allows: those of its words, or those it unites."""
    if get_origin(kind) is Literal:
        return {type(word) for word in get_args(kind)}
    parts = get_args(kind)
    return {one for part in parts for one in (_kinds_in(part) if get_args(part) else {part})}


def _list(kind: Any, converter: cattrs.Converter) -> Hook:
    (part,) = get_args(kind)
    hook = converter.get_structure_hook(part)
    return lambda value, _: [
        _inside(hook, one, part, place) for place, one in enumerate(demand(value, list))
    ]


def _tuple(kind: Any, converter: cattrs.Converter) -> Hook:
    parts = get_args(kind)
    if parts[-1] is Ellipsis:
        as_list = _list(GenericAlias(list, parts[:1]), converter)
        return lambda value, _: tuple(as_list(value, kind))
    hooks = [converter.get_structure_hook(part) for part in parts]

    def structure(value: Any, _: Any) -> tuple:
        if len(demand(value, list)) != len(parts):
            raise InputError(f"must be {len(parts)} values, not {len(value)}")
        pairs = zip(hooks, value, parts, strict=True)
        return tuple(_inside(*three, place) for place, three in enumerate(pairs))

    return structure


def _mapping(kind: Any, converter: cattrs.Converter) -> Hook:
    _, part = get_args(kind)
    if part is Any:
        return lambda value, _: demand(value, dict)
    hook = converter.get_structure_hook(part)
    return lambda value, _: {
        name: _inside(hook, one, part, name) for name, one in demand(value, dict).items()
    }


def _inside(hook: Hook, value: Any, kind: Any, place: int | str) -> Any:
    """Structure a part of a list or an object; the first that is wrong says where it is."""
    try:
        return hook(value, kind)
    except (cattrs.BaseValidationError, InputError) as error:
        note = cattrs.IterableValidationNote(f"at {place}", place, kind)
        error.__notes__ = [*getattr(error, "__notes__", []), note]
        raise cattrs.IterableValidationError(f"at {place}", [error], kind) from error


def _reasons(error: Exception) -> str:
    """Say where it is wrong and why, like ``domain.rows: must be a whole number, not "many"``."""
    said = cattrs.transform_error(error, path="", format_exception=_reason)
    pairs = [reason.rpartition(" @ ") for reason in said[:SHOWN]]
    return "; ".join(f"{where.lstrip('.')}: {what}".lstrip(": ") for what, _, where in pairs)


def _reason(error: BaseException, _: type | None) -> str:
    if isinstance(error, cattrs.ForbiddenExtraKeysError):
        return f"has no setting {', '.join(map(repr, sorted(error.extra_fields)))}"
    return "is missing" if isinstance(error, KeyError) else str(error)
