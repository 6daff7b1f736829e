"""Pictures with one pixel a cell, in the colours of tiles; and which colours these are."""

import io
import json
from collections.abc import Mapping
from pathlib import Path

from qdenv.io.files import MEGABYTE, damaged, read_bytes, write_atomically
from qdenv.io.layouts import Drawing, check_size
from qdenv.types import InputError, Tile

# Distinct for readers with colour blindness, too, within each alphabet (tests measure it). In
# reading a picture the first tile of a colour is meant.
COLOURS = {
    ".": "#ffffff",
    "@": "#2b2b2b",
    "e": "#9dc3f2",
    "w": "#e69f00",
    "#": "#8a8a8a",
    "i": "#009e73",
    "o": "#b0306a",
    "0": "#d55e00",
    "1": "#3b2a8c",
    "2": "#f2d64b",
    "X": "#8a8a8a",
    " ": "#ffffff",
}
_LEGEND = "qdenv tiles"  # name of the text in a file that lists its colours: {"#ffffff": "."}
_MAX_BYTES = 32 * MEGABYTE


def read_png(path: Path) -> Drawing:
    """Read a picture in the colours of the legend in its file, or else in those of `COLOURS`."""
    from PIL import Image  # here: other formats do without

    content = read_bytes(path, _MAX_BYTES)
    try:
        with Image.open(io.BytesIO(content), formats=["PNG"]) as picture:
            cols, rows = picture.size
            check_size(rows, cols, f"{path}: ")  # before the pixels are unpacked
            pixels = picture.convert("RGB").tobytes().hex()
            legend = json.loads(picture.info.get(_LEGEND, "{}"))
    except InputError:
        raise
    except Exception as error:  # whatever a parser stumbles over in a damaged file
        raise damaged(path, f"not a picture: {error}") from error
    known = {colour: tile for tile, colour in reversed(COLOURS.items())}
    if isinstance(legend, dict) and all(isinstance(one, str) for one in legend.values()):
        known |= {colour: tile for colour, tile in legend.items() if len(tile) == 1}
    colours = [f"#{pixels[place : place + 6]}" for place in range(0, len(pixels), 6)]
    for place, colour in enumerate(colours):
        if colour not in known:
            row, col = divmod(place, cols)
            reason = f"{colour} at row {row}, column {col} is the colour of no tile"
            listed = ", ".join(
                f"{tile!r} {one}" for tile, one in sorted(zip(known.values(), known, strict=True))
            )
            raise damaged(path, f"{reason}: these are {listed}")
    drawn = "".join(map(known.__getitem__, colours))
    return Drawing([drawn[begin : begin + cols] for begin in range(0, len(drawn), cols)])


def write_png(path: Path, drawing: Drawing, meanings: Mapping[str, Tile]) -> None:
    """Write a picture with its legend."""
    from PIL import Image
    from PIL.PngImagePlugin import PngInfo

    used = sorted({symbol for row in drawing.rows for symbol in row})
    colours = colours_of(used)
    picture = Image.new("P", (len(drawing.rows[0]), len(drawing.rows)))
    picture.putpalette([part for one in used for part in bytes.fromhex(colours[one][1:])])
    picture.putdata([used.index(symbol) for row in drawing.rows for symbol in row])
    legend, file = PngInfo(), io.BytesIO()
    legend.add_text(_LEGEND, json.dumps({colours[symbol]: symbol for symbol in used}))
    picture.save(file, "PNG", pnginfo=legend)
    write_atomically(path, file.getvalue())


def colours_of(symbols: list[str]) -> dict[str, str]:
    """Give each symbol a colour of its own: the usual one, or where that is taken any other."""
    colours: dict[str, str] = {}
    for symbol in symbols:
        colour = COLOURS.get(symbol, f"#{ord(symbol) * 2654435761 % 2**24:06x}")
        while colour in colours.values():
            colour = f"#{(int(colour[1:], 16) + 1) % 2**24:06x}"
        colours[symbol] = colour
    return colours
