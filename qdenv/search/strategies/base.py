"""The face of all evolution strategies, and the update rules they share."""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from qdenv.search.strategies.rates import Rates
from qdenv.types import Array

SMALLEST_STEP = 1e-11  # a search distribution narrower than this restarts (pyribs)
LARGEST_CONDITION = 1e14  # and so does one as lopsided as this


class Strategy(NamedTuple):
    """An evolution strategy as a record of functions on the state of one emitter.

    Attributes:
        init: (mean float [P], key) -> state; consumes the key.
        ask: (state, key) -> (solutions float [b, P], state); consumes the key.
        tell: (state, solutions [b, P], order int32 [b] best first, parents int32, evaluated
            int32) -> state. The first `parents` of the order are recombined, 0 to b.
        exhausted: state -> bool, the distribution is degenerate and must restart.
        refresh: applied before each ask to the states of all emitters at once (leading axis E);
            the place for work that is rarely due and must not hide inside a vmap.
    """

    init: Callable[[Array, Array], Any]
    ask: Callable[[Any, Array], tuple[Array, Any]]
    tell: Callable[[Any, Array, Array, Array, Array], Any]
    exhausted: Callable[[Any], Array]
    refresh: Callable[[Any], Any] = lambda states: states


def ranked_parents(solutions: Array, order: Array, parents: Array, filler: Array) -> jax.Array:
    """Sort rows [b, P] best first and replace all but the parents by `filler` [P].

    What a failed row holds, infinities included, never meets a zero weight.
    """
    chosen = jnp.arange(order.shape[0]) < parents
    return jnp.where(chosen[:, None], solutions[order], filler)


def follow_path(path: Array, step: Array, sigma: Array, rates: Rates) -> jax.Array:
    """Extend the step-size path [P] by the whitened `step` of the mean."""
    scale = jnp.sqrt(rates.path * (2 - rates.path) * rates.mu_eff) / sigma
    return (1 - rates.path) * path + scale * step


def adapt_step_size(sigma: Array, path: Array, rates: Rates) -> jax.Array:
    """Lengthen or shorten the step by the squared length of the path (pyribs' form)."""
    excess = jnp.square(path).sum() / path.shape[0] - 1
    return sigma * jnp.exp(jnp.minimum(1, rates.path / rates.damping * excess / 2))


def path_is_short(path: Array, evaluations: Array, batch: int, rates: Rates) -> jax.Array:
    """Decide h_sigma: False while the path is long, which stalls the covariance path."""
    dim = path.shape[0]
    decay = 1 - (1 - rates.path) ** (2 * evaluations / batch)
    return jnp.square(path).sum() / dim < (2 + 4 / (dim + 1)) * decay


def stretch_cov_path(path: Array, step: Array, short: Array, rates: Rates) -> jax.Array:
    """Extend the covariance path [P] by the `step` of the mean."""
    scale = jnp.sqrt(rates.cov_path * (2 - rates.cov_path) * rates.mu_eff)
    return (1 - rates.cov_path) * path + jnp.where(short, scale, 0) * step


def rank_one_decay(short: Array, rates: Rates) -> jax.Array:
    """Give how much of the covariance the rank-one term replaces (c_1a)."""
    lost = jnp.where(short, 0, rates.cov_path * (2 - rates.cov_path))
    return rates.rank_one * (1 - lost)


def degenerate(sigma: Array, eigenvalues: Array) -> jax.Array:
    """Tell whether N(., sigma^2 C) is too narrow, too lopsided or no distribution any more."""
    largest, smallest = eigenvalues.max(), eigenvalues.min()
    area = sigma * jnp.sqrt(largest)
    healthy = (largest / smallest <= LARGEST_CONDITION) & (area >= SMALLEST_STEP)
    return ~(healthy & jnp.isfinite(area))


def matmul(left: Array, right: Array) -> jax.Array:
    """Multiply matrices at full precision, also where the device would round to fewer bits."""
    return jnp.matmul(left, right, precision="highest")
