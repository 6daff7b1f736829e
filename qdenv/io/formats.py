"""The formats of layouts: which ending means which, who reads and writes it, what it cannot say.

A format is a reader, a function of a path that returns an `io.layouts.Drawing`, and a writer, a
function of a path, a drawing and what its symbols mean, which may return what it left out. Each is
named here, and imported when it is needed.
"""

import pkgutil
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import Any, NamedTuple

from qdenv.types import InputError, Tile, choices


class Format(NamedTuple):
    """One format."""

    # the endings of its files, and what such a file holds beside tiles: fields of `Drawing`, keys
    # of its details
    endings: Mapping[str, tuple[str, ...]]
    module: str  # of the two functions
    read: str = ""  # name of a function; "" where the format is only written
    write: str = ""  # name of another; "" where the format is only read
    # endings of the files that are written beside one with such an ending
    beside: Mapping[str, tuple[str, ...]] = MappingProxyType({})


_LAYOUTS, _MAPS = "qdenv.io.layouts", "qdenv.io.maps"
_IMAGES, _ROADS = "qdenv.io.images", "qdenv.io.lanes"
_ROBOTS, _LANES = ("starts", "tasks"), ("weights", "cell", "name")
LIBRARIES = {".xlsx": "openpyxl", ".dxf": "ezdxf"}  # that need to be installed, by endings
# Of several with the same ending, the first one is meant where nothing else says which.
FORMATS: dict[str, Format] = {
    "json": Format(
        {".json": ("weights", *_ROBOTS, "details")}, _LAYOUTS, "read_json_rows", "write_json_rows"
    ),
    "text": Format({".txt": ()}, _LAYOUTS, "read_text_rows", "write_text_rows"),
    "csv": Format({".csv": ("weights",)}, _LAYOUTS, "read_csv_rows", "write_csv_rows"),
    "movingai": Format({".map": ()}, _MAPS, "read_map", "write_movingai"),
    "scen": Format({".scen": _ROBOTS}, _MAPS, "read_scen", "write_scen", {".scen": (".map",)}),
    "lorr": Format(  # the League of Robot Runners
        {".json": (*_ROBOTS, "details"), ".map": ()},
        *(_MAPS, "read_lorr", "write_lorr", {".json": (".map", ".agents", ".tasks")}),
    ),
    "rhcr": Format(
        {".grid": ("weights", "starts"), ".map": ("starts", "maxtime")},
        *(_MAPS, "read_rhcr", "write_rhcr"),
    ),
    "pogema": Format({".txt": ()}, _MAPS, "read_pogema", "write_pogema"),
    "png": Format({".png": ()}, _IMAGES, "read_png", "write_png"),
    "xlsx": Format({".xlsx": ()}, _IMAGES, "read_xlsx", "write_xlsx"),
    "dxf": Format({".dxf": ("cell",)}, "qdenv.io.dxf", "read_dxf", "write_dxf"),
    "lif": Format(  # VDMA's layout interchange format
        dict.fromkeys((".lif", ".lif.json", ".json"), _LANES), _ROADS, "", "write_lif"
    ),
    "rmf": Format({".yaml": _LANES}, _ROADS, "", "write_rmf"),
    "nav2": Format({".geojson": _LANES}, _ROADS, "", "write_nav2"),
    "ros": Format(
        {".pgm": ("cell",), ".yaml": ("cell",)},
        *(_ROADS, "", "write_ros", {".pgm": (".yaml",), ".yaml": (".pgm",)}),
    ),
}
ALL_ENDINGS = tuple(dict.fromkeys(ending for one in FORMATS.values() for ending in one.endings))
READ_ENDINGS = tuple(
    dict.fromkeys(ending for one in FORMATS.values() if one.read for ending in one.endings)
)


def _ending_of(path: Path) -> str:
    """Return the longest known ending of a file's name, or any other suffix, in small letters."""
    name = path.name.lower()
    known = [ending for ending in ALL_ENDINGS if name.endswith(ending)]
    return max(known, key=len, default=path.suffix.lower())


def holds(ending: str, part: str) -> bool:
    """Return True if the usual format with an ending has a place for a part of a `Drawing`."""
    written = (one.endings for one in FORMATS.values() if one.write)
    places = (endings[ending] for endings in written if ending in endings)
    return part in next(places, FORMATS["json"].endings[".json"])


def find_reader(path: Path, form: str | None = None) -> Callable[[Path], Any]:
    """Find the reader of a file; raise InputError if `form` is not a format that is read.

    Without `form` the file's ending decides; JSON is the format of any other one.
    """
    name = _find(path, form, "read") or "json"
    return pkgutil.resolve_name("{0.module}:{0.read}".format(FORMATS[name]))


def find_writer(path: Path, form: str | None = None) -> str:
    """Return the name of the format in which a file is written; InputError for others."""
    if name := _find(path, form, "write"):
        return name
    raise InputError(f"{path}: give a name that ends in {', '.join(ALL_ENDINGS)}")


def _find(path: Path, form: str | None, way: str) -> str | None:
    """Find the format of a file by its name; None where no ending fits."""
    able = {name: one for name, one in FORMATS.items() if getattr(one, way)}
    if form is not None and form not in able:
        raise InputError(f"format {form!r} is not among those to {way}: {choices(form, able)}")
    ending = _ending_of(path)
    if form is None:
        fit = [name for name, one in able.items() if ending in one.endings]
        if ending == ".yaml" and fit:  # no format with it is the usual one
            raise InputError(f"{path}: choose by --format: {' or '.join(fit)}")
        return fit[0] if fit else None
    if way == "write" and ending not in able[form].endings:
        ends = " or ".join(able[form].endings)
        raise InputError(f"{path}: {form} needs a name that ends in {ends}")
    return form


def write_drawing(
    path: Path, drawing: Any, meanings: Mapping[str, Tile], form: str | None = None
) -> list[str]:
    """Write an `io.layouts.Drawing` in the format `form`, or by the ending of the file's name.

    `meanings` are those of the symbols, as `types.Tile`. Returns what is left out, a line each.
    Raises InputError if the format cannot hold such a drawing, or the place cannot be written to.
    """
    name = find_writer(path, form)
    cells = sum(map(len, drawing.rows))
    for cell in (*drawing.starts, *(cell for task in drawing.tasks for cell in task)):
        if not 0 <= cell < cells:
            raise InputError(f"{path}: a robot or task at cell {cell}: the last one is {cells - 1}")
    write = pkgutil.resolve_name("{0.module}:{0.write}".format(FORMATS[name]))
    lost = write(path, drawing, meanings) or []
    # What the drawing has, and the file has no place for.
    places = FORMATS[name].endings.get(_ending_of(path), ("weights", *_ROBOTS, "details"))
    parts = {
        "weights": ("costs of moves are", drawing.weights is not None),
        "starts": ("the robots' starts are", bool(drawing.starts)),
        "tasks": ("tasks are", bool(drawing.tasks)),
    }
    lost = [*lost, *(words for part, (words, has) in parts.items() if has and part not in places)]
    facts = {**drawing.details, **drawing.details.get("facts", {})}
    keys = [key for key, fact in facts.items() if key not in (*places, "domain", "facts") and fact]
    lost += [f"facts ({', '.join(keys)}) are"] * (bool(keys) and "details" not in places)
    return [f"{name}: {what} left out" for what in lost]


def redraw(
    rows: Sequence[str], meanings: Mapping[str, Tile], signs: Mapping[str, str], others: str
) -> tuple[list[str], list[str]]:
    """Draw rows with the signs of another format.

    Symbols that are not among `signs` become the first of `others`, obstacles the second. Returns
    the new rows, and which tiles have become alike.
    """
    used = sorted({*"".join(rows)})
    known = {symbol: meanings.get(symbol, Tile(repr(symbol))) for symbol in used}
    table: dict[str, Any] = {
        symbol: signs.get(symbol, others[tile.obstacle]) for symbol, tile in known.items()
    }
    lost = []
    for sign in dict.fromkeys(table.values()):
        alike = [symbol for symbol in used if table[symbol] == sign]
        names = ", ".join(dict.fromkeys(known[symbol].name for symbol in alike))
        if "," in names:
            lost.append(f"what tells {names} apart ({sign!r}) is")
        elif alike[0] not in (*signs, *" .@#X"):  # floor and obstacles are the same everywhere
            lost.append(f"what {names} is ({sign!r}) is")
    return [row.translate(str.maketrans(table)) for row in rows], lost
