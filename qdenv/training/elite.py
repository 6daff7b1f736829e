"""The elites of a run, its best layout, and what the columns of a saved archive must be."""

import math
from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple

import numpy as np

from qdenv.domains.base import Domain
from qdenv.grid import parse
from qdenv.io.arrays import Column, read_arrays
from qdenv.io.files import damaged
from qdenv.io.records import read_json
from qdenv.training.manifest import Meaning
from qdenv.types import InputError

# Those that every archive has.
COLUMNS = {
    "index": Column("iu", 1),
    "solution": Column("iuf", 2, finite=True),
    "objective": Column("iuf", 1, finite=True),
    "measures": Column("iuf", 2, finite=True),
}
REPAIRED = {"repaired": Column("iu", 3)}  # the layouts, which the archive of a run has beside
# Those that the archive of a run may have: the layouts before the repair, how each run ended.
KNOWN = {"unrepaired": Column("iu", 3), "congested": Column("b", 2), "success": Column("b", 2)}
Columns = Mapping[str, np.ndarray]


class Elite(NamedTuple):
    """One filled cell of a run's archive."""

    solution: np.ndarray  # float32 [P], the parameters of the generator
    objective: float  # what the search maximised
    cell: tuple[int, ...]  # index along each measure
    measures: Mapping[str, float]  # value of each measure, by its name
    layout: np.ndarray  # int8 [H, W], repaired, as it was simulated
    meaning: Meaning  # of the archive; `Meaning.tiles` is the alphabet of the layout

    def __repr__(self) -> str:
        """Say where it is in the archive and what it is worth, without its parameters."""
        cell = ",".join(map(str, self.cell))
        values = "".join(f", {name} {value:.4g}" for name, value in self.measures.items())
        return f"Elite(cell {cell}, objective {self.objective:.4g}{values})"

    def _repr_html_(self) -> str:
        """Draw the layout under the numbers, for notebooks."""
        # Only here: matplotlib takes half a second to import.
        from qdenv.plots.inline import layout_html

        return f"<p>{self!r}</p>{layout_html(self.layout, self.meaning.tiles, self.meaning.names)}"


def best_row(columns: Columns, tie_break: str | None) -> int:
    """Find the row of the best elite; `tie_break` names the column that decides among equals.

    Args:
        columns: of an archive that is not empty.
        tie_break: a number, or several per elite, whose mean counts; the larger is better.
    """
    objective = columns["objective"]
    best = np.flatnonzero(objective == objective.max())
    if tie_break is None or tie_break not in columns:
        return int(best[0])
    worth = columns[tie_break].astype(np.float64).reshape(len(objective), -1).mean(axis=1)
    return int(best[np.argmax(worth[best])])


def read_columns(path: Path, meaning: Meaning) -> dict[str, np.ndarray]:
    """Read the archive of a run.

    Raises:
        InputError: it cannot be read; it is no archive over these measures: a column is missing or
            of another length, a cell lies outside, or a tile means nothing.
    """
    columns = read_arrays(path, COLUMNS | REPAIRED, Column(), KNOWN)
    index, cells = columns["index"], math.prod(one.cells for one in meaning.measures)
    alike = all(column.ndim and len(column) == len(index) for column in columns.values())
    inside = ((index >= 0) & (index < cells)).all() and len(np.unique(index)) == len(index)
    if not (alike and inside and columns["measures"].shape[1] == len(meaning.measures)):
        raise damaged(path, "not over the measures of this run")
    if len(index) and not all(column.size for column in columns.values()):
        raise damaged(path, "a column holds nothing")
    for name in columns.keys() & {"repaired", "unrepaired"}:
        layouts, tiles = columns[name], len(meaning.tiles)
        if layouts.size and not 0 <= layouts.min() <= layouts.max() < tiles:
            raise damaged(path, f"{name} holds tiles that this run does not know")
        if layouts.shape != columns["repaired"].shape:
            raise damaged(path, f"{name} has another size than repaired")
    return columns


class BestLayout(NamedTuple):
    """The layout of the best elite."""

    layout: np.ndarray  # int8 [H, W]
    # cells (row, column) that pictures name, like a maze's start and goal
    marks: dict[str, tuple[int, int]]


def mark_cells(layout: np.ndarray, domain: Domain) -> dict[str, tuple[int, int]]:
    """Find the cells (row, column) that pictures of a layout (int8 [H, W]) name."""
    marks = domain.marks(layout) if domain.marks else {}
    return {
        name: (int(cell) // layout.shape[1], int(cell) % layout.shape[1])
        for name, cell in marks.items()
    }


class _BestLayout(NamedTuple):
    """The content of best_layout.json."""

    layout: list[str]
    marks: Mapping[str, tuple[int, int]] = {}


def read_best_layout(path: Path, tiles: str) -> BestLayout:
    """Read best_layout.json.

    Raises:
        InputError: it cannot be read, or is damaged.
    """
    content = read_json(path, _BestLayout)
    try:
        return BestLayout(parse(content.layout, tiles), dict(content.marks))
    except InputError as error:
        raise damaged(path, error) from error
