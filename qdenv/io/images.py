"""Coloured cells: pictures with a pixel for each, Excel sheets (openpyxl) with a tile in each."""

import io
import json
import zipfile
from collections.abc import Mapping
from pathlib import Path

from qdenv.io.files import MEGABYTE, damaged, parsing, read_bytes, write_atomically
from qdenv.io.layouts import MAX_SIDE, Drawing, check_size, join_cells
from qdenv.types import Tile, require_package

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
_MAX_BYTES, _MAX_UNPACKED = 32 * MEGABYTE, 128 * MEGABYTE


def read_png(path: Path) -> Drawing:
    """Read a picture in the colours of the legend in its file, or else in those of `COLOURS`."""
    from PIL import Image  # here: other formats do without

    content = io.BytesIO(read_bytes(path, _MAX_BYTES))
    with parsing(path, "a picture"), Image.open(content, formats=["PNG"]) as picture:
        cols, rows = picture.size
        check_size(rows, cols, f"{path}: ")  # before the pixels are unpacked
        pixels = picture.convert("RGB").tobytes().hex()
        legend = json.loads(picture.info.get(_LEGEND, "{}"))
    known = {colour: tile for tile, colour in reversed(COLOURS.items())}
    if isinstance(legend, dict) and all(isinstance(one, str) for one in legend.values()):
        known |= {colour: tile for colour, tile in legend.items() if len(tile) == 1}
    colours = [f"#{pixels[place : place + 6]}" for place in range(0, len(pixels), 6)]
    for place, colour in enumerate(colours):
        if colour not in known:
            row, col = divmod(place, cols)
            reason = f"{colour} at row {row}, column {col} is the colour of no tile"
            pairs = sorted((tile, one) for one, tile in known.items())
            listed = ", ".join(f"{tile!r} {one}" for tile, one in pairs)
            raise damaged(path, f"{reason}: these are {listed}")
    drawn = "".join(map(known.__getitem__, colours))
    return Drawing([drawn[begin : begin + cols] for begin in range(0, len(drawn), cols)])


def write_png(path: Path, drawing: Drawing, meanings: Mapping[str, Tile]) -> None:
    """Write a picture with its legend."""
    from PIL import Image
    from PIL.PngImagePlugin import PngInfo

    drawn = "".join(drawing.rows)
    used = sorted({*drawn})
    colours = colours_of(used)
    picture = Image.new("P", (len(drawing.rows[0]), len(drawing.rows)))
    picture.putpalette([part for one in used for part in bytes.fromhex(colours[one][1:])])
    picture.putdata([used.index(symbol) for symbol in drawn])
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


def read_xlsx(path: Path) -> Drawing:
    """Read the first sheet: a symbol in each cell, an empty one is a blank."""
    require_package(".xlsx files", "openpyxl", "formats")
    import openpyxl

    content = read_bytes(path, _MAX_BYTES)
    with parsing(path, "a sheet of Excel"):
        with zipfile.ZipFile(io.BytesIO(content)) as archive:
            if sum(one.file_size for one in archive.infolist()) > _MAX_UNPACKED:
                raise damaged(path, f"more than {_MAX_UNPACKED // MEGABYTE} MB of content")
            # openpyxl reports merged cells only if it may read whole sheets, of any size.
            sheets = [one for one in archive.namelist() if one.endswith("/sheet1.xml")]
            if any(b"<mergeCell " in archive.read(one) for one in sheets):
                raise damaged(path, "merged cells hold one tile: split them, and fill each cell")
        book = openpyxl.load_workbook(io.BytesIO(content), read_only=True, data_only=True)
        sheet, *others = book.worksheets
        values = sheet.iter_rows(max_row=MAX_SIDE + 1, max_col=MAX_SIDE + 1, values_only=True)
        table = [["" if one is None else str(one) for one in line] for line in values]
    # Sheets remember empty cells that once had a colour.
    while table and not any(table[-1]):
        table.pop()
    width = max((col + 1 for line in table for col, one in enumerate(line) if one), default=0)
    table = [(line + [""] * width)[:width] for line in table]
    names = ", ".join(other.title for other in others)
    lost = [f"sheets beyond the first one ({names}) are"] * bool(others)
    return Drawing(join_cells(path, table), lost=tuple(lost))


def write_xlsx(path: Path, drawing: Drawing, meanings: Mapping[str, Tile]) -> None:
    """Write a sheet with coloured cells; a blank is written as ``.``, for Excel shows neither."""
    require_package(".xlsx files", "openpyxl", "formats")
    import openpyxl

    book, file = openpyxl.Workbook(), io.BytesIO()
    sheet = book.active
    sheet.title = "layout"
    colours = colours_of(sorted({*"".join(drawing.rows)}))
    fills = {
        symbol: openpyxl.styles.PatternFill("solid", fgColor=colour[1:])
        for symbol, colour in colours.items()
    }
    for row, line in enumerate(drawing.rows, 1):
        for col, symbol in enumerate(line, 1):
            cell = sheet.cell(row, col, "." if symbol == " " else symbol)
            cell.fill, cell.data_type = fills[symbol], "s"
    for col in range(1, len(drawing.rows[0]) + 1):
        sheet.column_dimensions[openpyxl.utils.get_column_letter(col)].width = 2.5
    book.save(file)
    write_atomically(path, file.getvalue())
