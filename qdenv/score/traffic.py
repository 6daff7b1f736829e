"""Scores of simulated traffic: throughput, success, usage, over the runs of one layout."""

import jax
import jax.numpy as jnp

from qdenv.types import Array, Traffic


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
