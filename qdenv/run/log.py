"""The log of a run, by iteration: metrics.csv, and notes.csv with the algorithm's own numbers."""

import logging
import math
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import NamedTuple, SupportsFloat, TypeVar

import numpy as np

from qdenv.io.files import damaged, write_csv
from qdenv.io.tables import parse_cell, read_rows, read_table
from qdenv.types import Evaluation, InputError, RepairStatus

METRICS, NOTES = "metrics.csv", "notes.csv"
_LOG = logging.getLogger(__name__)
Note = dict[str, float]  # numbers by name, like a surrogate's losses; NaN where there is none
T = TypeVar("T")


class Metrics(NamedTuple):
    """One row of metrics.csv: the search after an iteration."""

    iteration: int
    evaluations: int
    qd_score: float
    coverage: float
    best_objective: float
    seconds: float  # wall clock, summed over interruptions
    failed_repairs: int = 0  # of this iteration's layouts, those without a feasible repair
    congested_runs: int = 0  # of this iteration's simulations

    def __str__(self) -> str:
        """Show how the search stands."""
        best = f"best {self.best_objective:.3f}"
        return f"QD-score {self.qd_score:.1f}, coverage {self.coverage:.1%}, {best}"


def read_metrics(path: Path, salvage: bool = False) -> list[Metrics]:
    """Read metrics.csv; missing columns that have defaults take them.

    With `salvage`, the rows before a damage are returned and it is logged, in place of an error.
    """
    # Without a success there is no best objective: it is infinite.
    return _collect(read_table(path, Metrics, ("best_objective",)), salvage)


def read_notes(path: Path, salvage: bool = False) -> list[Note]:
    """Read notes.csv as `read_metrics` does; an algorithm without notes has no such file."""
    return _collect(_iterate_notes(path), salvage) if path.exists() else []


def _iterate_notes(path: Path) -> Iterator[Note]:
    for number, row in enumerate(read_rows(path), start=1):
        if not row.keys() >= {"iteration", "evaluations"}:
            raise damaged(path, "one of the columns evaluations, iteration is missing")
        try:
            yield {
                name: parse_cell(text, float, infinite=True) if text else math.nan
                for name, text in row.items()
            }
        except ValueError as error:
            raise damaged(path, f"row {number}: {error}") from error


def _collect(rows: Iterable[T], salvage: bool) -> list[T]:
    collected = []
    try:
        for row in rows:  # one by one: those before the damage count
            collected.append(row)
    except InputError as error:
        if not salvage:
            raise
        _LOG.warning("%s: what follows row %d is lost", error, len(collected))
    return collected


class Log:
    """The log of a run that goes on."""

    def __init__(self, path: Path, done: int) -> None:
        """Read the rows up to iteration `done`; later iterations are repeated."""
        self._path = path
        metrics = read_metrics(path / METRICS, salvage=True)
        self._rows = [row for row in metrics if row.iteration <= done]
        notes = read_notes(path / NOTES, salvage=True)
        self._notes = [note for note in notes if note["iteration"] <= done]
        self._seconds = self._rows[-1].seconds if self._rows else 0.0

    def add(
        self,
        evaluations: int,
        summary: tuple[float, float, float],
        seconds: float,
        evaluation: Evaluation,
        notes: Mapping[str, SupportsFloat],
    ) -> Metrics:
        """Write the rows of an iteration that took `seconds`, after `evaluations` in all.

        `summary` is QD-score, coverage and best objective, `notes` the algorithm's own numbers.
        """
        self._seconds += seconds
        failed = np.asarray(evaluation.status) >= RepairStatus.IMPOSSIBLE
        done = evaluations // len(failed)
        # A simulator whose runs cannot congest has no such field.
        congested = np.asarray(getattr(evaluation.runs, "congested", False))
        counts = int(failed.sum()), int(congested.sum())
        row = Metrics(done, evaluations, *summary, round(self._seconds, 3), *counts)
        self._rows.append(row)
        write_csv(self._path / METRICS, Metrics._fields, self._rows)
        place = {"iteration": float(done), "evaluations": float(evaluations)}
        self._notes.append(place | {name: float(value) for name, value in notes.items()})
        if notes:
            table = [  # six digits: the numbers come from single precision
                ["" if math.isnan(value) else f"{value:g}" for value in note.values()]
                for note in self._notes
            ]
            write_csv(self._path / NOTES, list(self._notes[0]), table)
        return row
