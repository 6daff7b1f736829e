"""Layout files: drawings that hold nothing but tiles of an alphabet.

JSON has the shape of the layouts published with the paper, an object with a list of equally long
rows under "layout", so those read as they are; other keys are ignored on reading. Headers that
contradict the rows lose: the rows are what is simulated. Text, CSV and MovingAI's maps hold the
rows alone.
"""

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np

from qdenv.files import write_atomically
from qdenv.formats.drawings import ENDINGS, check_size, read_drawing
from qdenv.grid import draw, parse
from qdenv.types import Array, InputError, Tile

NO_MEANINGS: Mapping[str, Tile] = MappingProxyType({})
BLANKS = " ."  # empty cells, drawn either way


def read_layout(
    path: str | Path, tiles: str, meanings: Mapping[str, Tile] = NO_MEANINGS
) -> np.ndarray:
    """Read a layout.

    Args:
        path: a .json, .txt, .csv or .map file.
        tiles: the domain's alphabet.
        meanings: what its symbols mean, and what else draws them.

    Returns:
        int8 [H, W].

    Raises:
        InputError: the file is missing, too big, or holds no proper layout.
    """
    return to_layout(read_drawing(path).rows, path, tiles, meanings)


def to_layout(
    rows: Sequence[str],
    path: str | Path,
    tiles: str,
    meanings: Mapping[str, Tile] = NO_MEANINGS,
    whose: str = "this domain",
) -> np.ndarray:
    """Turn the rows of a file into a layout.

    Args:
        rows: as drawn.
        path: the file, for messages.
        tiles: the alphabet.
        meanings: what its symbols mean, and what else draws them.
        whose: name of the domain, for messages.

    Returns:
        int8 [H, W].

    Raises:
        InputError: the drawing is empty or ragged, or holds a symbol that means nothing.
    """
    drawn = respell(rows, aliases(tiles, meanings))
    for index, row in enumerate(drawn):
        if strange := row.translate(dict.fromkeys(map(ord, tiles))):
            column = row.index(strange[0])
            raise InputError(
                f"{path}: unknown tile {strange[0]!r} at row {index}, column {column}: "
                f"{whose} knows {alphabet(tiles, meanings)}"
            )
    try:
        return parse(drawn, tiles)
    except InputError as error:
        raise InputError(f"{path}: {error}") from error


def alphabet(tiles: str, meanings: Mapping[str, Tile] = NO_MEANINGS) -> str:
    """List the symbols of an alphabet with what they mean, in a line."""
    names = {symbol: f" {tile.name}" for symbol, tile in meanings.items()}
    return ", ".join(f"{symbol!r}{names.get(symbol, '')}" for symbol in tiles)


def aliases(tiles: str, meanings: Mapping[str, Tile] = NO_MEANINGS) -> dict[str, str]:
    """List what else may be drawn for which symbol: ``#`` for a wall, a blank for a dot."""
    known = {other: symbol for symbol, tile in meanings.items() for other in tile.also}
    blanks = {other: symbol for symbol in BLANKS if symbol in tiles for other in BLANKS}
    return {other: symbol for other, symbol in (blanks | known).items() if other not in tiles}


def respell(rows: Sequence[str], table: Mapping[str, str]) -> list[str]:
    """Draw rows with other symbols: those of `table` in place of those it names."""
    codes = {ord(old): new for old, new in table.items()}
    return [row.translate(codes) for row in rows]


def endings_for(tiles: str, meanings: Mapping[str, Tile] = NO_MEANINGS) -> tuple[str, ...]:
    """List the endings of files that can hold every tile of an alphabet."""
    every = set(tiles) <= _on_map(tiles, meanings).keys()
    return ENDINGS if every else tuple(ending for ending in ENDINGS if ending != ".map")


def write_layout(
    path: str | Path,
    layout: Array,
    tiles: str,
    meanings: Mapping[str, Tile] = NO_MEANINGS,
    /,
    **details: Any,
) -> None:
    """Write a layout atomically; the ending of the name says how.

    Args:
        path: a .json, .txt, .csv or .map file; JSON unless the ending is one of the others.
        layout: int8 [H, W].
        tiles: its alphabet.
        meanings: what the symbols mean; a map needs to know what is an obstacle.
        details: JSON-ready facts beside the rows; the other files do not hold them.

    Raises:
        InputError: no layout may be so large, a map would lose tiles, or the place cannot be
            written to.
    """
    rows, ending = draw(layout, tiles), Path(path).suffix.lower()
    check_size(len(rows), len(rows[0]))
    if ending == ".txt":
        text = "\n".join(rows)
    elif ending == ".csv":
        text = "\n".join(",".join(row) for row in rows)
    elif ending == ".map":
        head = f"type octile\nheight {len(rows)}\nwidth {len(rows[0])}\nmap\n"
        text = head + "\n".join(_map_rows(rows, path, tiles, meanings))
    else:
        size = {"n_row": len(rows), "n_col": len(rows[0])}
        text = json.dumps({**size, **details, "layout": rows}, indent=1)
    write_atomically(Path(path), f"{text}\n".encode())


def _map_rows(
    rows: Sequence[str], path: str | Path, tiles: str, meanings: Mapping[str, Tile]
) -> list[str]:
    """Draw rows as MovingAI does, or refuse where that would lose what a tile is."""
    table = _on_map(tiles, meanings)
    lost = "".join(symbol for symbol in tiles if symbol not in table and symbol in "".join(rows))
    if lost:
        raise InputError(
            f"{path}: a .map tells open ground from obstacles only, this layout also has "
            f"{alphabet(lost, meanings)}: write a .json, .txt or .csv"
        )
    return respell(rows, table)


def _on_map(tiles: str, meanings: Mapping[str, Tile]) -> dict[str, str]:
    """Pair the symbols that a map can hold with MovingAI's: those that read back as they were."""
    known = {symbol: symbol for symbol in tiles} | aliases(tiles, meanings)
    return {known[read]: drawn for read, drawn in ((".", "."), ("#", "@")) if read in known}
