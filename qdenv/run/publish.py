"""What a running search writes besides its log: checkpoints, its archive, its best layout."""

import time
from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp

from qdenv.domains.base import Domain
from qdenv.io.layouts import write_layout
from qdenv.run.archive import best_row, mark_cells
from qdenv.run.directory import RunDirectory
from qdenv.run.evaluate_async import Search
from qdenv.search.base import Algorithm
from qdenv.search.export import collector
from qdenv.types import Measure

_SAVING_SHARE = 0.03  # of a run's time, for checkpoints beyond those that its settings ask for
_LONGEST = 240.0  # seconds without a checkpoint, whatever it costs: no more is ever lost


class Publisher:
    """Writes a search into its run directory."""

    def __init__(
        self, run: RunDirectory, domain: Domain, measures: Sequence[Measure], algorithm: Algorithm
    ) -> None:
        """Compile nothing yet."""
        self._run, self._domain, self._measures = run, domain, measures
        self.saved = 0  # iteration after which this process has saved the search
        self._spent, self._last = 0.0, 0.0
        self._begun = self._since = time.perf_counter()
        self._collect = collector(algorithm)
        self._summarise = jax.jit(lambda state: _summary(algorithm, state))

    def summary(self, search: Search) -> tuple[float, float, float]:
        """Compute QD-score, coverage and best objective, and wait for them."""
        qd_score, filled, cells, best = map(float, self._summarise(search.state))
        return qd_score, filled / cells, best

    @property
    def has_time(self) -> bool:
        """Whether saving would stay a small share of the time, or has waited too long."""
        now = time.perf_counter()
        cheap = self._spent + self._last <= _SAVING_SHARE * (now - self._begun)
        return cheap or now - self._since > _LONGEST

    def save(self, iteration: int, search: Search, settings: dict[str, Any]) -> None:
        """Write a checkpoint, then the archive and its best layout."""
        begun = time.perf_counter()
        self._run.save_checkpoint(iteration, search, settings)
        self.publish(search)
        self._since = time.perf_counter()
        self._last = self._since - begun
        self.saved, self._spent = iteration, self._spent + self._last

    def publish(self, search: Search) -> None:
        """Write the archive and its best layout."""
        archive = self._collect(search.state)
        self._run.save_archive(archive)
        if len(archive["index"]) == 0:
            return
        row = best_row(archive, self._domain.tie_break)
        layout = archive["repaired"][row]
        measures = zip(self._measures, archive["measures"][row], strict=True)
        details = {
            **self._domain.details,
            "objective": float(archive["objective"][row]),
            "measures": {measure.name: float(value) for measure, value in measures},
            "similarity": float(archive["similarity"][row]),
        }
        if self._domain.marks is not None:
            cells = mark_cells(layout, self._domain)
            details["marks"] = {name: list(cell) for name, cell in cells.items()}
        path = self._run.path / "best_layout.json"
        write_layout(path, layout, self._domain.tiles, **details)


def _summary(algorithm: Algorithm, state: Any) -> tuple[jax.Array, jax.Array, int, jax.Array]:
    """Compute QD-score, filled cells, all cells and best objective of the result archive."""
    archive = algorithm.archive(state)
    best = jnp.where(archive.filled.any(), archive.objectives.max(), 0.0)
    return archive.qd_score(), archive.filled.sum(), archive.filled.size, best
