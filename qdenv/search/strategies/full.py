"""CMA-ES with a full covariance matrix, decomposed when it is due.

Numbers in brackets are equations of Hansen 2016, "The CMA evolution strategy: a tutorial",
https://arxiv.org/abs/1604.00772v1.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from qdenv.search.strategies.base import (
    Strategy,
    adapt_step_size,
    degenerate,
    follow_path,
    matmul,
    path_is_short,
    rank_one_decay,
    ranked_parents,
    stretch_cov_path,
)
from qdenv.search.strategies.rates import Rates, full_rates, pick, rates_row, rates_table


class FullState(NamedTuple):
    """State of `full` for one emitter."""

    mean: jax.Array  # float [P]
    sigma: jax.Array  # float
    path: jax.Array  # float [P]
    evaluations: jax.Array  # int32, successful ones since the last restart
    cov_path: jax.Array  # float [P]
    covariance: jax.Array  # float [P, P]
    basis: jax.Array  # float [P, P], eigenvectors of the covariance at the last refresh
    eigenvalues: jax.Array  # float [P], at the last refresh
    refreshed: jax.Array  # int32, `evaluations` at the last refresh


def refresh_gap(dim: int, batch: int) -> float:
    """Compute after how many evaluations of an emitter the eigensystem is due (pyribs).

    The matrix hardly changes in fewer; the tutorial counts generations instead
    (section on numerical effort).
    """
    rates = rates_row(max(batch // 2, 1), batch, dim, full_rates)
    return float(0.5 * batch / (dim * (rates.rank_one + rates.rank_mu)))


def full(dim: int, batch: int, sigma0: float) -> Strategy:
    """Make CMA-ES with pyribs' rules: positive weights, eigendecomposition when it is due.

    Costs O(b P^2) per iteration and O(P^3) per refresh: for P up to some hundreds. Under a vmap
    over whole searches the refresh is computed at every ask (a branch under vmap becomes a
    select). As in pyribs the covariance path is not divided by sigma and the rank-one term
    carries its rate twice.
    """
    table = rates_table(batch, dim, full_rates)
    gap = np.float32(refresh_gap(dim, batch))

    def init(mean: jax.Array, key: jax.Array) -> FullState:
        zeros, identity = jnp.zeros_like(mean), jnp.eye(dim, dtype=mean.dtype)
        sigma, never = jnp.asarray(sigma0, mean.dtype), jnp.int32(0)
        return FullState(
            mean, sigma, zeros, never, zeros, identity, identity, jnp.ones_like(mean), never
        )

    def ask(state: FullState, key: jax.Array) -> tuple[jax.Array, FullState]:
        noise = jax.random.normal(key, (batch, dim), state.mean.dtype)
        transform = state.basis * jnp.sqrt(state.eigenvalues)[None]
        return state.mean[None] + state.sigma * matmul(noise, transform.T), state  # (38) to (40)

    def tell(
        state: FullState,
        solutions: jax.Array,
        order: jax.Array,
        parents: jax.Array,
        evaluated: jax.Array,
    ) -> FullState:
        rates = pick(table, parents)
        evaluations = state.evaluations + evaluated
        rows = ranked_parents(solutions, order, parents, state.mean)
        mean = (rates.weights[:, None] * rows).sum(axis=0)  # (41) and (42)
        step = mean - state.mean
        # C^(-1/2) step by way of the eigenbasis, in which the root is a division.
        along = matmul(step, state.basis) / jnp.sqrt(state.eigenvalues)
        path = follow_path(state.path, matmul(state.basis, along), state.sigma, rates)
        short = path_is_short(path, evaluations, batch, rates)
        cov_path = stretch_cov_path(state.cov_path, step, short, rates)
        return state._replace(
            mean=mean,
            sigma=adapt_step_size(state.sigma, path, rates),
            path=path,
            evaluations=evaluations,
            cov_path=cov_path,
            covariance=adapt_covariance(state, cov_path, rows - state.mean[None], short, rates),
        )

    def exhausted(state: FullState) -> jax.Array:
        return degenerate(state.sigma, state.eigenvalues)

    return Strategy(init, ask, tell, exhausted, lambda states: refresh(states, gap))


def adapt_covariance(
    state: FullState,
    cov_path: jax.Array,
    steps: jax.Array,
    short: jax.Array,
    rates: Rates[jax.Array],
) -> jax.Array:
    """Mix the covariance matrix with its rank-one and rank-mu terms (47), the weights positive.

    Args:
        state: before this generation.
        cov_path: float [P], after it.
        steps: float [b, P], parents minus the old mean, best first.
        short: h_sigma.
        rates: for this number of parents.
    """
    return (
        state.covariance * (1 - rank_one_decay(short, rates) - rates.rank_mu)
        + rates.rank_one**2 * jnp.outer(cov_path, cov_path)
        + rates.rank_mu / state.sigma**2 * matmul((rates.weights[:, None] * steps).T, steps)
    )


def refresh(states: FullState, gap: np.float32) -> FullState:
    """Renew the eigensystems that are due, of emitters with a leading axis E."""

    def due(state: FullState) -> jax.Array:
        return state.evaluations > state.refreshed + gap

    def one(state: FullState) -> FullState:
        return jax.lax.cond(due(state), decompose, lambda same: same, state)

    # Not a vmap: under it each branch would be taken and every ask would decompose.
    return jax.lax.cond(
        jax.vmap(due)(states).any(), lambda s: jax.lax.map(one, s), lambda s: s, states
    )


def decompose(state: FullState) -> FullState:
    """Renew the eigensystem of the covariance matrix."""
    # Products of rounded numbers are not quite symmetric; pyribs takes the larger of each pair.
    covariance = jnp.maximum(state.covariance, state.covariance.T)
    eigenvalues, basis = jnp.linalg.eigh(covariance, symmetrize_input=False)
    # Rounding may leave tiny negative values, of which there is no root.
    eigenvalues = jnp.maximum(jnp.abs(eigenvalues), jnp.finfo(eigenvalues.dtype).tiny)
    return state._replace(
        covariance=covariance, basis=basis, eigenvalues=eigenvalues, refreshed=state.evaluations
    )
