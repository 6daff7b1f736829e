"""Scores of simulated traffic: throughput, success, usage, over the runs of one layout."""

import math

import jax
import jax.numpy as jnp

from qdenv.types import Array, InputError, Traffic

NORMAL_95 = 1.959964  # two-sided 95 % quantile of the normal distribution


def mean_throughput(runs: Traffic) -> jax.Array:
    """Average finished tasks per timestep over all runs, congested ones too (f_res, float32).

    Args:
        runs: `Traffic` with a leading axis S.
    """
    return runs.throughput.mean()


def success_rate(runs: Traffic) -> jax.Array:
    """Share of the runs that never congested (float32 in [0, 1])."""
    return 1.0 - runs.congested.mean(dtype=jnp.float32)


def mean_usage(runs: Traffic) -> jax.Array:
    """Share of all agent-steps spent on each cell (float32 [H, W], sums to 1; Figure 19)."""
    return runs.usage.mean(axis=0)


def mean_finished(runs: Traffic) -> jax.Array:
    """Tasks finished at each timestep, averaged over the runs (float32 [T]; Figure 17)."""
    return runs.finished.mean(axis=0, dtype=jnp.float32)


def mean_waiting(runs: Traffic) -> Array:
    """Share of agent-steps without a move, averaged over the runs (float32)."""
    return runs.waiting.mean()


def wilson_interval(successes: int, runs: int) -> tuple[float, float]:
    """Bound a success rate with 95 % confidence (Wilson 1927); 0 and 1 get a width too.

    Raises:
        InputError: no runs.
    """
    if runs < 1:
        raise InputError("a success rate needs at least one run")
    rate, spread = successes / runs, NORMAL_95**2 / runs
    centre = (rate + spread / 2) / (1 + spread)
    width = math.sqrt(rate * (1 - rate) * spread + spread**2 / 4) / (1 + spread)
    return max(0.0, centre - width), min(1.0, centre + width)
