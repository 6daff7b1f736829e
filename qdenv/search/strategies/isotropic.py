"""The isotropic strategy: one step size for all directions.

Numbers in brackets are equations of Hansen 2016, "The CMA evolution strategy: a tutorial",
https://arxiv.org/abs/1604.00772v1.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp

from qdenv.search.strategies.base import (
    SMALLEST_STEP,
    Strategy,
    adapt_step_size,
    follow_path,
    ranked_parents,
)
from qdenv.search.strategies.rates import full_rates, pick, rates_table


class IsotropicState(NamedTuple):
    """State of `isotropic` for one emitter."""

    mean: jax.Array  # float [P]
    sigma: jax.Array  # float
    path: jax.Array  # float [P]


def isotropic(dim: int, batch: int, sigma0: float) -> Strategy:
    """Make a strategy that samples N(mean, sigma^2 I) and adapts sigma by its path.

    Exactly what pyribs' CMA-ES does until its first eigendecomposition, which comes after
    `refresh_gap` evaluations of an emitter; at the paper's sizes that is the whole run. Costs
    O(b P) per iteration.
    """
    table = rates_table(batch, dim, full_rates)

    def init(mean: jax.Array, key: jax.Array) -> IsotropicState:
        return IsotropicState(mean, jnp.asarray(sigma0, mean.dtype), jnp.zeros_like(mean))

    def ask(state: IsotropicState, key: jax.Array) -> tuple[jax.Array, IsotropicState]:
        noise = jax.random.normal(key, (batch, dim), state.mean.dtype)
        return state.mean[None] + state.sigma * noise, state  # (38) to (40), C = I

    def tell(
        state: IsotropicState,
        solutions: jax.Array,
        order: jax.Array,
        parents: jax.Array,
        evaluated: jax.Array,
    ) -> IsotropicState:
        rates = pick(table, parents)
        rows = ranked_parents(solutions, order, parents, state.mean)
        mean = (rates.weights[:, None] * rows).sum(axis=0)  # (41) and (42)
        path = follow_path(state.path, mean - state.mean, state.sigma, rates)
        return IsotropicState(mean, adapt_step_size(state.sigma, path, rates), path)

    def exhausted(state: IsotropicState) -> jax.Array:
        return ~((state.sigma >= SMALLEST_STEP) & jnp.isfinite(state.sigma))

    return Strategy(init, ask, tell, exhausted)
