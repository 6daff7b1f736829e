"""Pictures, films and pages, from saved results only; this file imports no matplotlib."""

from qdenv.types import InputError

COLUMN, PAGE = 3.5, 7.2  # inches, as journals of two columns have them
SCREEN = 10.0  # inches of several floor plans side by side, unless a width is given
_NARROWEST, _WIDEST = 2.0, 40.0  # inches


def parse_width(width: str | float) -> float:
    """Read a picture's width in inches: "column", "page" or a number of inches.

    Raises InputError if it is none of the three, or nothing could be read at that width.
    """
    try:
        inches = {"column": COLUMN, "page": PAGE}.get(str(width)) or float(width)
    except (TypeError, ValueError):
        inches = 0.0
    if not _NARROWEST <= inches <= _WIDEST:
        sizes = f"page ({PAGE}), or a number of inches from {_NARROWEST:g} to {_WIDEST:g}"
        raise InputError(f"width {width!r}: write column ({COLUMN} inches), {sizes}")
    return inches
