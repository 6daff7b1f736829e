"""What must stay of a plan: tiles, rectangles and drawings, which become one drawing."""

from collections.abc import Iterable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np

from qdenv.domains.base import FREE, SAME, Domain, check_shape, make_domain
from qdenv.grid import rectangle
from qdenv.io.formats import READ_ENDINGS
from qdenv.io.layouts import BLANKS, aliases, alphabet, read_drawing
from qdenv.repairs.rules import impossible
from qdenv.types import InputError, about

# One part, several joined by "+", or a list of these; see `keep_from`.
Keep: TypeAlias = str | Path | Sequence[str | Path]


def keep_from(
    keep: Keep, domain: Domain, layout: np.ndarray | None = None, folder: Path = Path()
) -> Domain:
    """Demand of a domain at a plan's size that cells stay as the plan (int8 [H, W], or None) is.

    Each part of `keep` is one of three: tiles, all of whose cells stay (``w#``); a rectangle of
    rows and columns, the last ones not included (``0:7,33:40``); or the file of a drawing of the
    plan's shape in any format of layouts, where ``?`` is free to change, ``!`` stays as the plan
    has it, and a tile stays this tile. A drawing decides about every cell, tiles and rectangles add
    to it, or to what stays already. Names of files are relative to `folder`. Raises InputError if a
    part is none of the three, names what the plan does not hold, or no layout can be like this.
    """
    rows, cols = domain.shape
    cells = np.array([list(row) for row in domain.config.keep or [FREE * cols] * rows])
    symbols = None if layout is None else np.array(list(domain.tiles), object)[layout]
    parts = list(_split(keep, domain, folder))
    # Drawings first: they would free what others keep.
    for part in sorted(parts, key=lambda part: not isinstance(part, Path)):
        if isinstance(part, Path):
            with about(str(part)):
                cells = _read_cells(part, domain, symbols)
            continue
        if symbols is None:
            raise InputError(f"keep {part}: there is no plan here to keep it of: give --plan FILE")
        if found := rectangle(part, symbols.shape):
            cells[found] = symbols[found]
            continue
        inside = np.isin(symbols, list(part))
        if not inside.any():
            raise InputError(f"keep {part}: the plan of {rows} x {cols} has no such cell")
        cells = np.where(inside, symbols, cells)
    with about("keep" if len(parts) > 1 else str(parts[0])):
        kept = make_domain(replace(domain.config, keep=tuple(map("".join, cells))))
        reason = None if kept.rules is None else impossible(kept.rules())
        if reason:
            raise InputError(f"no layout obeys the rules with these cells kept: {reason}")
    return kept


def _split(keep: Keep, domain: Domain, folder: Path) -> Iterable[str | Path]:
    """Split what must stay into its parts: drawings become paths, the others stay text."""
    for one in [keep] if isinstance(keep, str | Path) else keep:
        whole = isinstance(one, Path) and (folder / one).exists()
        for part in [str(one)] if whole else str(one).split("+"):
            tiles = bool(part) and set(part) <= set(domain.tiles)
            if tiles or rectangle(part, domain.shape):
                yield part
            elif Path(part).suffix.lower() in READ_ENDINGS or (part and (folder / part).exists()):
                yield folder / part
            else:
                raise InputError(
                    f"keep {part!r}: give tiles like w#, rows and columns like 0:7,33:40, or the "
                    "file of a drawing; + joins several"
                )


def _read_cells(path: Path, domain: Domain, symbols: np.ndarray | None) -> np.ndarray:
    """Read a drawing of what must stay: a tile or `FREE` for each cell ([H, W])."""
    # Blanks are no second symbol of floor in such a drawing; they may be the outside.
    known: dict[str, Any] = aliases(domain.tiles, domain.meanings)
    own = {
        one: tile
        for one, tile in known.items()
        if one not in FREE + SAME and not {one, tile} <= set(BLANKS)
    }
    rows = read_drawing(path).rows
    if " " in own:
        rows = [row.ljust(domain.shape[1]) for row in rows]
    rows = [row.translate(str.maketrans(own)) for row in rows]
    check_shape(rows, domain.shape)
    drawn = np.array([list(row) for row in rows], object)
    for row, column in np.argwhere(~np.isin(drawn, list(FREE + SAME + domain.tiles))):
        raise InputError(
            f"row {row}, column {column}: {drawn[row, column]!r} is no tile of {domain.name}: draw "
            f"{FREE!r} where anything may be, {SAME!r} for what the plan holds, or one of "
            f"{alphabet(domain.tiles, domain.meanings)}"
        )
    if symbols is None:
        for row, column in np.argwhere(drawn == SAME):
            raise InputError(
                f"row {row}, column {column}: {SAME!r} stands for the plan's tile, and no "
                "plan is given: add --plan FILE, or draw the tile itself"
            )
        return drawn
    for row, column in np.argwhere((drawn != FREE) & (drawn != SAME) & (drawn != symbols)):
        raise InputError(
            f"row {row}, column {column}: {drawn[row, column]!r} is to stay, but the plan holds "
            f"{symbols[row, column]!r} there: change one of the two, or draw {FREE!r}"
        )
    return np.where(drawn == SAME, symbols, drawn)
