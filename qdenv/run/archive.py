"""The archive that a run saved: its elites by cell, by measures, or all as a table."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from qdenv.domains.base import Domain
from qdenv.grid import parse
from qdenv.io.arrays import Column, read_arrays
from qdenv.io.files import damaged
from qdenv.io.records import read_json
from qdenv.run.manifest import Meaning
from qdenv.search.axes import inner_edges
from qdenv.types import InputError

if TYPE_CHECKING:
    import pandas
    import ribs.archives
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
        from qdenv.view.notebook import layout_html

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


@dataclass(frozen=True, repr=False)
class Archive:
    """The filled cells of the result archive of a run."""

    columns: Columns  # arrays with one row per elite, as in archive.npz
    meaning: Meaning  # what they mean
    source: str  # how messages call the run
    # cells of elites that have names; "best" among them is the best, whatever it is worth to the
    # search
    names: Mapping[str, tuple[int, ...]] = field(default_factory=dict)

    def __len__(self) -> int:
        """Count the elites."""
        return len(self.columns["index"])

    @property
    def shape(self) -> tuple[int, ...]:
        """Cells along each measure."""
        return tuple(measure.cells for measure in self.meaning.measures)

    @property
    def qd_score(self) -> float:
        """Sum of the objectives of all elites."""
        return float(self.columns["objective"].sum(dtype=float))

    @property
    def coverage(self) -> float:
        """Share of the cells that are filled."""
        return len(self) / int(np.prod(self.shape))

    @property
    def cells(self) -> np.ndarray:
        """Index of each elite along each measure (int [elites, M])."""
        return np.stack(np.unravel_index(self.columns["index"], self.shape), axis=-1)

    @property
    def best(self) -> Elite:
        """The elite of the largest objective, or the one that is named so."""
        self._demand_elites()
        if "best" in self.names:
            return self.elite(self.names["best"])
        return self._elite(best_row(self.columns, self.meaning.tie_break))

    def elite(
        self, which: str | Sequence[int] = "best", measures: Sequence[float] | None = None
    ) -> Elite:
        """Find an elite.

        Args:
            which: "best" or another name, or a cell: "12,40" or (12, 40).
            measures: a value for each measure, in place of `which`: the elite of the cell they
                fall into, or else the nearest one, where every axis is as long as the others.

        Raises:
            InputError: there is no elite at all or none in that cell, or the question is none.
        """
        self._demand_elites()
        if measures is not None:
            return self._elite(self._nearest(measures))
        if isinstance(which, str) and which == "best":
            return self.best
        if isinstance(which, str) and which in self.names:
            return self.elite(self.names[which])
        try:
            parts = which.split(",") if isinstance(which, str) else which
            cell = tuple(int(part) for part in parts)
            number = np.ravel_multi_index(cell, self.shape)
        except (ValueError, TypeError) as error:
            text = which if isinstance(which, str) else str(which).strip("()[]")
            known = " or ".join(f'"{name}"' for name in self.names or ("best",))
            raise InputError(
                f'elite {text!r}: give {known} or indices below {self.shape} like "3,7"'
            ) from error
        rows = np.flatnonzero(self.columns["index"] == number)
        if len(rows) == 0:
            distance = np.abs(self.cells - np.array(cell)).sum(axis=1)
            hint = ",".join(map(str, self.cells[np.argmin(distance)]))
            said = ",".join(map(str, cell))
            raise InputError(f"elite '{said}': this cell is empty, the nearest elite is {hint}")
        return self._elite(int(rows[0]))

    def _nearest(self, wanted: Sequence[float]) -> int:
        """Find the row of the elite at some measures, or nearest to them."""
        axes = self.meaning.measures
        point = np.asarray(wanted, float).reshape(-1)
        if point.shape != (len(axes),) or not np.isfinite(point).all():
            names = ", ".join(repr(axis.name) for axis in axes)
            raise InputError(f"measures {wanted}: give a number for each of {names}")
        along = [
            np.searchsorted(inner_edges(axis, np.dtype(np.float32)), np.float32(value), "right")
            for axis, value in zip(axes, point, strict=True)
        ]
        inside = np.flatnonzero(self.columns["index"] == np.ravel_multi_index(along, self.shape))
        if len(inside):
            return int(inside[0])
        spans = np.array([axis.high - axis.low for axis in axes])
        return int(np.argmin((((self.columns["measures"] - point) / spans) ** 2).sum(axis=1)))

    def _demand_elites(self) -> None:
        if len(self) == 0:
            raise InputError(f"{self.source}: the archive is empty, no solution succeeded yet")

    def _elite(self, row: int) -> Elite:
        names = [measure.name for measure in self.meaning.measures]
        values = self.columns["measures"][row]
        return Elite(
            self.columns["solution"][row],
            float(self.columns["objective"][row]),
            tuple(int(index) for index in self.cells[row]),
            {name: float(value) for name, value in zip(names, values, strict=True)},
            self.columns["repaired"][row],
            self.meaning,
        )

    def table(self, solutions: bool = False) -> dict[str, np.ndarray]:
        """List the elites as columns of plain numbers and words.

        Args:
            solutions: include the parameters, ``solution_0`` and so on.

        Returns:
            ``cell`` (like "12,40", as `elite` takes it), ``objective``, each measure by its name,
            then what was kept beside the elites: one column per number, ``throughput_0`` and so on
            where there is one per simulation. Layouts have no place in a table.
        """
        columns: dict[str, np.ndarray] = {
            "cell": np.array([",".join(map(str, cell)) for cell in self.cells], dtype=object),
            "objective": self.columns["objective"],
        }
        for number, measure in enumerate(self.meaning.measures):
            columns[measure.name] = self.columns["measures"][:, number]
        others = [name for name in self.columns if name not in COLUMNS]
        for name in [*others, *(["solution"] if solutions else [])]:
            values = self.columns[name]
            if values.ndim == 1:
                columns[name] = values
            elif values.ndim == 2:
                columns |= {f"{name}_{i}": values[:, i] for i in range(values.shape[1])}
        return columns

    def to_pandas(self, solutions: bool = False) -> "pandas.DataFrame":
        """Make a pandas data frame of `table`, one row per elite.

        Raises:
            InputError: pandas is not installed.
        """
        try:
            import pandas
        except ImportError as error:
            raise InputError("tables need pandas: pip install 'qdenv[data]'") from error
        return pandas.DataFrame(self.table(solutions))

    def to_ribs(self) -> "ribs.archives.GridArchive":
        """Make the same archive for pyribs, with its own names of fields.

        Raises:
            InputError: pyribs is not installed.
        """
        try:
            from ribs.archives import GridArchive
        except ImportError as error:
            raise InputError("this needs pyribs: pip install 'qdenv[pyribs]'") from error
        extras = {
            name: values
            for name, values in self.columns.items()
            if name not in (*COLUMNS, "threshold")
        }
        archive: Any = GridArchive(
            solution_dim=self.columns["solution"].shape[1],
            dims=self.shape,
            ranges=[(measure.low, measure.high) for measure in self.meaning.measures],
            extra_fields={
                name: (values.shape[1:], values.dtype) for name, values in extras.items()
            },
        )
        if len(self):
            archive.add(*(self.columns[name] for name in COLUMNS if name != "index"), **extras)
        return archive

    def __repr__(self) -> str:
        """Say how much was found."""
        best = f", best {self.best.objective:.4g}" if len(self) else ""
        return (
            f"Archive({len(self)} elites, coverage {self.coverage:.1%}, "
            f"QD-score {self.qd_score:.4g}{best})"
        )

    def _repr_html_(self) -> str:
        """Draw the heat map under the numbers, for notebooks."""
        # Only here: matplotlib takes half a second to import.
        from qdenv.view.notebook import archive_html

        index, objective = self.columns["index"], self.columns["objective"]
        picture = archive_html(index, objective, self.meaning.measures, self.meaning.objective)
        return f"<p>{self!r}</p>{picture}"
