"""Types with ranges: what a setting may be is stated where it is declared, and checked in one way.

A record whose fields have such types derives from `Ranged`, which checks them wherever its values
come from: a command line, a file, Python.
"""

import math
import operator
import re
from collections.abc import Iterator
from functools import cache
from numbers import Integral, Real
from typing import Annotated, Any, Literal, get_args, get_origin, get_type_hints

from annotated_types import Interval

from qdenv.types import InputError, choices

MOST = 2**31 - 1  # what is counted in 32 bits
LARGEST_SEED = 2**32 - 1
_MOST_BITS = 1000
_LIMITS = (
    ("ge", operator.ge, "at least"),
    ("gt", operator.gt, "above"),
    ("le", operator.le, "at most"),
    ("lt", operator.lt, "below"),
)

PositiveInt = Annotated[int, Interval(ge=1, le=MOST)]
NonNegativeInt = Annotated[int, Interval(ge=0, le=MOST)]
FiniteFloat = Annotated[float, Interval(gt=-math.inf, lt=math.inf)]
PositiveFloat = Annotated[float, Interval(gt=0, lt=math.inf)]
NonNegativeFloat = Annotated[float, Interval(ge=0, lt=math.inf)]
Stay = Annotated[int, Interval(ge=0, le=1000)]  # timesteps, as many as all planners understand
TaskRate = Annotated[float, Interval(ge=0, le=500)]  # tasks per timestep
Share = Annotated[float, Interval(ge=0, le=1)]
Seed = Annotated[int, Interval(ge=0, le=LARGEST_SEED)]
_type_hints = cache(get_type_hints)
# Marks a `Literal` to whose names a user may add: nothing is checked here.
OPEN = "open"


class Ranged:
    """A record that refuses values outside the ranges of its fields, and unknown names."""

    def __post_init__(self) -> None:
        """Raise InputError, which names the field, if a value is none of those it may have."""
        record: Any = type(self)
        for name, kind in _type_hints(record, include_extras=True).items():
            value = getattr(self, name, None)  # None: a class variable without a value
            if _has_range(kind):
                check_range(name, value, kind)
            elif get_origin(kind) is Literal and value not in get_args(kind):
                listed = choices(str(value), get_args(kind))
                raise InputError(f"unknown {name.replace('_', ' ')} {value!r}: {listed}")


def check_range(name: str, value: Any, kind: Any) -> None:
    """Raise InputError if a number, or one of a tuple, is none of those its `Interval` allows."""
    label = name.replace("_", "-")
    for number, base, interval in _pairs(value, kind):
        if isinstance(number, bool) or not isinstance(number, Real):
            raise InputError(f"{label} must be a number, not {number!r}")
        if base is int and not isinstance(number, Integral):
            raise InputError(f"{label} must be an integer, not {number}")
        if isinstance(number, int) and number.bit_length() > _MOST_BITS:  # a float may not hold it
            raise InputError(f"{label} must have at most {_MOST_BITS} bits")
        for bound, holds, phrase in _LIMITS:
            limit = getattr(interval, bound)
            if limit is not None and not holds(number, limit):
                expected = f"{phrase} {limit}" if math.isfinite(number) else "a finite number"
                raise InputError(f"{label} must be {expected}, not {number}")


def read_range(name: str, value: Any) -> tuple[int, int]:
    """Return the fewest and the most that 1100, or "1000:1200", allows; InputError for others."""
    numbers = re.fullmatch(r"(-?\d{1,9})(?::(\d{1,9}))?", str(value), re.ASCII)
    low, high = (int(numbers[1]), int(numbers[2] or numbers[1])) if numbers else (0, -1)
    if low > high:
        form = "a range from few to many like 1000:1200"
        raise InputError(f"{name} {value!r}: write 1100, or {form}")
    if low < 0:
        raise InputError(f"{value} {name}: give 0 or more")
    return low, high


def _has_range(kind: Any) -> bool:
    return isinstance(kind, Interval) or any(
        _has_range(part) for part in get_args(kind) if get_origin(kind) is not Literal
    )


def _pairs(value: Any, kind: Any) -> Iterator[tuple[Any, Any, Interval]]:
    """List each number in a value with its type and the range that this states."""
    parts = get_args(kind)
    if get_origin(kind) is Annotated:
        ranges = [part for part in parts if isinstance(part, Interval)]
        yield from ((value, parts[0], one) for one in ranges)
        if not ranges:
            yield from _pairs(value, parts[0])
    elif get_origin(kind) is tuple:
        kinds = [parts[0]] * len(value) if parts[-1] is Ellipsis else parts
        for one, its_kind in zip(value, kinds, strict=False):
            yield from _pairs(one, its_kind)
    elif value is not None and not (
        isinstance(value, str) and any(one is str or get_origin(one) is Literal for one in parts)
    ):
        # One of several types: at most one of ours has a range.
        yield from (pair for part in parts if _has_range(part) for pair in _pairs(value, part))
