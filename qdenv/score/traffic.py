"""Scores of simulated traffic over the runs of one layout."""

from __future__ import annotations

import math

from qdenv.lazy import chex, jax, jnp
from qdenv.types import InputError, Traffic

NORMAL_95 = 1.959964  # two-sided 95 % quantile of the normal distribution


def mean_throughput(runs: Traffic) -> jax.Array:
    """Average the throughput over *all* runs, congested ones too: the search's objective f_res.

    A run that congests ends early and counts with what it had finished, so a layout is paid for
    every run it spoils. Studies of single layouts report the mean of successful runs instead.

    Args:
        runs: `Traffic` with a leading axis S.

    Returns:
        float32, finished tasks per timestep.
    """
    chex.assert_rank(runs.throughput, 1)
    return jnp.asarray(runs.throughput).mean()


def wilson_interval(successes: int, runs: int) -> tuple[float, float]:
    """Bound a success rate with 95 % confidence; 0 and 1 get a width too.

    The score interval of Wilson 1927, "Probable inference, the law of succession, and statistical
    inference", https://doi.org/10.1080/01621459.1927.10502953.

    Raises:
        InputError: no runs.
    """
    if runs < 1:
        raise InputError("a success rate needs at least one run")
    rate, shrinkage = successes / runs, NORMAL_95**2 / runs
    centre = (rate + shrinkage / 2) / (1 + shrinkage)
    width = math.sqrt(rate * (1 - rate) * shrinkage + shrinkage**2 / 4) / (1 + shrinkage)
    return max(0.0, centre - width), min(1.0, centre + width)
