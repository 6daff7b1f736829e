"""What operations return and leave: tables and layouts with facts, lines of text, files."""

from __future__ import annotations

import html
import logging
import os.path
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from qdenv.domains.base import Domain
from qdenv.io.facts import write_facts
from qdenv.io.files import check_writable, find_stream, reserve
from qdenv.io.formats import LIBRARIES
from qdenv.io.layouts import write_layout
from qdenv.shipped import refuse_inside
from qdenv.study.plans import is_plain
from qdenv.types import InputError, require_package

if TYPE_CHECKING:
    from matplotlib.figure import Figure

# Operations log what they find, line by line. The command line prints these lines; in Python they
# are silent unless logging is configured: logging.basicConfig(level="INFO", format="%(message)s").
log = logging.getLogger("qdenv")

AUTO = Path("auto")  # an output that was requested without a name; the operation chooses one
PICTURES = (".png", ".svg", ".pdf")
FILMS = (".gif", ".mp4")


def say(*lines: object) -> None:
    """Log lines of text."""
    for line in lines:
        log.info("%s", line)


class Place(NamedTuple):
    """A file to write."""

    path: Path  # the file
    replaces: bool  # it exists already, and was named by the user
    automatic: bool = False  # its name was chosen here, and it replaces nothing
    read: Sequence[Path] = ()  # files that may not be replaced

    def __str__(self) -> str:
        """Return the path as commands print it."""
        return f"{self.path} (replaced)" if self.replaces else str(self.path)

    def beside(self, ending: str) -> Place:
        """Return the place of another result: the same name, another ending.

        It replaces a file only where this place does: a picture of that name that was there before
        its data, or is read, is the user's own, and the next free name is taken.
        """
        path = self.path.with_name(f"{self.path.stem}{ending}")
        own = path.exists() and (not self.replaces or any(map(path.samefile, self.read)))
        if ending and (self.automatic or own):
            return Place(reserve(path), False, True)
        return Place(path, path.exists())

    def draw(self, figure: Figure, crop: bool = False) -> None:
        """Write a figure, see `save_figure`, and log the place."""
        from qdenv.view.style import save_figure  # imports matplotlib

        save_figure(figure, self.path, crop)
        say(self)


def place(
    out: Any, default: str, endings: Iterable[str] = (), inputs: Iterable[Any] = ()
) -> Place | None:
    """Choose the file of a result, before any work is done; None if `out` is None or False.

    `AUTO`, or True, takes `default`, a name in the current folder, or the next free name like it
    (plan-2.json), which is reserved at once. Without `endings` it is data, with any ending but a
    picture's. Files among `inputs` are read, and must not be overwritten.
    Raises InputError if the ending is none of them, or the place is a folder, an input, read-only.
    """
    if out is None or out is False:
        return None
    path, endings = AUTO if out is True else Path(out), tuple(endings)
    if path == AUTO:
        return Place(reserve(Path(default)), False, True)
    ending = path.suffix.lower()
    if ending in LIBRARIES:
        require_package(f"{ending} files", LIBRARIES[ending], "formats")
    if endings and ending not in endings:
        raise InputError(f"{path}: give a name that ends in {' or '.join(endings)}")
    if not endings and ending in (*PICTURES, *FILMS, ".jpg", ".jpeg", ".webp"):
        better = path.with_suffix(Path(default).suffix)
        beside = f"name the data {better}, pictures are drawn beside it"
        raise InputError(f"{path}: that is a picture's name: {beside}")
    if path.is_dir():
        better = path / Path(default).name
        raise InputError(f"{path}: that is a folder: name a file in it, like {better}")
    # Two names of one file are the same file: links, other spellings.
    named = [str(one) for one in inputs if isinstance(one, str | Path)]
    joined = [one for one in named if not os.path.exists(one)]  # w+KEEP, A,B
    parts = [part for one in joined for sign in "+," for part in one.split(sign)]
    files = [Path(one) for one in (*named, *parts) if os.path.exists(one)]
    if path.exists() and any(map(path.samefile, files)):
        raise InputError(f"{path}: that is what is read: choose another name")
    if find_stream(path) is not None:  # what is behind it is not replaced
        return Place(path, False)
    refuse_inside(path)
    check_writable(path)
    return Place(path, path.is_file(), read=files)


def place_table(
    out: str | Path | None, plot: str | Path | None, name: str, inputs: Iterable[Any] = ()
) -> tuple[Place | None, Place | None]:
    """Choose where a table goes, and its picture: beside the table unless it is named."""
    table = place(out, f"{name}.csv", (".csv",), inputs)
    if table is None or plot not in (None, AUTO):
        return table, place(None if plot == AUTO else plot, f"{name}.png", PICTURES, inputs)
    return table, table.beside(PICTURES[0])


def place_folder(out: str | Path, default: str) -> Path:
    """Choose the folder of several results; raise InputError if it is a file, or read-only."""
    folder = AUTO if out is True else Path(out)
    if folder == AUTO:
        folder = reserve(Path(default), folder=True)
    if folder.exists() and not folder.is_dir():
        raise InputError(f"{folder}: that is a file: name a folder")
    refuse_inside(folder)
    check_writable(folder / default)
    return folder


def format_table(rows: Iterable[Sequence[Any]]) -> list[str]:
    """Align the columns of a table to the left; the rows are of equal length, the head first."""
    cells = [[str(cell) for cell in row] for row in rows]
    widths = [max(map(len, column)) for column in zip(*cells, strict=True)]
    return [
        "  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip()
        for row in cells
    ]


def format_duration(seconds: float) -> str:
    """Write a duration in the largest unit of which it has 2.5 or more, rounded."""
    for unit, length in {"days": 86400, "h": 3600, "min": 60}.items():
        if seconds >= 2.5 * length:
            return f"{seconds / length:.0f} {unit}"
    return f"{max(seconds, 1):.0f} s"


@dataclass(frozen=True, repr=False)
class Layout:
    """A layout that was drawn, repaired or read."""

    layout: np.ndarray  # int8 [H, W]
    domain: Domain  # whose layout; not always at its size
    details: Mapping[str, Any] = field(default_factory=dict)  # of its making; saved in its file
    facts: Mapping[str, Any] = field(default_factory=dict)  # as `--json` writes them
    # float [5, H, W], the cost of each move at each cell (`guidance`); None where all are equal
    costs: np.ndarray | None = None

    def save(self, path: str | Path) -> Path:
        """Write a layout file at `path`, which is returned, with the domain and the details in it.

        The ending chooses the format. Beside text and CSV, which hold none, domain, cells that must
        stay, rules and tasks are facts in a .toml of the same name. What another leaves out, but
        the domain, is logged. Raises InputError if the format cannot hold the layout, or the place
        cannot be written to.
        """
        keep = {"keep": self.details["keep"]} if "keep" in self.details else {}
        own = {**self.domain.details, **keep}
        facts = {**own.get("facts", {}), **self.details.get("facts", {})}
        details = {**own, **self.details} | ({"facts": facts} if facts else {})
        tiles, meanings, costs = self.domain.tiles, self.domain.meanings, self.costs
        if costs is not None:
            costs = np.where(self.domain.drivable(self.layout), costs, np.inf)
        lost = write_layout(path, self.layout, tiles, meanings, costs, **details)
        path = Path(path)
        if path.suffix.lower() in (".txt", ".csv"):
            needed = bool(keep or facts) or not is_plain(self.layout, self.domain)
            say(*write_facts(path, own | ({"facts": facts} if facts else {}), needed))
        else:
            say(*lost)
        return path

    def draw(self, path: str | Path) -> Path:
        """Draw the layout as a picture at `path`, which is returned: PNG, SVG or PDF by its ending.

        Raises InputError if the place cannot be written to.
        """
        from qdenv.view.layouts import draw_plan  # imports matplotlib
        from qdenv.view.style import save_figure

        save_figure(draw_plan(self.layout, self.domain.tiles, self.domain.names), path, crop=True)
        return Path(path)

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> np.ndarray:
        """Return the tiles as an array."""
        return np.array(self.layout, dtype=dtype, copy=copy)

    def __repr__(self) -> str:
        """Return size, domain and facts in one line."""
        rows, cols = self.layout.shape
        facts = "".join(f", {name} {text}" for name, text in _single_values(self.facts).items())
        return f"Layout({rows} x {cols} of {self.domain.name}{facts})"

    def _repr_html_(self) -> str:
        from qdenv.view.layouts import layout_html  # imports matplotlib

        picture = layout_html(self.layout, self.domain.tiles, self.domain.names)
        return picture + _table_html([self.facts])


def save_with_picture(layout: Layout, target: Place | None, text: str = "") -> Layout:
    """Write a layout and a picture beside it, log both with `text` or all facts; return it."""
    if target:
        picture = target.beside(PICTURES[0])
        layout.save(target.path)
        layout.draw(picture.path)
        facts = ", ".join(f"{name} {value}" for name, value in layout.facts.items())
        say(picture, f"{target}: {text or facts}")
    return layout


class Result(dict):
    """What an operation finds, by name, as `--json` writes it."""

    def __repr__(self) -> str:
        """Return the single values in one line, without lists like those of the runs."""
        values = ", ".join(f"{name} {text}" for name, text in _single_values(self).items())
        return f"Result({values})"

    def _repr_html_(self) -> str:
        several = [one for one in self.values() if isinstance(one, list) and one]
        tables = [[self], *(one for one in several if isinstance(one[0], dict))]
        return "".join(map(_table_html, tables))


class Table(list):
    """Rows of one kind, each a `NamedTuple`, and the facts that `--json` writes."""

    def __init__(self, rows: Iterable[Any], facts: Mapping[str, Any], exit_code: int = 0) -> None:
        """Make a table; the command that made it ends with `exit_code`."""
        super().__init__(rows)
        self.facts, self.exit_code = facts, exit_code

    def __repr__(self) -> str:
        """Return the rows as an aligned table."""
        lines = format_table(_lines_of([row._asdict() for row in self]))
        return "\n".join(lines) if self else "Table(no rows)"

    def to_pandas(self) -> Any:
        """Make a pandas data frame, a line for each row; InputError if pandas is not installed."""
        require_package("tables", "pandas", "data")
        import pandas

        return pandas.DataFrame([row._asdict() for row in self])

    def _repr_html_(self) -> str:
        return _table_html([row._asdict() for row in self]) if self else "<p>no rows</p>"


class UnsolvedError(InputError):
    """A task without a solution, and the facts that `--json` writes of it."""

    def __init__(self, message: str, facts: Mapping[str, Any] = MappingProxyType({})) -> None:
        """Fail with one line; to be unpickled, it can be made without facts."""
        super().__init__(message)
        self.facts = facts


def _table_html(records: Sequence[Mapping[str, Any]]) -> str:
    """Draw records as a table: one as a list of its entries, several with a row for each."""
    lines: Iterable[Sequence[str]] = _lines_of(records)
    if len(records) == 1:
        lines = zip(*lines, strict=True)
    cells = ["".join(f"<td>{html.escape(cell)}</td>" for cell in line) for line in lines]
    return "<table>" + "".join(f"<tr>{line}</tr>" for line in cells) + "</table>"


def _lines_of(records: Sequence[Mapping[str, Any]]) -> list[list[str]]:
    """List the names of all single values, then those of each record."""
    rows = [_single_values(record) for record in records]
    names = list(dict.fromkeys(name for row in rows for name in row))
    return [names, *([row.get(name, "") for name in names] for row in rows)]


def _single_values(facts: Mapping[str, Any]) -> dict[str, str]:
    """Format what is a single value; the cell of an elite, a tuple, is one."""
    shown = {}
    for name, value in facts.items():
        if isinstance(value, tuple) and all(isinstance(one, int) for one in value):
            shown[name] = ",".join(map(str, value))
        elif isinstance(value, float | np.floating):
            # Four significant digits tell numbers apart in a notebook; --json has them all.
            shown[name] = f"{value:.4g}"
        elif not isinstance(value, list | dict | tuple):
            shown[name] = str(value)
    return shown
