"""What our evolution strategies share: evosax algorithms that look at the order of the fitness.

evosax (https://github.com/RobertTLange/evosax) ships no types. Equations as in `strategies`.
"""

import functools
import math
from collections.abc import Callable
from typing import Any, NamedTuple

import chex
import jax
import jax.numpy as jnp
import numpy as np
from evosax.algorithms.distribution_based.base import DistributionBasedAlgorithm
from evosax.algorithms.distribution_based.base import Params as EvosaxParams
from evosax.algorithms.distribution_based.base import State as EvosaxState
from flax import struct

SMALLEST_STEP = 1e-11  # a search distribution narrower than this restarts (pyribs)
LARGEST_CONDITION = 1e14  # so does one whose covariance has a larger condition number


class Rates(NamedTuple):
    """Strategy parameters (table 1 of the tutorial), numbers or arrays.

    A table has a leading axis: the number of parents, 0..b. Row 0 holds zero rates and puts all
    weight on the first row, so that an update without parents changes nothing.
    """

    weights: Any  # float [b], w_i by rank, zero beyond the parents
    mu_eff: Any  # effective number of parents
    path: Any  # c_sigma, rate of the step-size path
    damping: Any  # d_sigma
    cov_path: Any  # c_c, rate of the covariance path
    rank_one: Any  # c_1
    rank_mu: Any  # c_mu


# (mu_eff, P) -> c_c, c_1, c_mu.
_CovarianceRates = Callable[[float, int], tuple[float, float, float]]


def full_rates(mu_eff: float, dim: int) -> tuple[float, float, float]:
    """Compute (c_c, c_1, c_mu) of the full covariance matrix."""
    cov_path = (4 + mu_eff / dim) / (dim + 4 + 2 * mu_eff / dim)  # (56)
    rank_one = 2 / ((dim + 1.3) ** 2 + mu_eff)  # (57)
    rank_mu = min(1 - rank_one, 2 * (mu_eff - 2 + 1 / mu_eff) / ((dim + 2) ** 2 + mu_eff))  # (58)
    return cov_path, rank_one, rank_mu


def separable_rates(mu_eff: float, dim: int) -> tuple[float, float, float]:
    """Compute (c_c, c_1, c_mu) of a diagonal covariance matrix, as pyribs does.

    c_c and c_mu are larger than in `full_rates`: a diagonal has fewer numbers to learn (Ros and
    Hansen 2008, https://inria.hal.science/inria-00287367).
    """
    cov_path = (1 + 1 / dim + mu_eff / dim) / (dim**0.5 + 1 / dim + 2 * mu_eff / dim)
    rank_one = full_rates(mu_eff, dim)[1] / (dim + 2 * dim**0.5 + mu_eff / dim)
    rank_mu = min(1 - rank_one, (mu_eff + 1 / mu_eff - 2) / (dim + 4 * dim**0.5 + mu_eff / 2))
    return cov_path, rank_one, rank_mu


def rates_row(parents: int, batch: int, dim: int, covariance_rates: _CovarianceRates) -> Rates:
    """Compute the parameters for one number of parents (float64)."""
    if parents == 0:
        return Rates(np.eye(1, batch)[0], 1.0, 0.0, 1.0, 0.0, 0.0, 0.0)
    # As pyribs: log(mu + 1/2) for mu parents in place of log((lambda + 1) / 2) in (49), so that
    # any number of parents has positive weights.
    ranks = np.arange(1, batch + 1)
    raw = np.where(ranks <= parents, np.log(parents + 0.5) - np.log(ranks), 0.0)
    weights = raw / raw.sum()  # (53)
    mu_eff = 1 / (weights**2).sum()  # (8)
    path = (mu_eff + 2) / (dim + mu_eff + 5)  # (55)
    damping = 1 + 2 * max(0.0, math.sqrt((mu_eff - 1) / (dim + 1)) - 1) + path  # (55)
    return Rates(weights, mu_eff, path, damping, *covariance_rates(mu_eff, dim))


def rates_table(batch: int, dim: int, covariance_rates: _CovarianceRates) -> Rates:
    """Tabulate the parameters for 0..batch parents; every field gets a leading axis [b + 1]."""
    # The number of parents is known only while tracing: all rows in float64 now, one picked then.
    rows = [rates_row(parents, batch, dim, covariance_rates) for parents in range(batch + 1)]
    dtype = jnp.result_type(float)
    return Rates(*(np.array(column, dtype) for column in zip(*rows, strict=True)))


@struct.dataclass
class Params(EvosaxParams):
    """Parameters of a strategy that may differ from call to call."""

    std_init: jax.Array  # float, initial step size
    # int32, how many of the best solutions are recombined, 0 to b: CMA-ME recombines as many as
    # an archive accepted
    num_elites: jax.Array


@struct.dataclass
class StrategyState(EvosaxState):
    """The search distribution N(mean, std^2 I)."""

    std: jax.Array  # float, step size sigma
    p_std: jax.Array  # float [P], evolution path of the step size


class RankedBatch(NamedTuple):
    """A ranked batch, as the updates of a strategy take it."""

    rows: jax.Array  # float [b, P], the parents best first, then copies of the old mean
    mean: jax.Array  # float [P], the new mean
    rates: Rates  # of this number of parents
    order: jax.Array  # int32 [b], the rows best first
    parents: jax.Array  # int32
    evaluated: jax.Array  # int32, rows that did not fail


class Strategy(DistributionBasedAlgorithm):
    """Base class of our strategies: evosax algorithms with pyribs' update rules.

    `init`, `ask` and `tell` are evosax'. Subclasses define `_sample(state, noise)`, which makes
    solutions of draws from N(0, I), float [b, P] (38), and `_update(state, batch)`. Like evosax
    they minimise, and only the order of the fitness counts: ranks do. A fitness of NaN marks a
    failed evaluation, which is never a parent. `tell` draws nothing: its key may be None.
    """

    state_type: type = StrategyState
    covariance_rates: _CovarianceRates = staticmethod(full_rates)
    smallest_step = SMALLEST_STEP

    def __init__(self, population_size: int, solution: Any, **settings: Any) -> None:
        """Tabulate the rates (the arguments are those of every evosax algorithm)."""
        super().__init__(population_size, solution, **settings)
        self.elite_ratio = 0.5
        self.table = rates_table(population_size, self.num_dims, self.covariance_rates)

    @property
    def _default_params(self) -> Params:
        return Params(std_init=jnp.asarray(1.0), num_elites=jnp.int32(self.num_elites))

    def _init(self, key: jax.Array, params: Params) -> Any:
        return self.state_type(**self._init_fields(params))

    def _init_fields(self, params: Params) -> dict[str, Any]:
        """Return the fields of the state at the start."""
        zeros = jnp.zeros_like(self.solution_flat)
        return {
            "best_solution": zeros,
            "best_fitness": jnp.inf,
            "generation_counter": 0,
            "mean": zeros,
            "std": jnp.asarray(params.std_init, zeros.dtype),
            "p_std": zeros,
        }

    def _ask(self, key: jax.Array, state: Any, params: Params) -> tuple[jax.Array, Any]:
        shape = self.population_size, self.num_dims
        return self._sample(state, jax.random.normal(key, shape, state.mean.dtype))

    def _tell(self, key: Any, population: Any, fitness: Any, state: Any, params: Params) -> Any:
        evaluated = (~jnp.isnan(fitness)).sum(dtype=jnp.int32)
        parents = jnp.minimum(params.num_elites, evaluated)
        rates = jax.tree.map(lambda column: jnp.asarray(column)[parents], self.table)
        order = jnp.argsort(fitness)  # NaN comes last
        rows = ranked_parents(population, order, parents, state.mean)
        mean = (rates.weights[:, None] * rows).sum(axis=0)  # (41) and (42)
        return self._update(state, RankedBatch(rows, mean, rates, order, parents, evaluated))

    def is_degenerate(self, state: Any) -> jax.Array:
        """Return True if the distribution is too narrow to search on, or not finite."""
        return ~((state.std >= self.smallest_step) & jnp.isfinite(state.std))


def ranked_parents(
    solutions: jax.Array, order: jax.Array, parents: jax.Array, filler: jax.Array
) -> jax.Array:
    """Sort rows [b, P] best first and replace all but the parents by `filler` [P].

    What a failed row holds, infinities included, never meets a zero weight: 0 * inf is NaN.
    """
    chex.assert_shape(order, solutions.shape[:1])
    chosen = jnp.arange(order.shape[0]) < parents
    return jnp.where(chosen[:, None], solutions[order], filler)


def update_step_size(state: Any, step: jax.Array, rates: Rates) -> tuple[jax.Array, jax.Array]:
    """Extend the step-size path by the whitened `step` of the mean (43) and adapt std to it (44).

    As pyribs: the squared length of the path against its expectation P, with the exponent capped at
    1, where the tutorial compares the length with E||N(0, I)||. Returns (std, p_std [P]).
    """
    scale = jnp.sqrt(rates.path * (2 - rates.path) * rates.mu_eff) / state.std
    p_std = (1 - rates.path) * state.p_std + scale * step
    excess = jnp.square(p_std).sum() / p_std.shape[0] - 1
    return state.std * jnp.exp(jnp.minimum(1, rates.path / rates.damping * excess / 2)), p_std


# Matrices are multiplied at full precision, also where the device would round to fewer bits.
matmul = functools.partial(jnp.matmul, precision="highest")
