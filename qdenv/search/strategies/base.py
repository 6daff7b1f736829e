"""The face of all evolution strategies, and the update rules they share.

Numbers in brackets are equations of Hansen 2016, "The CMA evolution strategy: a tutorial",
https://arxiv.org/abs/1604.00772v1.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import chex
import jax
import jax.numpy as jnp

from qdenv.search.strategies.rates import Rates

SMALLEST_STEP = 1e-11  # a search distribution narrower than this restarts (pyribs)
LARGEST_CONDITION = 1e14  # so does one whose covariance has a larger condition number


class Strategy(NamedTuple):
    """An evolution strategy as a record of functions on the state of one emitter."""

    init: Callable[[jax.Array, jax.Array], Any]  # (mean float [P], key) -> state; consumes the key
    # (state, key) -> (solutions float [b, P], state); consumes the key
    ask: Callable[[Any, jax.Array], tuple[jax.Array, Any]]
    # (state, solutions [b, P], order int32 [b] best first, parents int32, evaluated int32) ->
    # state. The first `parents` of the order are recombined, 0 to b.
    tell: Callable[[Any, jax.Array, jax.Array, jax.Array, jax.Array], Any]
    # state -> bool, the distribution is degenerate and must restart
    exhausted: Callable[[Any], jax.Array]
    # applied before each ask to the states of all emitters at once (leading axis E); the place for
    # work that is rarely due and must not hide inside a vmap
    refresh: Callable[[Any], Any] = lambda states: states


def ranked_parents(
    solutions: jax.Array, order: jax.Array, parents: jax.Array, filler: jax.Array
) -> jax.Array:
    """Sort rows [b, P] best first and replace all but the parents by `filler` [P].

    What a failed row holds, infinities included, never meets a zero weight: 0 * inf is NaN.
    """
    chex.assert_shape(order, solutions.shape[:1])
    chosen = jnp.arange(order.shape[0]) < parents
    return jnp.where(chosen[:, None], solutions[order], filler)


def follow_path(
    path: jax.Array, step: jax.Array, sigma: jax.Array, rates: Rates[jax.Array]
) -> jax.Array:
    """Extend the step-size path p_sigma [P] by the whitened `step` of the mean (43)."""
    scale = jnp.sqrt(rates.path * (2 - rates.path) * rates.mu_eff) / sigma
    return (1 - rates.path) * path + scale * step


def adapt_step_size(sigma: jax.Array, path: jax.Array, rates: Rates[jax.Array]) -> jax.Array:
    """Lengthen or shorten the step size by the length of the path, cumulative adaptation (44).

    As pyribs: the squared length against its expectation P, with the exponent capped at 1, where
    the tutorial compares the length with E||N(0, I)||.
    """
    excess = jnp.square(path).sum() / path.shape[0] - 1
    return sigma * jnp.exp(jnp.minimum(1, rates.path / rates.damping * excess / 2))


def path_is_short(
    path: jax.Array, evaluations: jax.Array, batch: int, rates: Rates[jax.Array]
) -> jax.Array:
    """Decide h_sigma of the tutorial's (45): False while the path is long.

    A long path says that the step size is far too small; the covariance must not grow meanwhile.
    As pyribs: squared lengths, and evaluations in place of generations.
    """
    dim = path.shape[0]
    decay = 1 - (1 - rates.path) ** (2 * evaluations / batch)
    return jnp.square(path).sum() / dim < (2 + 4 / (dim + 1)) * decay


def stretch_cov_path(
    path: jax.Array, step: jax.Array, short: jax.Array, rates: Rates[jax.Array]
) -> jax.Array:
    """Extend the covariance path p_c [P] by the `step` of the mean (45), undivided as in pyribs."""
    scale = jnp.sqrt(rates.cov_path * (2 - rates.cov_path) * rates.mu_eff)
    return (1 - rates.cov_path) * path + jnp.where(short, scale, 0) * step


def rank_one_decay(short: jax.Array, rates: Rates[jax.Array]) -> jax.Array:
    """Give how much of the covariance the rank-one term replaces, c_1 (1 - delta(h_sigma)) (47).

    While h_sigma stalls the path, the variance that it misses stays in the matrix.
    """
    lost = jnp.where(short, 0, rates.cov_path * (2 - rates.cov_path))
    return rates.rank_one * (1 - lost)


def degenerate(sigma: jax.Array, eigenvalues: jax.Array) -> jax.Array:
    """Tell whether N(., sigma^2 C) is too narrow, too lopsided or no distribution any more."""
    largest, smallest = eigenvalues.max(), eigenvalues.min()
    area = sigma * jnp.sqrt(largest)
    healthy = (largest / smallest <= LARGEST_CONDITION) & (area >= SMALLEST_STEP)
    return ~(healthy & jnp.isfinite(area))


def matmul(left: jax.Array, right: jax.Array) -> jax.Array:
    """Multiply matrices at full precision, also where the device would round to fewer bits."""
    return jnp.matmul(left, right, precision="highest")
