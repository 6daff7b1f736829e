"""The log of a run: metrics.csv and notes.csv, a row for each iteration."""

from collections.abc import Mapping
from typing import SupportsFloat

from qdenv.training.metrics import Metrics
from qdenv.training.notes import NOTES, note_of, notes_until, write_notes
from qdenv.training.published import metrics_row
from qdenv.training.records import RunDirectory
from qdenv.types import Evaluation


class Log:
    """What a run has logged, with a row added after each iteration."""

    def __init__(self, run: RunDirectory, done: int) -> None:
        """Read the rows up to iteration `done`; later ones are run again, and written again."""
        self._run = run
        self._rows = [row for row in run.read_metrics(salvage=True) if row.iteration <= done]
        self._notes = notes_until(run.path / NOTES, done)
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
        self._run.write_metrics(self._rows)
        self._notes.append(note_of(done, batch, notes))
        write_notes(self._run.path / NOTES, self._notes)
        return self._rows[-1]
