"""Evolution strategies behind one face: isotropic, separable, full and limited-memory."""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from qdenv.search.recombination import (
    Rates,
    full_rates,
    pick,
    rates_row,
    rates_table,
    separable_rates,
)
from qdenv.types import Array, InputError

SMALLEST_STEP = 1e-11  # a search distribution narrower than this restarts (pyribs)
LARGEST_CONDITION = 1e14  # and so does one as lopsided as this


class Strategy(NamedTuple):
    """An evolution strategy as a record of functions on the state of one emitter.

    Attributes:
        init: mean float [P] -> state.
        ask: (state, key) -> (solutions float [b, P], state); consumes the key.
        tell: (state, solutions [b, P], order int32 [b] best first, parents int32, evaluated
            int32) -> state. The first `parents` of the order are recombined, 0 to b.
        exhausted: state -> bool, the distribution is degenerate and must restart.
        refresh: applied before each ask to the states of all emitters at once (leading axis E);
            the place for work that is rarely due and must not hide inside a vmap.
    """

    init: Callable[[Array], Any]
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


class IsotropicState(NamedTuple):
    """State of `isotropic` for one emitter."""

    mean: Array  # float [P]
    sigma: Array  # float
    path: Array  # float [P]


def isotropic(dim: int, batch: int, sigma0: float) -> Strategy:
    """Make a strategy that samples N(mean, sigma^2 I) and adapts sigma by its path.

    Exactly what pyribs' CMA-ES does until its first eigendecomposition, which comes after
    `refresh_gap` evaluations of an emitter; at the paper's sizes that is the whole run. Costs
    O(b P) per iteration.
    """
    table = rates_table(batch, dim, full_rates)

    def init(mean: Array) -> IsotropicState:
        return IsotropicState(mean, jnp.asarray(sigma0, mean.dtype), jnp.zeros_like(mean))

    def ask(state: IsotropicState, key: Array) -> tuple[Array, IsotropicState]:
        noise = jax.random.normal(key, (batch, dim), state.mean.dtype)
        return state.mean + state.sigma * noise, state

    def tell(
        state: IsotropicState, solutions: Array, order: Array, parents: Array, evaluated: Array
    ) -> IsotropicState:
        rates = pick(table, parents)
        rows = ranked_parents(solutions, order, parents, state.mean)
        mean = (rates.weights[:, None] * rows).sum(axis=0)
        path = follow_path(state.path, mean - state.mean, state.sigma, rates)
        return IsotropicState(mean, adapt_step_size(state.sigma, path, rates), path)

    def exhausted(state: IsotropicState) -> jax.Array:
        return ~((state.sigma >= SMALLEST_STEP) & jnp.isfinite(state.sigma))

    return Strategy(init, ask, tell, exhausted)


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

    def init(mean: Array) -> SeparableState:
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


class FullState(NamedTuple):
    """State of `full` for one emitter."""

    mean: Array  # float [P]
    sigma: Array  # float
    path: Array  # float [P]
    evaluations: Array  # int32, successful ones since the last restart
    cov_path: Array  # float [P]
    covariance: Array  # float [P, P]
    basis: Array  # float [P, P], eigenvectors of the covariance at the last refresh
    eigenvalues: Array  # float [P], at the last refresh
    refreshed: Array  # int32, `evaluations` at the last refresh


def refresh_gap(dim: int, batch: int) -> float:
    """Compute after how many evaluations of an emitter the eigensystem is due (pyribs)."""
    rates = rates_row(max(batch // 2, 1), batch, dim, full_rates)
    return 0.5 * batch / (dim * (rates.rank_one + rates.rank_mu))


def full(dim: int, batch: int, sigma0: float) -> Strategy:
    """Make CMA-ES with pyribs' rules: positive weights, eigendecomposition when it is due.

    Costs O(b P^2) per iteration and O(P^3) per refresh: for P up to some hundreds. Under a vmap
    over whole searches the refresh is computed at every ask (a branch under vmap becomes a
    select). As in pyribs the covariance path is not divided by sigma and the rank-one term
    carries its rate twice.
    """
    table = rates_table(batch, dim, full_rates)
    gap = np.float32(refresh_gap(dim, batch))

    def init(mean: Array) -> FullState:
        zeros, identity = jnp.zeros_like(mean), jnp.eye(dim, dtype=mean.dtype)
        sigma, never = jnp.asarray(sigma0, mean.dtype), jnp.int32(0)
        return FullState(
            mean, sigma, zeros, never, zeros, identity, identity, jnp.ones_like(mean), never
        )

    def ask(state: FullState, key: Array) -> tuple[Array, FullState]:
        noise = jax.random.normal(key, (batch, dim), state.mean.dtype)
        transform = state.basis * jnp.sqrt(state.eigenvalues)
        return state.mean + state.sigma * matmul(noise, transform.T), state

    def tell(
        state: FullState, solutions: Array, order: Array, parents: Array, evaluated: Array
    ) -> FullState:
        rates = pick(table, parents)
        evaluations = state.evaluations + evaluated
        rows = ranked_parents(solutions, order, parents, state.mean)
        mean = (rates.weights[:, None] * rows).sum(axis=0)
        step = mean - state.mean
        along = matmul(step, state.basis) / jnp.sqrt(state.eigenvalues)
        path = follow_path(state.path, matmul(state.basis, along), state.sigma, rates)
        short = path_is_short(path, evaluations, batch, rates)
        cov_path = stretch_cov_path(state.cov_path, step, short, rates)
        steps = rows - state.mean
        covariance = (
            state.covariance * (1 - rank_one_decay(short, rates) - rates.rank_mu)
            + rates.rank_one**2 * jnp.outer(cov_path, cov_path)
            + rates.rank_mu / state.sigma**2 * matmul((rates.weights[:, None] * steps).T, steps)
        )
        return state._replace(
            mean=mean,
            sigma=adapt_step_size(state.sigma, path, rates),
            path=path,
            evaluations=evaluations,
            cov_path=cov_path,
            covariance=covariance,
        )

    def due(state: FullState) -> jax.Array:
        return state.evaluations > state.refreshed + gap

    def exhausted(state: FullState) -> jax.Array:
        return degenerate(state.sigma, state.eigenvalues)

    def refresh(states: FullState) -> FullState:
        def one(state: FullState) -> FullState:
            return jax.lax.cond(due(state), decompose, lambda same: same, state)

        # Not a vmap: under it each branch would be taken and every ask would decompose.
        return jax.lax.cond(
            jax.vmap(due)(states).any(), lambda s: jax.lax.map(one, s), lambda s: s, states
        )

    return Strategy(init, ask, tell, exhausted, refresh)


def decompose(state: FullState) -> FullState:
    """Renew the eigensystem of the covariance matrix."""
    covariance = jnp.maximum(state.covariance, state.covariance.T)
    eigenvalues, basis = jnp.linalg.eigh(covariance)
    # Rounding may leave tiny negative values.
    eigenvalues = jnp.maximum(jnp.abs(eigenvalues), jnp.finfo(eigenvalues.dtype).tiny)
    return state._replace(
        covariance=covariance, basis=basis, eigenvalues=eigenvalues, refreshed=state.evaluations
    )


def matmul(left: Array, right: Array) -> jax.Array:
    """Multiply matrices at full precision, also where the device would round to fewer bits."""
    return jnp.matmul(left, right, precision="highest")


class LimitedMemoryState(NamedTuple):
    """State of `limited_memory` for one emitter."""

    mean: Array  # float [P]
    sigma: Array  # float
    path: Array  # float [P]
    generations: Array  # int32, since the last restart
    memory: Array  # float [b, P], directions of past steps
    noise: Array  # float [b, P], the standard normal draws of the last ask


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

    def init(mean: Array) -> LimitedMemoryState:
        blank = jnp.zeros((batch, dim), mean.dtype)
        sigma = jnp.asarray(sigma0, mean.dtype)
        return LimitedMemoryState(mean, sigma, jnp.zeros_like(mean), jnp.int32(0), blank, blank)

    def ask(state: LimitedMemoryState, key: Array) -> tuple[Array, LimitedMemoryState]:
        noise = jax.random.normal(key, (batch, dim), state.mean.dtype)
        return state.mean + state.sigma * transform(state, noise), state._replace(noise=noise)

    def transform(state: LimitedMemoryState, noise: Array) -> jax.Array:
        used = jnp.arange(batch) < state.generations
        rates = jnp.where(used, jnp.asarray(blend, noise.dtype), 0)

        def bend(rows: Array, vector_rate: tuple[Array, Array]) -> tuple[Array, None]:
            vector, rate = vector_rate
            along = matmul(rows, vector)[:, None] * vector
            return (1 - rate) * rows + rate * along, None

        return jax.lax.scan(bend, noise, (state.memory, rates))[0]

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


STRATEGIES: dict[str, Callable[[int, int, float], Strategy]] = {
    "iso": isotropic,
    "sep": separable,
    "full": full,
    "lm_ma": limited_memory,
}
