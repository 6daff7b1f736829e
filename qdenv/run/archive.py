"""The archive that a run saved: its elites by cell, by measures, or all as a table."""

import html
import io
import math
import operator
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, Self

import numpy as np

from qdenv.io.arrays import Column, read_arrays
from qdenv.io.files import damaged, write_atomically, write_csv
from qdenv.io.layouts import write_layout
from qdenv.search.axes import inner_edges
from qdenv.types import InputError, Measure, require_package, to_array

if TYPE_CHECKING:
    import pandas
    import ribs.archives

# Columns of every archive. Their numbers come from the search, which never stores one that is not
# finite: in a file, that is damage.
_COLUMNS = {
    "index": Column("iu", 1),
    "solution": Column("iuf", 2, finite=True),
    "objective": Column("iuf", 1, finite=True),
    "measures": Column("iuf", 2, finite=True),
}
# What that of a run may have beside the repaired layouts: those before the repair, and how each
# simulation ended.
_KNOWN = {"unrepaired": Column("iu", 3), "congested": Column("b", 2), "success": Column("b", 2)}
Columns = Mapping[str, np.ndarray]


class ArchiveSchema(NamedTuple):
    """What the columns of a run's archive mean, as manifest.json says beside other things."""

    measures: tuple[Measure, ...]  # the axes of the archive
    tiles: str  # the alphabet of the layouts
    tile_names: Mapping[str, str] = {}  # what pictures call the tiles, by their symbols
    objective: str = "objective"  # what is maximised, with its unit
    # the column that chooses among elites of equal objective; None for none
    tie_break: str | None = None


class Elite(NamedTuple):
    """One filled cell of a run's archive."""

    solution: np.ndarray  # float32 [P], the parameters of the generator
    objective: float  # what the search maximised
    cell: tuple[int, ...]  # index along each measure
    measures: Mapping[str, float]  # value of each measure, by its name
    layout: np.ndarray  # int8 [H, W], repaired, as it was simulated
    schema: ArchiveSchema  # of the archive; `ArchiveSchema.tiles` is the alphabet of the layout
    unrepaired: np.ndarray  # int8 [H, W], as it was drawn; without cells where that is not saved

    def __repr__(self) -> str:
        """Show its cell and its values, without the parameters."""
        cell = ",".join(map(str, self.cell))
        values = "".join(f", {name} {value:.4g}" for name, value in self.measures.items())
        return f"Elite(cell {cell}, objective {self.objective:.4g}{values})"

    def _repr_html_(self) -> str:
        """Draw the layout under the numbers, for notebooks."""
        # Here: matplotlib takes half a second to import.
        from qdenv.view.layouts import layout_html

        schema = self.schema
        picture = layout_html(self.layout, schema.tiles, schema.tile_names)
        return f"<p>{html.escape(repr(self))}</p>{picture}"


def best_row(columns: Columns, tie_break: str | None) -> int:
    """Find the row of the best elite of an archive that is not empty.

    `tie_break` names the column that decides among equals: a number, or several per elite, whose
    mean counts; the larger is better.
    """
    objective = columns["objective"]
    best = np.flatnonzero(objective == objective.max())
    if tie_break is None or tie_break not in columns:
        return int(best[0])
    worth = columns[tie_break].astype(np.float64).reshape(len(objective), -1).mean(axis=1)
    return int(best[np.argmax(worth[best])])


@dataclass(frozen=True, repr=False)
class SavedArchive:
    """The filled cells of the result archive of a run."""

    columns: Columns  # arrays [n, ...] of n elites by name, as in archive.npz
    schema: ArchiveSchema  # what the columns mean
    source: str  # the run, for messages
    # cells of named elites; one that is named "best" is the best, whatever its objective
    names: Mapping[str, tuple[int, ...]] = field(default_factory=dict)

    @classmethod
    def read(
        cls, path: Path, schema: ArchiveSchema, source: str, names: Mapping[str, tuple[int, ...]]
    ) -> Self:
        """Read a file like archive.npz at `path`, whose columns mean what `schema` says.

        `source` is the run, for messages; `names` are the cells of named elites. Raises InputError
        if it is no archive over these measures: a column is missing or of another length, a cell
        lies outside, or a tile means nothing.
        """
        columns = read_arrays(path, _COLUMNS | {"repaired": Column("iu", 3)}, Column(), _KNOWN)
        index, cells = columns["index"], math.prod(one.cells for one in schema.measures)
        alike = all(column.ndim and len(column) == len(index) for column in columns.values())
        inside = ((index >= 0) & (index < cells)).all() and len(np.unique(index)) == len(index)
        if not (alike and inside and columns["measures"].shape[1] == len(schema.measures)):
            raise damaged(path, "not over the measures of this run")
        if len(index) and not all(column.size for column in columns.values()):
            raise damaged(path, "a column holds nothing")
        for name in columns.keys() & {"repaired", "unrepaired"}:
            layouts, tiles = columns[name], len(schema.tiles)
            if layouts.size and not 0 <= layouts.min() <= layouts.max() < tiles:
                raise damaged(path, f"{name} holds tiles that this run does not know")
            if layouts.shape != columns["repaired"].shape:
                raise damaged(path, f"{name} has another size than repaired")
        return cls(columns, schema, source, names)

    def __len__(self) -> int:
        """Count the elites."""
        return len(self.columns["index"])

    @property
    def shape(self) -> tuple[int, ...]:
        """Cells along each measure."""
        return tuple(measure.cells for measure in self.schema.measures)

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
        return self.elite("best")

    def elite(
        self, which: str | Sequence[int] = "best", measures: Sequence[float] | None = None
    ) -> Elite:
        """Find an elite by `which`: "best" or another name, or a cell, "12,40" or (12, 40).

        `measures` give, in its place, a value for each measure: the elite of their cell, or else
        the nearest one, where every axis counts as equally long. Raises InputError if there is no
        elite at all or none in that cell, or the request is malformed.
        """
        if len(self) == 0:
            raise InputError(f"{self.source}: the archive is empty, no solution succeeded yet")
        if measures is not None:
            return self._elite(self._nearest(measures))
        if isinstance(which, str) and which in self.names:
            which = self.names[which]
        if isinstance(which, str) and which == "best":
            return self._elite(best_row(self.columns, self.schema.tie_break))
        try:
            parts: Any = map(int, which.split(",")) if isinstance(which, str) else which
            cell = tuple(map(operator.index, parts))
            number = np.ravel_multi_index(cell, self.shape)
        except (ValueError, TypeError, OverflowError) as error:
            text = which if isinstance(which, str) else str(which).strip("()[]")
            known = " or ".join(f'"{name}"' for name in self.names or ("best",))
            indices = f'indices below {self.shape} like "3,7"'
            raise InputError(f"elite {text!r}: give {known} or {indices}") from error
        rows = np.flatnonzero(self.columns["index"] == number)
        if len(rows) == 0:
            distance = np.abs(self.cells - np.array(cell)).sum(axis=1)
            hint = ",".join(map(str, self.cells[np.argmin(distance)]))
            text = ",".join(map(str, cell))
            raise InputError(f"elite '{text}': this cell is empty, the nearest elite is {hint}")
        return self._elite(int(rows[0]))

    def _nearest(self, values: Sequence[float]) -> int:
        """Find the row of the elite at some measures, or nearest to them."""
        axes = self.schema.measures
        own = [*values.values()] if isinstance(values, Mapping) else values
        point = to_array(own, float).reshape(-1)
        if point.shape != (len(axes),) or not np.isfinite(point).all():
            names = ", ".join(repr(axis.name) for axis in axes)
            raise InputError(f"measures {values}: give a number for each of {names}")
        # In single precision, as the search assigned its elites to cells.
        along = [
            np.searchsorted(inner_edges(axis, np.dtype(np.float32)), np.float32(value), "right")
            for axis, value in zip(axes, point, strict=True)
        ]
        inside = np.flatnonzero(self.columns["index"] == np.ravel_multi_index(along, self.shape))
        if len(inside):
            return int(inside[0])
        spans = np.array([axis.high - axis.low for axis in axes])
        return int(np.argmin((((self.columns["measures"] - point) / spans) ** 2).sum(axis=1)))

    def _elite(self, row: int) -> Elite:
        names = [measure.name for measure in self.schema.measures]
        values = self.columns["measures"][row].astype(float).tolist()
        # None of them in a search of mere numbers.
        layouts = [self.columns.get(name) for name in ("repaired", "unrepaired")]
        nothing = np.zeros((0, 0), np.int8)
        repaired, unrepaired = (nothing if one is None else one[row] for one in layouts)
        solution, objective = self.columns["solution"][row], float(self.columns["objective"][row])
        cell, measures = tuple(self.cells[row].tolist()), dict(zip(names, values, strict=True))
        return Elite(solution, objective, cell, measures, repaired, self.schema, unrepaired)

    def elites(self) -> Iterator[Elite]:
        """Iterate over all elites, in the order of the columns."""
        return map(self._elite, range(len(self)))

    def table(self, solutions: bool = False) -> dict[str, np.ndarray]:
        """Return the elites as columns of numbers and text, without their layouts.

        ``cell`` (like "12,40", as `elite` takes it), ``objective``, each measure by its name, then
        what is saved beside the elites: one column per number, ``throughput_0`` and so on where
        there is one per simulation; with `solutions` also ``solution_0`` and so on. Each is [n].
        """
        columns: dict[str, np.ndarray] = {
            "cell": np.array([",".join(map(str, cell)) for cell in self.cells], dtype=object),
            "objective": self.columns["objective"],
        }
        for number, measure in enumerate(self.schema.measures):
            columns[measure.name] = self.columns["measures"][:, number]
        others = [name for name in self.columns if name not in _COLUMNS]
        for name in [*others, *(["solution"] if solutions else [])]:
            values = self.columns[name]
            if values.ndim == 1:
                columns[name] = values
            elif values.ndim == 2:
                columns |= {f"{name}_{i}": values[:, i] for i in range(values.shape[1])}
        return columns

    def to_pandas(self, solutions: bool = False) -> "pandas.DataFrame":
        """Make a pandas data frame of `table`, with the `solutions` if so.

        Raises InputError if pandas is not installed.
        """
        require_package("tables", "pandas", "data")
        import pandas

        return pandas.DataFrame(self.table(solutions))

    def write_table(self, path: Path, solutions: bool = False) -> None:
        """Write `table` at `path`, with the `solutions` if so: .parquet if it ends so, else CSV.

        Raises InputError if the place cannot be written to, or pyarrow is not installed.
        """
        path = Path(path)
        if path.suffix.lower() != ".parquet":
            table = self.table(solutions)
            # As numpy's numbers: Python's would show digits that single precision does not hold.
            write_csv(path, list(table), zip(*table.values(), strict=True))
            return
        require_package(".parquet files", "pyarrow", "data")
        content = io.BytesIO()
        self.to_pandas(solutions).to_parquet(content, index=False)
        write_atomically(path, content.getvalue())

    def write_layouts(self, folder: Path, domain: str) -> None:
        """Write each elite's layout into `folder`, as 12_40.json of the domain called `domain`."""
        for elite in self.elites():
            details = {"objective": elite.objective, "measures": dict(elite.measures)}
            path = Path(folder) / f"{'_'.join(map(str, elite.cell))}.json"
            write_layout(path, elite.layout, self.schema.tiles, domain=domain, **details)

    def to_ribs(self, fields: Sequence[str] = ()) -> "ribs.archives.GridArchive":
        """Make the same archive for pyribs; `InputError` if that is not installed.

        Its extra fields are the columns with one number for each elite, and those named in
        `fields`, like "repaired": pyribs makes no table of layouts.
        """
        require_package("pyribs' archives", "ribs", "pyribs")
        from ribs.archives import GridArchive

        extras = {
            name: values
            for name, values in self.columns.items()
            if name not in (*_COLUMNS, "threshold") and (values.ndim == 1 or name in fields)
        }
        archive: Any = GridArchive(
            solution_dim=self.columns["solution"].shape[1],
            dims=self.shape,
            ranges=[(measure.low, measure.high) for measure in self.schema.measures],
            extra_fields={
                name: (values.shape[1:], values.dtype) for name, values in extras.items()
            },
        )
        if len(self):
            archive.add(*(self.columns[name] for name in _COLUMNS if name != "index"), **extras)
        return archive

    def __repr__(self) -> str:
        """Show the numbers of the archive."""
        best = f", best {self.best.objective:.4g}" if len(self) else ""
        return (
            f"SavedArchive({len(self)} elites, coverage {self.coverage:.1%}, "
            f"QD-score {self.qd_score:.4g}{best})"
        )

    def _repr_html_(self) -> str:
        """Draw the heat map under the numbers, for notebooks."""
        # Here: matplotlib takes half a second to import.
        from qdenv.view.archive import archive_html

        picture = archive_html(self.columns, self.schema.measures, self.schema.objective)
        return f"<p>{html.escape(repr(self))}</p>{picture}"
