"""LM-MA-ES: a covariance matrix remembered as a few direction vectors."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from qdenv.search.strategies.base import SMALLEST_STEP, Strategy, matmul, ranked_parents
from qdenv.search.strategies.rates import full_rates, pick, rates_table
from qdenv.types import Array, InputError


class LimitedMemoryState(NamedTuple):
    """State of `limited_memory` for one emitter."""

    mean: Array  # float [P]
    sigma: Array  # float
    path: Array  # float [P]
    generations: Array  # int32, since the last restart
    memory: Array  # float [b, P], directions of past steps
    noise: Array  # float [b, P], the standard normal draws of the last ask


def bend(rows: Array, memory: Array, rates: Array) -> jax.Array:
    """Stretch rows [b, P] along the vectors of `memory` [V, P], one after the other."""

    def along(rows: Array, vector_rate: tuple[Array, Array]) -> tuple[Array, None]:
        vector, rate = vector_rate
        projected = matmul(rows, vector)[:, None] * vector
        return (1 - rate) * rows + rate * projected, None

    return jax.lax.scan(along, rows, (memory, rates))[0]


def limited_memory(dim: int, batch: int, sigma0: float) -> Strategy:
    """Make LM-MA-ES with pyribs' rules (as many direction vectors as the batch), O(b^2 P).

    Source: Loshchilov, Glasmachers and Beyer 2019.

    Raises:
        InputError: the batch is larger than the solution.
    """
    if batch > dim:
        raise InputError(
            f"the lm_ma strategy needs a batch of at most {dim} (the parameters), not {batch}"
        )
    table = rates_table(batch, dim, full_rates)
    path_rate = 2 * batch / dim
    blend = 1 / (1.5 ** np.arange(batch) * dim)
    memory_rate = batch / (4.0 ** np.arange(batch) * dim)

    def init(mean: Array, key: Array) -> LimitedMemoryState:
        blank = jnp.zeros((batch, dim), mean.dtype)
        sigma = jnp.asarray(sigma0, mean.dtype)
        return LimitedMemoryState(mean, sigma, jnp.zeros_like(mean), jnp.int32(0), blank, blank)

    def ask(state: LimitedMemoryState, key: Array) -> tuple[Array, LimitedMemoryState]:
        noise = jax.random.normal(key, (batch, dim), state.mean.dtype)
        used = jnp.arange(batch) < state.generations
        rates = jnp.where(used, jnp.asarray(blend, noise.dtype), 0)
        bent = bend(noise, state.memory, rates)
        return state.mean + state.sigma * bent, state._replace(noise=noise)

    def tell(
        state: LimitedMemoryState, solutions: Array, order: Array, parents: Array, evaluated: Array
    ) -> LimitedMemoryState:
        rates = pick(table, parents)
        some = parents > 0
        rows = ranked_parents(solutions, order, parents, state.mean)
        draws = ranked_parents(state.noise, order, parents, jnp.zeros_like(state.mean))
        mean = (rates.weights[:, None] * rows).sum(axis=0)
        draw = (rates.weights[:, None] * draws).sum(axis=0)
        along = jnp.where(some, path_rate, 0)
        into = jnp.where(some, jnp.asarray(memory_rate, mean.dtype), 0)[:, None]
        path = (1 - along) * state.path + jnp.sqrt(rates.mu_eff * along * (2 - along)) * draw
        memory = (1 - into) * state.memory + jnp.sqrt(rates.mu_eff * into * (2 - into)) * draw
        excess = jnp.square(path).sum() / dim - 1
        return LimitedMemoryState(
            mean=mean,
            sigma=state.sigma * jnp.exp(along / 2 * excess),
            path=path,
            generations=state.generations + 1,
            memory=memory,
            noise=state.noise,
        )

    def exhausted(state: LimitedMemoryState) -> jax.Array:
        return ~((state.sigma >= SMALLEST_STEP / 10) & jnp.isfinite(state.sigma))

    return Strategy(init, ask, tell, exhausted)
