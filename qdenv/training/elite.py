"""The elites of a run, its best layout, and what the columns of a saved archive must be."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from qdenv.domains.base import Domain
from qdenv.grid import parse
from qdenv.training.manifest import Meaning
from qdenv.types import InputError

COLUMNS = ("index", "solution", "objective", "measures")  # those that every archive has
Columns = Mapping[str, np.ndarray]


class Elite(NamedTuple):
    """One filled cell of a run's archive.

    Attributes:
        solution: float32 [P], the parameters of the generator.
        objective: what the search maximised.
        cell: index along each measure.
        measures: value of each measure, by its name.
        layout: int8 [H, W], repaired, as it was simulated.
        meaning: of the archive; `Meaning.tiles` is the alphabet of the layout.
    """

    solution: np.ndarray
    objective: float
    cell: tuple[int, ...]
    measures: Mapping[str, float]
    layout: np.ndarray
    meaning: Meaning

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


def check_columns(columns: Columns, meaning: Meaning, source: str) -> None:
    """Refuse arrays that are no archive over these measures.

    Raises:
        InputError: a column is missing or of another length, or a cell lies outside.
    """
    missing = [name for name in COLUMNS if name not in columns]
    if missing:
        raise InputError(f"{source}: cannot be read (no archive: {missing[0]!r} is missing)")
    index, cells = columns["index"], int(np.prod([one.cells for one in meaning.measures]))
    alike = all(column.ndim and len(column) == len(index) for column in columns.values())
    inside = index.ndim == 1 and index.dtype.kind in "iu" and ((index >= 0) & (index < cells)).all()
    shapes = (columns["measures"].shape[1:], columns["objective"].ndim, columns["solution"].ndim)
    if not (alike and inside and shapes == ((len(meaning.measures),), 1, 2)):
        raise InputError(f"{source}: cannot be read (not over the measures of this run)")


class BestLayout(NamedTuple):
    """The layout of the best elite.

    Attributes:
        layout: int8 [H, W].
        marks: cells (row, column) that pictures name, like a maze's start and goal.
    """

    layout: np.ndarray
    marks: dict[str, tuple[int, int]]


def mark_cells(layout: np.ndarray, domain: Domain) -> dict[str, tuple[int, int]]:
    """Find the cells (row, column) that pictures of a layout (int8 [H, W]) name."""
    marks = domain.marks(layout) if domain.marks else {}
    return {
        name: (int(cell) // layout.shape[1], int(cell) % layout.shape[1])
        for name, cell in marks.items()
    }


def parse_best_layout(content: Mapping[str, Any], tiles: str, source: Path) -> BestLayout:
    """Read the content of best_layout.json.

    Raises:
        InputError: it is damaged; the line names `source`.
    """
    try:
        layout = parse(content["layout"], tiles)
        marks = {
            name: (int(row), int(column))
            for name, (row, column) in content.get("marks", {}).items()
        }
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise InputError(f"{source}: cannot be read ({error!r})") from error
    return BestLayout(layout, marks)
