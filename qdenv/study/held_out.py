"""What is predicted of elites that were held out: how a run's archive is split, and the figures."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from qdenv.domains.base import make_domain
from qdenv.run.directory import RunDirectory
from qdenv.types import InputError

HELD_OUT = 0.2  # share of the elites
FEWEST = 50  # elites; ten held out tell little, fewer tell nothing


@dataclass(frozen=True)
class Evaluated:
    """The elites of a run with what a true evaluation said of them."""

    cells: np.ndarray  # int [N, M], where each stands in the archive
    drawn: np.ndarray  # int8 [N, H, W], before the repair
    repaired: np.ndarray  # int8 [N, H, W]
    numbers: np.ndarray  # float32 [N, 1 + M], objective and measures
    names: tuple[str, ...]  # of the numbers
    units: str  # of the objective; empty where it has none
    kinds: int  # kinds of tile
    repairs: bool  # the domain repairs its layouts

    def __len__(self) -> int:
        """Count the elites."""
        return len(self.numbers)


class Skill(NamedTuple):
    """How well one number of held-out elites is predicted."""

    # share of the variance of the held-out elites that is explained: 1 is perfect, 0 no better than
    # their mean, below 0 worse; NaN where they do not vary
    r2: float
    rmse: float  # root mean squared error, in the number's own units
    rank: float  # Spearman's rank correlation; NaN where either side does not vary


def read_elites(run: RunDirectory) -> Evaluated:
    """Read what a surrogate can learn from a run's archive.

    Raises:
        InputError: nothing is saved yet, or there are fewer than 50 elites.
    """
    archive, domain = run.archive, make_domain(run.config.evaluation.domain)
    if len(archive) < FEWEST:
        cure = (
            "choose a run of your own"
            if run.shipped
            else f"continue the run with `qdenv resume {run} --evaluations N`"
        )
        raise InputError(
            f"{run}: a surrogate needs at least {FEWEST} elites, this archive has {len(archive)}: "
            + cure
        )
    columns = archive.columns
    objective, _, units = domain.objective_name.partition(" [")
    return Evaluated(
        cells=archive.cells,
        drawn=columns.get("unrepaired", columns["repaired"]),
        repaired=columns["repaired"],
        numbers=np.column_stack([columns["objective"], columns["measures"]]).astype(np.float32),
        names=(objective, *(axis.name for axis in archive.meaning.measures)),
        units=units.rstrip("]"),
        kinds=len(archive.meaning.tiles),
        repairs=domain.rules is not None,
    )


def split(count: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Split `count` elites at random; the same seed splits alike.

    Returns:
        the elites to learn from and those held out, a fifth (int [.] each, in order).
    """
    order = np.random.default_rng(seed).permutation(count)
    held = round(HELD_OUT * count)
    return np.sort(order[held:]), np.sort(order[:held])


def judge(predicted: np.ndarray, truth: np.ndarray) -> Skill:
    """Compare predictions with the truth, float [n] each, against the truth's own variance."""
    from scipy import stats  # here: takes half a second, and who is refused need not wait

    predicted, truth = predicted.astype(float), truth.astype(float)
    squared = np.square(predicted - truth).mean()
    varies = truth.max() > truth.min()
    r2 = 1 - squared / truth.var() if varies else float("nan")
    ranked = varies and predicted.max() > predicted.min()
    rank = stats.spearmanr(predicted, truth).statistic if ranked else float("nan")
    return Skill(float(r2), float(np.sqrt(squared)), float(rank))
