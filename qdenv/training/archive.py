"""The archive that a run saved: its elites, asked for by cell, by measures, or all as a table."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from qdenv.search.axes import inner_edges
from qdenv.training.elite import COLUMNS, Columns, Elite, best_row
from qdenv.training.manifest import Meaning
from qdenv.types import InputError

if TYPE_CHECKING:
    import pandas
    import ribs.archives


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
        from qdenv.plots.inline import archive_html

        index, objective = self.columns["index"], self.columns["objective"]
        picture = archive_html(index, objective, self.meaning.measures, self.meaning.objective)
        return f"<p>{self!r}</p>{picture}"
