"""Drawings of CAD in DXF (ezdxf): a layer for each kind of tile, a square for each cell.

Metres begin at the lower left corner, x to the right, y up. What is read: closed polylines on
layers of known names. A cell is what the last polyline around its centre says; a drawing of ours
knows its layers and cells, any other has both in the facts beside it (`io.facts`):

    cell = 1.2
    layers = {RACKS = "@", COLUMNS = "#"}
"""

import io
import json
import logging
from collections import Counter
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from qdenv.io.facts import facts_beside
from qdenv.io.files import MEGABYTE, damaged, parsing, read_bytes, write_atomically
from qdenv.io.images import colours_of
from qdenv.io.lanes import side_of
from qdenv.io.layouts import BLANKS, MAX_SIDE, Drawing, check_size
from qdenv.types import InputError, Tile, require_package

_FACTS = "qdenv"  # name of the property of the drawing that holds the cell and the layers
_METRES = 6  # of DXF's units
_MAX_BYTES, _MAX_SQUARES = 24 * MEGABYTE, 100_000
_MAX_WORK = 500_000_000  # corners of polylines times the cells around them


def _ezdxf() -> Any:
    require_package(".dxf files", "ezdxf", "formats")
    import ezdxf.recover

    # It warns of whatever it skips; without a handler Python would print that.
    logging.getLogger("ezdxf").addHandler(logging.NullHandler())
    return ezdxf


def write_dxf(path: Path, drawing: Drawing, meanings: Mapping[str, Tile]) -> None:
    """Write the outline as floor, and a square for each cell of another tile."""
    rows, side, file = drawing.rows, side_of(path, drawing), io.StringIO()
    height, width = len(rows), len(rows[0])
    if sum(symbol not in BLANKS for symbol in "".join(rows)) > _MAX_SQUARES:
        raise InputError(f"{path}: more than {_MAX_SQUARES:,} tiles beside floor: write a .json")
    ezdxf = _ezdxf()
    document = ezdxf.new("R2010", units=_METRES)
    used = sorted({*"".join(rows)})
    floor = next((symbol for symbol in used if symbol in BLANKS), ".")
    layers = {one: meanings.get(one, Tile("floor")).name for one in (floor, *used)}
    names = {name.casefold() for name in layers.values()}
    allowed = map(ezdxf.lldxf.validator.is_valid_table_name, names)
    if len(names) < len(layers) or not all(allowed):  # of a plug-in
        layers = {symbol: f"tile {ord(symbol)}" for symbol in layers}
    for symbol, colour in colours_of(used).items():
        document.layers.add(layers[symbol]).rgb = tuple(bytes.fromhex(colour[1:]))
    facts = {"cell": side, "layers": {name: symbol for symbol, name in layers.items()}}
    document.header.custom_vars.append(_FACTS, json.dumps(facts))
    space = document.modelspace()

    def draw(symbol: str, row: int, col: int, end_row: int, end_col: int) -> None:
        (left, right), (low, high) = (col, end_col), (height - end_row, height - row)
        corners = [(left, low), (right, low), (right, high), (left, high)]
        points = [(x * side, y * side) for x, y in corners]
        space.add_lwpolyline(points, close=True, dxfattribs={"layer": layers[symbol]})

    draw(floor, 0, 0, height, width)
    for row, line in enumerate(rows):
        for col, symbol in enumerate(line):
            if symbol not in BLANKS:
                draw(symbol, row, col, row + 1, col + 1)
    document.write(file)
    write_atomically(path, file.getvalue().encode())


def read_dxf(path: Path) -> Drawing:
    """Read closed polylines on known layers; where there is a floor, what lies around it is blank.

    Curves count as the lines between their ends.
    """
    ezdxf, content = _ezdxf(), read_bytes(path, _MAX_BYTES)
    with parsing(path, "a DXF drawing"):
        document, _ = ezdxf.recover.read(io.BytesIO(content))  # decodes old files, too
        facts = dict(json.loads(dict(document.header.custom_vars.properties).get(_FACTS, "{}")))
        scale = ezdxf.units.conversion_factor(document.units or _METRES, _METRES)
        shapes, others = _shapes(document.modelspace(), scale)
    beside, facts = path.with_suffix(".toml"), {**facts, **facts_beside(path)}
    layers, side = facts.get("layers"), facts.get("cell")
    if not isinstance(layers, dict) or not side:
        form = 'layers = {RACKS = "@"}, and below the length of a cell in metres, like cell = 1.2'
        raise damaged(path, f"write {beside.name} beside it with its layers, like {form}")
    tiles = {str(name).casefold(): str(tile)[:1] for name, tile in layers.items() if tile}
    known = [(tiles[name], points) for name, points in shapes if name in tiles]
    others.update(name for name, _ in shapes if name not in tiles)
    if not known:
        raise damaged(path, f"no closed polyline on the layers {', '.join(layers)}")
    side = side_of(path, Drawing([], details={"cell": side}))
    names = ", ".join(sorted(others))
    lost = [f"{others.total()} shapes ({names}) are"] * bool(others)
    return Drawing(_paint(path, known, side), details={"cell": side}, lost=tuple(lost))


def _shapes(space: Any, scale: float) -> tuple[list[tuple[str, np.ndarray]], Counter[str]]:
    """List the layer and the corners (float [N, 2], metres) of closed polylines; count the rest."""
    shapes, others = [], Counter[str]()
    for entity in space:
        layer, kind = entity.dxf.layer.casefold(), entity.dxftype()
        points: Any = []
        if kind == "LWPOLYLINE":
            points = [(point.x, point.y) for point in entity.vertices_in_wcs()]
        elif kind == "POLYLINE":
            points = [(point.x, point.y) for point in entity.points_in_wcs()]
        if len(points) > 2 and (entity.is_closed or points[0] == points[-1]):
            shapes.append((layer, np.array(points, float) * scale))
        else:
            others[layer] += 1
    return shapes, others


def _paint(path: Path, shapes: list[tuple[str, np.ndarray]], side: float) -> list[str]:
    """Draw polylines with their tiles, one over another, on the cells inside all their corners."""
    corners = np.concatenate([points for _, points in shapes]) / side
    if not (np.abs(corners) < 1e9).all():
        raise damaged(path, "a corner lies too far away")
    low = np.floor(corners.min(0) + 0.01)
    width, height = np.maximum(np.ceil(corners.max(0) - 0.01) - low, 0).astype(int).tolist()
    check_size(height, width, f"{path}: ")
    ground = " " if any(tile in BLANKS for tile, _ in shapes) else "."
    drawn, work = np.full((height, width), ground), 0
    for tile, points in shapes:
        ends = points / side - low  # in cells, from the lower left corner
        first = np.clip(np.ceil(ends.min(0) - 0.5), 0, MAX_SIDE).astype(int)
        last = np.clip(np.ceil(ends.max(0) - 0.5), 0, MAX_SIDE).astype(int)
        x, y = np.arange(first[0], last[0]) + 0.5, np.arange(first[1], last[1]) + 0.5
        work += len(ends) * x.size * y.size
        if work > _MAX_WORK:
            raise damaged(path, "too many large polylines with too many corners")
        inside = np.zeros((y.size, x.size), bool)
        # A ray to the right of a centre crosses the outline an odd number of times from inside.
        for (x0, y0), (x1, y1) in zip(ends, np.roll(ends, -1, axis=0), strict=True):
            rows = (y0 > y) != (y1 > y)
            if rows.any():
                cross = x0 + (y[rows] - y0) * (x1 - x0) / (y1 - y0)
                inside[rows] ^= x < cross[:, None]
        part = drawn[::-1][first[1] : last[1], first[0] : last[0]]
        part[inside] = tile
    return ["".join(line) for line in drawn]
