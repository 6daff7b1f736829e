"""How wide a picture is: a column or a page of a journal, or a number of inches."""

from qdenv.types import InputError

COLUMN, PAGE = 3.5, 7.2  # inches, as journals of two columns have them
SCREEN = 10.0  # inches of several floor plans side by side, unless a width is given
_NAMES = {"column": COLUMN, "page": PAGE}
NARROWEST, WIDEST = 2.0, 40.0  # inches


def parse_width(text: str) -> float:
    """Read a width in words: "column", "page" or a number of inches.

    Raises:
        InputError: it is none of the three, or nothing could be read at that width.
    """
    try:
        inches = _NAMES.get(text) or float(text)
    except ValueError:
        inches = 0.0
    if not NARROWEST <= inches <= WIDEST:
        raise InputError(
            f"width {text!r}: write column ({COLUMN} inches), page ({PAGE}), or a number of "
            f"inches from {NARROWEST:g} to {WIDEST:g}"
        )
    return inches
