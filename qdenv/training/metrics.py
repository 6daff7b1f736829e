"""metrics.csv: one row per iteration of a run."""

import logging
from pathlib import Path
from typing import NamedTuple

from qdenv.io.tables import read_table
from qdenv.types import InputError

INFINITE = ("best_objective",)  # of a search without success
LOG = logging.getLogger(__name__)


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
