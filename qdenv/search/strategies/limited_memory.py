"""LM-MA-ES: a covariance matrix remembered as a few direction vectors.

Loshchilov, Glasmachers and Beyer 2017, "Limited-memory matrix adaptation for large scale black-box
optimization", https://arxiv.org/abs/1705.06693.
"""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct

from qdenv.search.strategies.base import (
    SMALLEST_STEP,
    Params,
    RankedBatch,
    Strategy,
    StrategyState,
    matmul,
    ranked_parents,
)
from qdenv.types import InputError


@struct.dataclass
class LimitedMemoryState(StrategyState):
    """State of `LimitedMemory`."""

    generations: jax.Array  # int32, since the last restart
    memory: jax.Array  # float [b, P], directions of past steps
    noise: jax.Array  # float [b, P], the standard normal draws of the last ask


class LimitedMemory(Strategy):
    """LM-MA-ES with pyribs' rules (as many direction vectors as the batch), O(b^2 P)."""

    def __init__(self, population_size: int, solution: Any, **settings: Any) -> None:
        """Compute the rates; raise InputError if the batch is larger than the solution."""
        super().__init__(population_size, solution, **settings)
        batch, dim = population_size, self.num_dims
        if batch > dim:
            raise InputError(
                f"the lm_ma strategy needs a batch of at most {dim} (the parameters), not {batch}"
            )
        self.path_rate = 2 * batch / dim  # c_sigma
        # How far each of the b vectors bends a draw (c_d), and how fast it learns (c_c): each
        # remembers four times as long as the one before it, so that together they span the
        # directions of many generations in O(b P) numbers.
        self.bend_rates = 1 / (1.5 ** np.arange(batch) * dim)
        self.memory_rates = batch / (4.0 ** np.arange(batch) * dim)

    def _init(self, key: jax.Array, params: Params) -> LimitedMemoryState:
        blank = jnp.zeros((self.population_size, self.num_dims), self.solution_flat.dtype)
        return LimitedMemoryState(
            **self._init_fields(params), generations=jnp.int32(0), memory=blank, noise=blank
        )

    def _ask(self, key: jax.Array, state: Any, params: Params) -> tuple[jax.Array, Any]:
        noise = self._draw_noise(key, state)
        # A vector counts from the generation in which it was first filled.
        used = jnp.arange(self.population_size) < state.generations
        rates = jnp.where(used, jnp.asarray(self.bend_rates, noise.dtype), 0)

        def bend(rows: jax.Array, vector_rate: tuple) -> tuple[jax.Array, None]:
            vector, rate = vector_rate
            projected = matmul(rows, vector)[:, None] * vector[None]
            return (1 - rate) * rows + rate * projected, None

        # Stretched along the vectors of the memory, one after the other.
        bent = jax.lax.scan(bend, noise, (state.memory, rates))[0]
        return state.mean[None] + state.std * bent, state.replace(noise=noise)

    def _update(self, state: Any, batch: RankedBatch) -> Any:
        rates, mean, some = batch.rates, batch.mean, batch.parents > 0
        # The draws z rather than the solutions: they are white whatever the memory has learnt.
        blank = jnp.zeros_like(state.mean)
        draws = ranked_parents(state.noise, batch.order, batch.parents, blank)
        draw = (rates.weights[:, None] * draws).sum(axis=0)
        along = jnp.where(some, self.path_rate, 0)
        into = jnp.where(some, jnp.asarray(self.memory_rates, mean.dtype), 0)[:, None]
        p_std = (1 - along) * state.p_std + jnp.sqrt(rates.mu_eff * along * (2 - along)) * draw
        memory = (1 - into) * state.memory + jnp.sqrt(rates.mu_eff * into * (2 - into)) * draw[None]
        excess = jnp.square(p_std).sum() / self.num_dims - 1
        return state.replace(
            mean=mean,
            std=state.std * jnp.exp(along / 2 * excess),
            p_std=p_std,
            generations=state.generations + 1,
            memory=memory,
        )

    def is_degenerate(self, state: LimitedMemoryState) -> jax.Array:
        """Return True if the distribution is too narrow to search on (pyribs), or not finite."""
        return ~((state.std >= SMALLEST_STEP / 10) & jnp.isfinite(state.std))
