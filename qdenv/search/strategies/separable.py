"""sep-CMA-ES: a diagonal covariance matrix.

Ros and Hansen 2008, "A simple modification in CMA-ES achieving linear time and space complexity",
https://inria.hal.science/inria-00287367. Numbers in brackets are equations of Hansen's tutorial,
https://arxiv.org/abs/1604.00772v1.
"""

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


class SeparableState(NamedTuple):
    """State of `separable` for one emitter."""

    mean: jax.Array  # float [P]
    sigma: jax.Array  # float
    path: jax.Array  # float [P]
    evaluations: jax.Array  # int32, successful ones since the last restart
    cov_path: jax.Array  # float [P]
    variances: jax.Array  # float [P], diagonal of the covariance matrix


def separable(dim: int, batch: int, sigma0: float) -> Strategy:
    """Make sep-CMA-ES with pyribs' rules and rates: a diagonal covariance, O(b P).

    As in pyribs the covariance path is not divided by sigma and the rank-one term carries its
    rate twice.
    """
    table = rates_table(batch, dim, separable_rates)

    def init(mean: jax.Array, key: jax.Array) -> SeparableState:
        zeros = jnp.zeros_like(mean)
        sigma = jnp.asarray(sigma0, mean.dtype)
        return SeparableState(mean, sigma, zeros, jnp.int32(0), zeros, jnp.ones_like(mean))

    def ask(state: SeparableState, key: jax.Array) -> tuple[jax.Array, SeparableState]:
        noise = jax.random.normal(key, (batch, dim), state.mean.dtype)
        deviations = state.sigma * jnp.sqrt(state.variances)
        return state.mean[None] + deviations[None] * noise, state  # (38) to (40)

    def tell(
        state: SeparableState,
        solutions: jax.Array,
        order: jax.Array,
        parents: jax.Array,
        evaluated: jax.Array,
    ) -> SeparableState:
        rates = pick(table, parents)
        evaluations = state.evaluations + evaluated
        rows = ranked_parents(solutions, order, parents, state.mean)
        mean = (rates.weights[:, None] * rows).sum(axis=0)  # (41) and (42)
        step = mean - state.mean
        path = follow_path(state.path, step / jnp.sqrt(state.variances), state.sigma, rates)
        short = path_is_short(path, evaluations, batch, rates)
        cov_path = stretch_cov_path(state.cov_path, step, short, rates)
        # The diagonal of the rank-mu matrix is all that is ever computed: O(b P).
        rank_mu = (rates.weights[:, None] * jnp.square(rows - state.mean[None])).sum(axis=0)
        variances = (  # the diagonal of (47), the weights being positive
            state.variances * (1 - rank_one_decay(short, rates) - rates.rank_mu)
            + rates.rank_one**2 * jnp.square(cov_path)
            + rates.rank_mu / state.sigma**2 * rank_mu
        )
        sigma = adapt_step_size(state.sigma, path, rates)
        return SeparableState(mean, sigma, path, evaluations, cov_path, variances)

    def exhausted(state: SeparableState) -> jax.Array:
        return degenerate(state.sigma, state.variances)

    return Strategy(init, ask, tell, exhausted)
