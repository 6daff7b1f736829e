"""How far two judges agree on the same layouts: correlations of ranks, and the mean ratio."""

import warnings
from typing import NamedTuple

import numpy as np
from scipy import stats

from qdenv.stats import sample_of

RESAMPLES = 2000  # of the layouts, for an interval
FEWEST = 3  # layouts that a correlation takes


class Correlation(NamedTuple):
    """A rank correlation over layouts."""

    value: float  # of them; NaN with fewer than three layouts, or where a judge tells none apart
    low: float  # lower end of its 95 % bootstrap interval over layouts; NaN where it has none
    high: float  # upper end


class Agreement(NamedTuple):
    """How far two judges agree."""

    layouts: int  # how many both judged
    spearman: Correlation  # rank correlation
    kendall: Correlation  # the correlation tau-b of the order of pairs
    ratio: float  # mean of what the one says over what the other says, where that is above 0
    ratio_error: float  # its standard error


def agree(ours: np.ndarray, theirs: np.ndarray, seed: int = 0) -> Agreement:
    """Compare two judges of the same layouts (float [layouts] each)."""
    moved = theirs > 0
    ratio = sample_of(ours[moved] / theirs[moved] if moved.any() else np.array([np.nan]))
    return Agreement(
        layouts=len(ours),
        spearman=correlate("spearman", ours, theirs, seed),
        kendall=correlate("kendall", ours, theirs, seed),
        ratio=ratio.mean,
        ratio_error=ratio.error,
    )


def correlate(kind: str, ours: np.ndarray, theirs: np.ndarray, seed: int = 0) -> Correlation:
    """Correlate the ranks that two judges give.

    The interval is bias-corrected and accelerated (Efron 1987, "Better bootstrap confidence
    intervals", https://doi.org/10.1080/01621459.1987.10478410); `kind`: "spearman" or "kendall".
    """
    if len(ours) < FEWEST:
        return Correlation(np.nan, np.nan, np.nan)
    measure = {"spearman": stats.spearmanr, "kendall": stats.kendalltau}[kind]

    def statistic(ours: np.ndarray, theirs: np.ndarray) -> float:
        return float(measure(ours, theirs).statistic)

    with warnings.catch_warnings():  # a resample of equal layouts has no correlation
        warnings.simplefilter("ignore")
        ends = stats.bootstrap(
            (ours, theirs),
            statistic,
            n_resamples=RESAMPLES,
            paired=True,
            vectorized=False,
            random_state=np.random.default_rng(seed),
        ).confidence_interval
        return Correlation(statistic(ours, theirs), float(ends.low), float(ends.high))
