"""metrics.csv: one row per iteration of a run."""

import logging
import math
from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple, SupportsFloat

import numpy as np

from qdenv.io.files import damaged, write_csv
from qdenv.io.tables import parse_cell, read_rows, read_table
from qdenv.types import Evaluation, InputError, RepairStatus

METRICS = "metrics.csv"
NOTES = "notes.csv"
INFINITE = ("best_objective",)  # of a search without success


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


def read_metrics(path: Path, salvage: bool = False) -> list[Metrics]:
    """Read metrics.csv; columns that an older qdenv did not write take their defaults.

    Args:
        path: the file.
        salvage: keep the rows before the damage and say so, in place of refusing all.

    Raises:
        InputError: the file is missing or damaged.
    """
    rows = []
    try:
        for row in read_table(path, Metrics, INFINITE):
            rows.append(row)
    except InputError as error:
        if not salvage:
            raise
        LOG.warning("%s: what follows row %d is lost", error, len(rows))
    return rows


PLACE = {"iteration", "evaluations"}  # columns of every note
LOG = logging.getLogger(__name__)
Note = dict[str, float]  # numbers by name; NaN where there was nothing to say


def note_of(iteration: int, batch: int, said: Mapping[str, SupportsFloat]) -> Note:
    """Write an iteration's note, with what to plot it over."""
    place = {"iteration": float(iteration), "evaluations": float(iteration * batch)}
    return place | {name: float(value) for name, value in said.items()}


def write_notes(path: Path, notes: list[Note]) -> None:
    """Replace notes.csv; an algorithm that says nothing has no such file."""
    if not notes or len(notes[0]) <= 2:
        return
    rows = [
        ["" if math.isnan(value) else f"{value:g}" for value in note.values()] for note in notes
    ]
    write_csv(path, list(notes[0]), rows)


def read_notes(path: Path) -> list[Note]:
    """Read notes.csv; nothing where there is none.

    Raises:
        InputError: the file is damaged.
    """
    if not path.exists():
        return []
    notes = []
    for number, row in enumerate(read_rows(path), start=1):
        if not row.keys() >= PLACE:
            raise damaged(path, f"one of the columns {', '.join(sorted(PLACE))} is missing")
        try:
            notes.append({name: _number(text) for name, text in row.items()})
        except ValueError as error:
            raise damaged(path, f"row {number}: {error}") from error
    return notes


def _number(text: str) -> float:
    return parse_cell(text, float, infinite=True) if text else math.nan


def notes_until(path: Path, iteration: int) -> list[Note]:
    """Read the notes up to an iteration; damaged ones are lost, which is said and stops no run."""
    try:
        return [note for note in read_notes(path) if note["iteration"] <= iteration]
    except InputError as error:
        LOG.warning("%s: the notes so far are lost", error)
        return []


def metrics_row(
    iteration: int, batch: int, summary: list[float], seconds: float, evaluation: Evaluation
) -> Metrics:
    """Write an iteration's row: what the archive is worth, and what failed on the way there."""
    qd_score, coverage, best = summary
    failed = np.asarray(evaluation.status) >= RepairStatus.IMPOSSIBLE
    # A simulator whose runs cannot congest has no such field.
    congested = getattr(evaluation.runs, "congested", np.zeros(0, bool))
    return Metrics(
        iteration,
        iteration * batch,
        qd_score,
        coverage,
        best,
        seconds,
        failed_repairs=int(failed.sum()),
        congested_runs=int(np.asarray(congested).sum()),
    )


class Log:
    """What a run has logged, with a row added after each iteration."""

    def __init__(self, path: Path, done: int) -> None:
        """Read the rows up to iteration `done`; later ones are run again, and written again."""
        self._path = path
        self._rows = [
            row for row in read_metrics(path / METRICS, salvage=True) if row.iteration <= done
        ]
        self._notes = notes_until(path / NOTES, done)
        self._seconds = self._rows[-1].seconds if self._rows else 0.0

    def add(
        self,
        done: int,
        batch: int,
        summary: list[float],
        seconds: float,
        evaluation: Evaluation,
        notes: Mapping[str, SupportsFloat],
    ) -> Metrics:
        """Write the row of an iteration.

        Args:
            done: number of the iteration.
            batch: evaluations of each.
            summary: QD-score, coverage and best objective.
            seconds: that it took.
            evaluation: of its solutions.
            notes: what the algorithm says of itself.
        """
        self._seconds += seconds
        self._rows.append(metrics_row(done, batch, summary, round(self._seconds, 3), evaluation))
        write_csv(self._path / METRICS, Metrics._fields, self._rows)
        self._notes.append(note_of(done, batch, notes))
        write_notes(self._path / NOTES, self._notes)
        return self._rows[-1]
