"""Weights and rates of CMA-ES for every number of parents, as tables computed on the host.

Numbers in brackets are equations of Hansen 2016, "The CMA evolution strategy: a tutorial",
https://arxiv.org/abs/1604.00772v1.
"""

import math
from collections.abc import Callable
from typing import Generic, NamedTuple, TypeVar

import jax
import jax.numpy as jnp
import numpy as np

Numbers = TypeVar("Numbers", jax.Array, np.ndarray)


class Rates(NamedTuple, Generic[Numbers]):
    """Strategy parameters (table 1 of the tutorial).

    A table has a leading axis: the number of parents, 0..b. Row 0 holds zero rates and puts all
    weight on the first row, so that an update without parents changes nothing.
    """

    weights: Numbers  # float [b], w_i by rank, zero beyond the parents
    mu_eff: Numbers  # effective number of parents
    path: Numbers  # c_sigma, rate of the step-size path
    damping: Numbers  # d_sigma
    cov_path: Numbers  # c_c, rate of the covariance path
    rank_one: Numbers  # c_1
    rank_mu: Numbers  # c_mu


# (mu_eff, P) -> c_c, c_1, c_mu.
CovarianceRates = Callable[[float, int], tuple[float, float, float]]


def recombination_weights(parents: int, batch: int) -> np.ndarray:
    """Compute the positive logarithmic weights, float64 [batch], summing to 1 (49, 53).

    As pyribs: log(mu + 1/2) for mu parents in place of log((lambda + 1) / 2), so that any number
    of parents has positive weights.
    """
    ranks = np.arange(1, batch + 1)
    raw = np.log(parents + 0.5) - np.log(ranks)
    weights = np.where(ranks <= parents, raw, 0.0)
    return weights / weights.sum()


def full_rates(mu_eff: float, dim: int) -> tuple[float, float, float]:
    """Compute (c_c, c_1, c_mu) of the full covariance matrix."""
    cov_path = (4 + mu_eff / dim) / (dim + 4 + 2 * mu_eff / dim)  # (56)
    rank_one = 2 / ((dim + 1.3) ** 2 + mu_eff)  # (57)
    rank_mu = min(1 - rank_one, 2 * (mu_eff - 2 + 1 / mu_eff) / ((dim + 2) ** 2 + mu_eff))  # (58)
    return cov_path, rank_one, rank_mu


def separable_rates(mu_eff: float, dim: int) -> tuple[float, float, float]:
    """Compute (c_c, c_1, c_mu) of a diagonal covariance matrix, as pyribs does.

    They are larger than `full_rates`: a diagonal has fewer numbers to learn (Ros and Hansen 2008,
    "A simple modification in CMA-ES achieving linear time and space complexity",
    https://inria.hal.science/inria-00287367).
    """
    cov_path = (1 + 1 / dim + mu_eff / dim) / (dim**0.5 + 1 / dim + 2 * mu_eff / dim)
    rank_one = full_rates(mu_eff, dim)[1] / (dim + 2 * dim**0.5 + mu_eff / dim)
    rank_mu = min(1 - rank_one, (mu_eff + 1 / mu_eff - 2) / (dim + 4 * dim**0.5 + mu_eff / 2))
    return cov_path, rank_one, rank_mu


def rates_row(
    parents: int, batch: int, dim: int, covariance_rates: CovarianceRates
) -> Rates[np.ndarray]:
    """Compute the parameters for one number of parents (float64)."""
    if parents == 0:
        return Rates(np.eye(1, batch)[0], *map(np.asarray, (1.0, 0.0, 1.0, 0.0, 0.0, 0.0)))
    weights = recombination_weights(parents, batch)
    mu_eff = 1 / (weights**2).sum()  # (8)
    path = (mu_eff + 2) / (dim + mu_eff + 5)  # (55)
    damping = 1 + 2 * max(0.0, math.sqrt((mu_eff - 1) / (dim + 1)) - 1) + path  # (55)
    numbers = mu_eff, path, damping, *covariance_rates(mu_eff, dim)
    return Rates(weights, *map(np.asarray, numbers))


def rates_table(batch: int, dim: int, covariance_rates: CovarianceRates) -> Rates[np.ndarray]:
    """Tabulate the parameters for 0..batch parents; every field gets a leading axis [b + 1]."""
    # The number of parents is known only while tracing: all rows in float64 now, one picked then.
    rows = [rates_row(parents, batch, dim, covariance_rates) for parents in range(batch + 1)]
    dtype = jnp.result_type(float)
    return Rates(*(np.asarray(column).astype(dtype) for column in zip(*rows, strict=True)))


def pick(table: Rates[np.ndarray], parents: jax.Array) -> Rates[jax.Array]:
    """Take one row of a table (parents: int32)."""
    return jax.tree.map(lambda column: jnp.asarray(column)[parents], table)
