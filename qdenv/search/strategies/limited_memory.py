"""LM-MA-ES: a covariance matrix remembered as a few direction vectors.

Loshchilov, Glasmachers and Beyer 2017, "Limited-memory matrix adaptation for large scale black-box
optimization", https://arxiv.org/abs/1705.06693.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from qdenv.search.strategies.base import SMALLEST_STEP, Strategy, matmul, ranked_parents
from qdenv.search.strategies.rates import full_rates, pick, rates_table
from qdenv.types import InputError


class LimitedMemoryState(NamedTuple):
    """State of `limited_memory` for one emitter."""

    mean: jax.Array  # float [P]
    sigma: jax.Array  # float
    path: jax.Array  # float [P]
    generations: jax.Array  # int32, since the last restart
    memory: jax.Array  # float [b, P], directions of past steps
    noise: jax.Array  # float [b, P], the standard normal draws of the last ask


def bend(rows: jax.Array, memory: jax.Array, rates: jax.Array) -> jax.Array:
    """Stretch rows [b, P] along the vectors of `memory` [V, P], one after the other."""

    def along(rows: jax.Array, vector_rate: tuple[jax.Array, jax.Array]) -> tuple[jax.Array, None]:
        vector, rate = vector_rate
        projected = matmul(rows, vector)[:, None] * vector[None]
        return (1 - rate) * rows + rate * projected, None

    return jax.lax.scan(along, rows, (memory, rates))[0]


def memory_rates(dim: int, batch: int) -> tuple[np.ndarray, np.ndarray]:
    """Compute how far each of b vectors bends a draw (c_d) and how fast it learns (c_c).

    Each vector remembers four times as long as the one before it: together they span the
    directions of many generations in O(b P) numbers.
    """
    return 1 / (1.5 ** np.arange(batch) * dim), batch / (4.0 ** np.arange(batch) * dim)


def limited_memory(dim: int, batch: int, sigma0: float) -> Strategy:
    """Make LM-MA-ES with pyribs' rules (as many direction vectors as the batch), O(b^2 P).

    Raises:
        InputError: the batch is larger than the solution.
    """
    if batch > dim:
        raise InputError(
            f"the lm_ma strategy needs a batch of at most {dim} (the parameters), not {batch}"
        )
    table = rates_table(batch, dim, full_rates)
    path_rate = 2 * batch / dim  # c_sigma
    blend, memory_rate = memory_rates(dim, batch)

    def init(mean: jax.Array, key: jax.Array) -> LimitedMemoryState:
        blank = jnp.zeros((batch, dim), mean.dtype)
        sigma = jnp.asarray(sigma0, mean.dtype)
        return LimitedMemoryState(mean, sigma, jnp.zeros_like(mean), jnp.int32(0), blank, blank)

    def ask(state: LimitedMemoryState, key: jax.Array) -> tuple[jax.Array, LimitedMemoryState]:
        noise = jax.random.normal(key, (batch, dim), state.mean.dtype)
        # A vector counts from the generation in which it was first filled.
        used = jnp.arange(batch) < state.generations
        rates = jnp.where(used, jnp.asarray(blend, noise.dtype), 0)
        bent = bend(noise, state.memory, rates)
        return state.mean[None] + state.sigma * bent, state._replace(noise=noise)

    def tell(
        state: LimitedMemoryState,
        solutions: jax.Array,
        order: jax.Array,
        parents: jax.Array,
        evaluated: jax.Array,
    ) -> LimitedMemoryState:
        rates = pick(table, parents)
        some = parents > 0
        rows = ranked_parents(solutions, order, parents, state.mean)
        # The draws z rather than the solutions: they are white whatever the memory has learnt.
        draws = ranked_parents(state.noise, order, parents, jnp.zeros_like(state.mean))
        mean = (rates.weights[:, None] * rows).sum(axis=0)
        draw = (rates.weights[:, None] * draws).sum(axis=0)
        along = jnp.where(some, path_rate, 0)
        into = jnp.where(some, jnp.asarray(memory_rate, mean.dtype), 0)[:, None]
        path = (1 - along) * state.path + jnp.sqrt(rates.mu_eff * along * (2 - along)) * draw
        memory = (1 - into) * state.memory + jnp.sqrt(rates.mu_eff * into * (2 - into)) * draw[None]
        excess = jnp.square(path).sum() / dim - 1
        sigma = state.sigma * jnp.exp(along / 2 * excess)
        generations = state.generations + 1
        return LimitedMemoryState(mean, sigma, path, generations, memory, state.noise)

    def exhausted(state: LimitedMemoryState) -> jax.Array:
        return ~((state.sigma >= SMALLEST_STEP / 10) & jnp.isfinite(state.sigma))

    return Strategy(init, ask, tell, exhausted)
