"""How much two layouts differ in throughput, and how sure that is."""

from typing import NamedTuple

import numpy as np

SURE = 0.975  # quantile of a two-sided 95 % interval


class Difference(NamedTuple):
    """A mean against another one, in per cent of the latter."""

    percent: float  # how much higher it is
    low: float  # lower end of the 95 % interval; NaN where it has none
    high: float  # upper end
    significant: bool  # the interval excludes 0


class Sample(NamedTuple):
    """The mean of independent runs."""

    mean: float  # of them
    error: float  # standard error of the mean; NaN for one run
    runs: int  # how many


def sample_of(values: np.ndarray) -> Sample:
    """Condense values [n] of independent runs."""
    values = np.asarray(values, float)
    error = values.std(ddof=1) / np.sqrt(len(values)) if len(values) > 1 else np.nan
    return Sample(float(values.mean()), float(error), len(values))


def margin(sample: Sample) -> float:
    """Bound a mean by Student's t: half the width of its 95 % interval, NaN for one run."""
    from scipy.special import stdtrit  # here: who only reads about a command need not wait for it

    return float(stdtrit(sample.runs - 1, SURE)) * sample.error if sample.runs > 1 else np.nan


def difference(ours: Sample, theirs: Sample) -> Difference:
    """Bound the ratio of two means of independent runs.

    The runs of two layouts share seeds, but a seed means other starts and goals on another layout:
    nothing is paired. The ratio has Fieller's interval (1954, "Some problems in interval
    estimation") with unequal variances and Welch's degrees of freedom (1947,
    https://doi.org/10.2307/2332510), so that it excludes 0 % just where Welch's t-test finds the
    means different.

    Args:
        ours: the mean that is asked about.
        theirs: the mean it is compared with.

    Returns:
        without interval where a side has fewer than two runs, or where `theirs` is so uncertain
        that its mean might be 0.
    """
    from scipy.special import stdtrit  # here: who only reads about a command need not wait for it

    nan = float("nan")
    if theirs.mean == 0:
        return Difference(nan, nan, nan, False)
    percent = 100 * (ours.mean / theirs.mean - 1)
    parts = np.square([ours.error, theirs.error])
    if np.isnan(parts).any():
        return Difference(percent, nan, nan, False)
    if not parts.any():
        return Difference(percent, percent, percent, bool(percent))
    freedom = parts.sum() ** 2 / (parts**2 / [ours.runs - 1, theirs.runs - 1]).sum()
    spread = stdtrit(freedom, SURE) ** 2 * parts
    # |ours - ratio * theirs| is within t standard errors: a quadratic in the ratio.
    a, b = theirs.mean**2 - spread[1], -2 * ours.mean * theirs.mean
    if a <= 0:
        return Difference(percent, nan, nan, False)
    root = np.sqrt(b**2 - 4 * a * (ours.mean**2 - spread[0]))
    low, high = (float(100 * ((-b + sign * root) / (2 * a) - 1)) for sign in (-1, 1))
    return Difference(percent, low, high, low > 0 or high < 0)
