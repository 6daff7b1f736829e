"""Means of independent runs with their errors, shares with their intervals, and differences."""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from qdenv.types import InputError

_QUANTILE = 0.975  # of a two-sided 95 % interval
_NORMAL_95 = 1.959964  # that quantile of the normal distribution


class Difference(NamedTuple):
    """A mean against another one, in per cent of the latter."""

    percent: float  # how much higher it is
    low: float  # lower end of the 95 % interval; NaN where it has none
    high: float  # upper end
    significant: bool  # the interval excludes 0

    def __str__(self) -> str:
        """Write it with its interval: +5.2 % (+3.7 to +7.0)."""
        return f"{self.percent:+.1f} % ({self.low:+.1f} to {self.high:+.1f})"


class Sample(NamedTuple):
    """The mean of independent runs."""

    mean: float  # of them
    error: float  # standard error of the mean; NaN for one run
    runs: int  # how many


def standard_error(values: ArrayLike) -> np.ndarray:
    """Return the standard error of the mean over the first axis; NaN for one value."""
    array = np.asarray(values, float)
    if len(array) < 2:
        return np.full(array.shape[1:], np.nan)
    return array.std(axis=0, ddof=1) / np.sqrt(len(array))


def sample_of(values: np.ndarray) -> Sample:
    """Return mean and standard error of values [n] of independent runs."""
    return Sample(float(np.mean(values, dtype=float)), float(standard_error(values)), len(values))


def margin(sample: Sample) -> float:
    """Return half the width of the mean's 95 % interval (Student's t); NaN for one run."""
    from scipy.special import stdtrit  # late: it takes 0.2 s, and --help does not need it

    return float(stdtrit(sample.runs - 1, _QUANTILE)) * sample.error if sample.runs > 1 else np.nan


def difference(ours: Sample, theirs: Sample) -> Difference:
    """Compare two means of independent runs: the first in per cent of the second.

    The runs of two layouts share seeds, but a seed means other starts and goals on another layout:
    nothing is paired. The ratio has Fieller's interval (1954, "Some problems in interval
    estimation") with unequal variances and Welch's degrees of freedom (1947,
    https://doi.org/10.2307/2332510), so that it excludes 0 % exactly where Welch's t-test finds the
    means different.

    There is no interval if either mean has fewer than two runs, or if `theirs` may well be 0.
    """
    parts = np.square([ours.error, theirs.error])
    with np.errstate(all="ignore"):  # unused where an error is unknown, or both are 0
        freedom = parts.sum() ** 2 / (parts**2 / [ours.runs - 1, theirs.runs - 1]).sum()
    return _ratio(ours.mean, theirs.mean, np.diag(parts), freedom)


def paired_difference(ours: ArrayLike, theirs: ArrayLike) -> Difference:
    """Compare the means of runs in pairs (float [n] each): the first in per cent of the second.

    A pair shares its seed, so that what chance does to both alike drops out: two planners on one
    layout have the same starts and goals. Fieller's interval as in `difference`, with the
    covariance of the means and n - 1 degrees of freedom: it excludes 0 % exactly where the paired
    t-test finds the means different.
    """
    both = np.array([ours, theirs], float)
    runs = both.shape[1]
    parts = np.cov(both) / runs if runs > 1 else np.full((2, 2), np.nan)
    own, other = both.mean(axis=1)
    return _ratio(own, other, parts, runs - 1)


def _ratio(ours: float, theirs: float, parts: np.ndarray, freedom: float) -> Difference:
    """Bound a ratio of means by Fieller's interval; `parts` [2, 2] is their covariance."""
    from scipy.special import stdtrit  # late, as in `margin`

    if theirs == 0:
        return Difference(np.nan, np.nan, np.nan, False)
    percent = float(100 * (ours / theirs - 1))
    if np.isnan(parts).any():
        return Difference(percent, np.nan, np.nan, False)
    if not parts.any():
        return Difference(percent, percent, percent, bool(percent))
    spread = stdtrit(freedom, _QUANTILE) ** 2 * parts
    # |ours - ratio * theirs| is within t standard errors: a quadratic in the ratio.
    a, b = theirs**2 - spread[1, 1], 2 * (spread[0, 1] - ours * theirs)
    if a <= 0:
        return Difference(percent, np.nan, np.nan, False)
    # Of equal runs it is 0, but for rounding.
    root = np.sqrt(max(b**2 - 4 * a * (ours**2 - spread[0, 0]), 0.0))
    low, high = (float(100 * ((-b + sign * root) / (2 * a) - 1)) for sign in (-1, 1))
    return Difference(percent, low, high, low > 0 or high < 0)


def wilson_interval(successes: int, runs: int) -> tuple[float, float]:
    """Bound a success rate with 95 % confidence; 0 and 1 get a width too.

    The score interval of Wilson 1927, "Probable inference, the law of succession, and statistical
    inference", https://doi.org/10.1080/01621459.1927.10502953.
    """
    if runs < 1:
        raise InputError("a success rate needs at least one run")
    rate, shrinkage = successes / runs, _NORMAL_95**2 / runs
    centre = (rate + shrinkage / 2) / (1 + shrinkage)
    width = math.sqrt(rate * (1 - rate) * shrinkage + shrinkage**2 / 4) / (1 + shrinkage)
    return max(0.0, centre - width), min(1.0, centre + width)
