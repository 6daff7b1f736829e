"""sep-CMA-ES: a diagonal covariance matrix."""

from typing import NamedTuple

import jax
import jax.numpy as jnp

from qdenv.search.strategies.base import (
    Strategy,
    adapt_step_size,
    degenerate,
    follow_path,
    path_is_short,
    rank_one_decay,
    ranked_parents,
    stretch_cov_path,
)
from qdenv.search.strategies.rates import pick, rates_table, separable_rates
from qdenv.types import Array


class SeparableState(NamedTuple):
    """State of `separable` for one emitter."""

    mean: Array  # float [P]
    sigma: Array  # float
    path: Array  # float [P]
    evaluations: Array  # int32, successful ones since the last restart
    cov_path: Array  # float [P]
    variances: Array  # float [P], diagonal of the covariance matrix


def separable(dim: int, batch: int, sigma0: float) -> Strategy:
    """Make sep-CMA-ES with pyribs' rules and rates: a diagonal covariance, O(b P).

    As in pyribs the covariance path is not divided by sigma and the rank-one term carries its
    rate twice.
    """
    table = rates_table(batch, dim, separable_rates)

    def init(mean: Array, key: Array) -> SeparableState:
        zeros = jnp.zeros_like(mean)
        sigma = jnp.asarray(sigma0, mean.dtype)
        return SeparableState(mean, sigma, zeros, jnp.int32(0), zeros, jnp.ones_like(mean))

    def ask(state: SeparableState, key: Array) -> tuple[Array, SeparableState]:
        noise = jax.random.normal(key, (batch, dim), state.mean.dtype)
        return state.mean + state.sigma * jnp.sqrt(state.variances) * noise, state

    def tell(
        state: SeparableState, solutions: Array, order: Array, parents: Array, evaluated: Array
    ) -> SeparableState:
        rates = pick(table, parents)
        evaluations = state.evaluations + evaluated
        rows = ranked_parents(solutions, order, parents, state.mean)
        mean = (rates.weights[:, None] * rows).sum(axis=0)
        step = mean - state.mean
        path = follow_path(state.path, step / jnp.sqrt(state.variances), state.sigma, rates)
        short = path_is_short(path, evaluations, batch, rates)
        cov_path = stretch_cov_path(state.cov_path, step, short, rates)
        spread = (rates.weights[:, None] * jnp.square(rows - state.mean)).sum(axis=0)
        variances = (
            state.variances * (1 - rank_one_decay(short, rates) - rates.rank_mu)
            + rates.rank_one**2 * jnp.square(cov_path)
            + rates.rank_mu / state.sigma**2 * spread
        )
        sigma = adapt_step_size(state.sigma, path, rates)
        return SeparableState(mean, sigma, path, evaluations, cov_path, variances)

    def exhausted(state: SeparableState) -> jax.Array:
        return degenerate(state.sigma, state.variances)

    return Strategy(init, ask, tell, exhausted)
