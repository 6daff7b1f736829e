"""Sheets of Excel with one tile in each cell (openpyxl)."""

import io
import warnings
import zipfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from qdenv.io.files import MEGABYTE, damaged, read_bytes, write_atomically
from qdenv.io.formats import need_library
from qdenv.io.images import colours_of
from qdenv.io.layouts import MAX_SIDE, Drawing, join_cells
from qdenv.types import InputError, Tile

_MAX_BYTES, _MAX_UNPACKED = 32 * MEGABYTE, 128 * MEGABYTE


def _openpyxl() -> Any:
    need_library(".xlsx")
    import openpyxl

    return openpyxl


def read_xlsx(path: Path) -> Drawing:
    """Read the first sheet: a symbol in each cell, an empty one is a blank."""
    openpyxl, content = _openpyxl(), read_bytes(path, _MAX_BYTES)
    try:
        with zipfile.ZipFile(io.BytesIO(content)) as archive:
            if sum(one.file_size for one in archive.infolist()) > _MAX_UNPACKED:
                raise damaged(path, f"more than {_MAX_UNPACKED // MEGABYTE} MB of content")
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of styles and extensions that do not matter here
            book = openpyxl.load_workbook(io.BytesIO(content), read_only=True, data_only=True)
            sheet, *others = book.worksheets
            values = sheet.iter_rows(max_row=MAX_SIDE + 1, max_col=MAX_SIDE + 1, values_only=True)
            table = [["" if one is None else str(one) for one in line] for line in values]
    except InputError:
        raise
    except Exception as error:  # whatever a parser stumbles over in a damaged file
        raise damaged(path, f"not a sheet of Excel: {error}") from error
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
    openpyxl, file = _openpyxl(), io.BytesIO()
    book = openpyxl.Workbook()
    sheet = book.active
    sheet.title = "layout"
    colours = colours_of(sorted({symbol for row in drawing.rows for symbol in row}))
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
