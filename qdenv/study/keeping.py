"""Drawings of what must stay, from files: read beside a plan or without one."""

from pathlib import Path

import numpy as np

from qdenv.domains.base import Domain
from qdenv.domains.keep import FREE, SAME, check_shape
from qdenv.io.layouts import BLANKS, aliases, alphabet, read_drawing, respell
from qdenv.repair.rules import impossible
from qdenv.types import InputError


def keep_from(path: str | Path, domain: Domain, layout: np.ndarray | None = None) -> Domain:
    """Read which cells must stay, and demand it of a domain.

    Args:
        path: a drawing of the layout's shape in any format of layout files. ``?`` is free to
            change, ``!`` stays as the plan has it, a tile stays this tile.
        domain: at the layout's size.
        layout: the plan int8 [H, W]; None where there is none.

    Raises:
        InputError: the file is no such drawing, asks for what the plan does not hold, or for what
            no layout can be.
    """
    rows = _read(path, domain)
    try:
        kept = domain.keeping(_resolve(rows, domain, layout))
        reason = None if kept.rules is None else impossible(kept.rules())
    except InputError as error:
        raise InputError(f"{path}: {error}") from error
    if reason:
        raise InputError(f"{path}: nothing can be built around what is kept: {reason}")
    return kept


def _read(path: str | Path, domain: Domain) -> list[str]:
    """Read a drawing, each tile by its own symbol; blanks are no second way to draw a tile."""
    known = aliases(domain.tiles, domain.meanings)
    table = {one: symbol for one, symbol in known.items() if one not in BLANKS + FREE + SAME}
    return respell(read_drawing(path).rows, table)


def _resolve(rows: list[str], domain: Domain, layout: np.ndarray | None) -> tuple[str, ...]:
    """Name the tile of every cell that stays."""
    check_shape(rows, domain.shape)
    return tuple(
        "".join(_resolve_cell(symbol, row, col, domain, layout) for col, symbol in enumerate(drawn))
        for row, drawn in enumerate(rows)
    )


def _resolve_cell(
    symbol: str, row: int, col: int, domain: Domain, layout: np.ndarray | None
) -> str:
    """Name the tile of a cell that stays, `FREE` of one that may change."""
    if symbol not in FREE + SAME + domain.tiles:
        raise InputError(
            f"row {row}, column {col}: {symbol!r} is no tile of {domain.name}: draw {FREE!r} where "
            f"anything may be, {SAME!r} for what the plan holds, or one of "
            f"{alphabet(domain.tiles, domain.meanings)}"
        )
    if symbol == SAME and layout is None:
        raise InputError(
            f"row {row}, column {col}: {SAME!r} keeps what a plan holds, and there is no plan "
            "here: draw the tile itself"
        )
    if symbol == FREE or layout is None:
        return symbol
    held = domain.tiles[layout[row, col]]
    if symbol not in (SAME, held):
        raise InputError(
            f"row {row}, column {col}: {symbol!r} is to stay, but the plan holds {held!r} there: "
            f"change one of the two, or draw {FREE!r}"
        )
    return held
