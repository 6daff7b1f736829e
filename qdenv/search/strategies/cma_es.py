"""CMA-ES by pyribs' rules: an isotropic, a diagonal, a full and a limited-memory covariance."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct

from qdenv.search.strategies import base
from qdenv.types import InputError


class Isotropic(base.Strategy):
    """Sample N(mean, std^2 I) and adapt std by its path, O(b P) per iteration.

    Exactly what pyribs' CMA-ES does until its first eigendecomposition, after `refresh_gap`
    evaluations of an emitter: beyond the paper's budgets for fleets and kernels (3, 3, 3).
    """

    def _sample(self, state: Any, noise: jax.Array) -> tuple[jax.Array, Any]:
        return state.mean[None] + state.std * noise, state  # (39) and (40), C = I

    def _update(self, state: Any, batch: base.RankedBatch) -> Any:
        std, p_std = base.update_step_size(state, batch.mean - state.mean, batch.rates)
        return state.replace(mean=batch.mean, std=std, p_std=p_std)


@struct.dataclass
class CovarianceState(base.StrategyState):
    """The search distribution N(mean, std^2 C).

    Where C is a matrix, its eigensystem is in the state, renewed when it is due; else None.
    """

    evaluations: jax.Array  # int32, successful ones since the last restart
    p_c: jax.Array  # float [P], evolution path of the covariance
    C: jax.Array  # covariance: float [P], its diagonal, or [P, P]
    B: Any = None  # float [P, P], eigenvectors of the covariance at the last refresh
    eigenvalues: Any = None  # float [P], at the last refresh
    refreshed: Any = None  # int32, `evaluations` at the last refresh


class _Covariance(base.Strategy):
    """Adapt a covariance matrix by rank-one and rank-mu updates.

    As in pyribs the path p_c is not divided by std and the rank-one term carries its rate twice.
    Subclasses define `_whiten(state, step)`, C^(-1/2) step, and `_outer(weights, steps)`, the
    weighted sum of the outer products of steps [n, P] with themselves, of the form of C.
    """

    state_type = CovarianceState

    def _init_fields(self, params: base.Params) -> dict[str, Any]:
        fields = super()._init_fields(params)
        ones = jnp.ones_like(fields["mean"])
        return fields | {"evaluations": jnp.int32(0), "p_c": fields["mean"], "C": ones}

    def _update(self, state: Any, batch: base.RankedBatch) -> Any:
        rates, step = batch.rates, batch.mean - state.mean
        evaluations = state.evaluations + batch.evaluated
        std, p_std = base.update_step_size(state, self._whiten(state, step), rates)
        # h_sigma of (45) is False while the path is long: a long path says that the step size is
        # far too small, and the covariance must not grow meanwhile. As pyribs: squared lengths,
        # and evaluations in place of generations.
        decay = 1 - (1 - rates.path) ** (2 * evaluations / self.population_size)
        short = jnp.square(p_std).sum() / self.num_dims < (2 + 4 / (self.num_dims + 1)) * decay
        scale = jnp.sqrt(rates.cov_path * (2 - rates.cov_path) * rates.mu_eff)
        p_c = (1 - rates.cov_path) * state.p_c + jnp.where(short, scale, 0) * step  # (45)
        # c_1 (1 - delta(h_sigma)): while h_sigma stalls the path, the variance that it misses
        # stays in the matrix.
        lost = jnp.where(short, 0, rates.cov_path * (2 - rates.cov_path))
        steps = batch.rows - state.mean[None]
        covariance = (  # (47), the weights being positive
            state.C * (1 - rates.rank_one * (1 - lost) - rates.rank_mu)
            + rates.rank_one**2 * self._outer(jnp.ones(1, p_c.dtype), p_c[None])
            + rates.rank_mu / state.std**2 * self._outer(rates.weights, steps)
        )
        return state.replace(
            mean=batch.mean, std=std, p_std=p_std, evaluations=evaluations, p_c=p_c, C=covariance
        )

    def is_degenerate(self, state: Any) -> jax.Array:
        """Return True if the distribution is too narrow, too lopsided or not finite."""
        # Those of a diagonal are its entries.
        eigenvalues = state.C if state.eigenvalues is None else state.eigenvalues
        largest, smallest = eigenvalues.max(), eigenvalues.min()
        area = state.std * jnp.sqrt(largest)
        healthy = (largest / smallest <= base.LARGEST_CONDITION) & (area >= base.SMALLEST_STEP)
        return ~(healthy & jnp.isfinite(area))


class Separable(_Covariance):
    """sep-CMA-ES: a diagonal covariance with its own rates, O(b P).

    Ros and Hansen 2008, "A simple modification in CMA-ES achieving linear time and space
    complexity", https://inria.hal.science/inria-00287367.
    """

    covariance_rates = staticmethod(base.separable_rates)

    def _sample(self, state: Any, noise: jax.Array) -> tuple[jax.Array, Any]:
        deviations = state.std * jnp.sqrt(state.C)
        return state.mean[None] + deviations[None] * noise, state  # (39) and (40)

    def _whiten(self, state: CovarianceState, step: jax.Array) -> jax.Array:
        return step / jnp.sqrt(state.C)

    def _outer(self, weights: jax.Array, steps: jax.Array) -> jax.Array:
        # The diagonal of the matrix is all that is ever computed: O(b P).
        return (weights[:, None] * jnp.square(steps)).sum(axis=0)


class Full(_Covariance):
    """CMA-ES with a full matrix, O(b P^2) per iteration and O(P^3) per eigendecomposition.

    For P up to some hundreds. The decomposition is computed when it is due, under a `jax.vmap`
    over emitters too; under two of them (over whole searches) at every ask, because a branch under
    vmap becomes a select.
    """

    def _init_fields(self, params: base.Params) -> dict[str, Any]:
        fields = super()._init_fields(params)
        ones, identity = fields["C"], jnp.diag(fields["C"])
        eigensystem = {"B": identity, "eigenvalues": ones, "refreshed": fields["evaluations"]}
        return fields | {"C": identity} | eigensystem

    def _sample(self, state: Any, noise: jax.Array) -> tuple[jax.Array, Any]:
        gap = np.float32(refresh_gap(self.num_dims, self.population_size))
        due = state.evaluations > state.refreshed + gap
        covariance, basis, eigenvalues = _refresh_if(due, state.C, state.B, state.eigenvalues)
        solutions = base.matmul(noise, (basis * jnp.sqrt(eigenvalues)[None]).T)  # (39)
        return state.mean[None] + state.std * solutions, state.replace(  # (40)
            C=covariance,
            B=basis,
            eigenvalues=eigenvalues,
            refreshed=jnp.where(due, state.evaluations, state.refreshed),
        )

    def _whiten(self, state: CovarianceState, step: jax.Array) -> jax.Array:
        # By way of the eigenbasis, in which the root is a division.
        return base.matmul(state.B, base.matmul(step, state.B) / jnp.sqrt(state.eigenvalues))

    def _outer(self, weights: jax.Array, steps: jax.Array) -> jax.Array:
        return base.matmul((weights[:, None] * steps).T, steps)


def refresh_gap(dim: int, batch: int) -> float:
    """Compute after how many evaluations of an emitter the eigensystem is due (pyribs).

    The matrix hardly changes in fewer; the tutorial counts generations instead
    (section on numerical effort).
    """
    rates = base.rates_row(max(batch // 2, 1), batch, dim, base.full_rates)
    return float(0.5 * batch / (dim * (rates.rank_one + rates.rank_mu)))


_Eigensystem = tuple[jax.Array, jax.Array, jax.Array]  # covariance, basis, eigenvalues


@jax.custom_batching.custom_vmap
def _refresh_if(
    due: jax.Array, covariance: jax.Array, basis: jax.Array, eigenvalues: jax.Array
) -> _Eigensystem:
    """Renew an eigensystem if it is due."""
    return jax.lax.cond(due, _decompose, lambda *same: same, covariance, basis, eigenvalues)


@_refresh_if.def_vmap
def _refresh_each(size: int, batched: list[bool], *given: jax.Array) -> tuple[_Eigensystem, Any]:
    """Renew those eigensystems of several emitters that are due."""
    rows = [
        leaf if own else jnp.broadcast_to(leaf, (size, *leaf.shape))
        for leaf, own in zip(given, batched, strict=True)
    ]

    one = lambda row: jax.lax.cond(row[0], _decompose, lambda *same: same, *row[1:])  # noqa: E731
    # Not a vmap of the branch: under it both sides would be computed at every ask.
    new = jax.lax.cond(
        rows[0].any(), lambda *systems: jax.lax.map(one, systems), lambda due, *same: same, *rows
    )
    return new, (True, True, True)


def _decompose(covariance: jax.Array, basis: jax.Array, eigenvalues: jax.Array) -> _Eigensystem:
    """Renew the eigensystem of a covariance matrix."""
    # Products of rounded numbers are not quite symmetric; pyribs takes the larger of each pair.
    covariance = jnp.maximum(covariance, covariance.T)
    eigenvalues, basis = jnp.linalg.eigh(covariance, symmetrize_input=False)
    # Rounding may leave tiny negative values, of which there is no root.
    eigenvalues = jnp.maximum(jnp.abs(eigenvalues), jnp.finfo(eigenvalues.dtype).tiny)
    return covariance, basis, eigenvalues


@struct.dataclass
class LimitedMemoryState(base.StrategyState):
    """State of `LimitedMemory`."""

    generations: jax.Array  # int32, since the last restart
    memory: jax.Array  # float [b, P], directions of past steps
    noise: jax.Array  # float [b, P], the standard normal draws of the last ask


class LimitedMemory(base.Strategy):
    """LM-MA-ES: a matrix remembered as direction vectors, as many as the batch, O(b^2 P).

    Loshchilov, Glasmachers and Beyer 2017, "Limited-memory matrix adaptation for large scale
    black-box optimization", https://arxiv.org/abs/1705.06693.
    """

    state_type = LimitedMemoryState
    smallest_step = base.SMALLEST_STEP / 10  # pyribs

    def __init__(self, population_size: int, solution: Any, **settings: Any) -> None:
        """Compute the rates; raise InputError if the batch is larger than the solution."""
        super().__init__(population_size, solution, **settings)
        batch, dim = population_size, self.num_dims
        if batch > dim:
            raise InputError(f"lm_ma needs a batch of at most {dim} (the parameters), not {batch}")
        self.path_rate = 2 * batch / dim  # c_sigma
        # How far each of the b vectors bends a draw (c_d), and how fast it learns (c_c): each
        # remembers four times as long as the one before it, so that together they span the
        # directions of many generations in O(b P) numbers.
        self.bend_rates = 1 / (1.5 ** np.arange(batch) * dim)
        self.memory_rates = batch / (4.0 ** np.arange(batch) * dim)

    def _init_fields(self, params: base.Params) -> dict[str, Any]:
        blank = jnp.zeros((self.population_size, self.num_dims), self.solution_flat.dtype)
        own = {"generations": jnp.int32(0), "memory": blank, "noise": blank}
        return super()._init_fields(params) | own

    def _sample(self, state: Any, noise: jax.Array) -> tuple[jax.Array, Any]:
        # One more vector counts in each generation, though the first fills all.
        used = jnp.arange(self.population_size) < state.generations
        rates = jnp.where(used, jnp.asarray(self.bend_rates, noise.dtype), 0)

        def bend(rows: jax.Array, vector_rate: tuple) -> tuple[jax.Array, None]:
            vector, rate = vector_rate
            projected = base.matmul(rows, vector)[:, None] * vector[None]
            return (1 - rate) * rows + rate * projected, None

        # Stretched along the vectors of the memory, one after the other.
        bent = jax.lax.scan(bend, noise, (state.memory, rates))[0]
        return state.mean[None] + state.std * bent, state.replace(noise=noise)

    def _update(self, state: Any, batch: base.RankedBatch) -> Any:
        rates, mean, some = batch.rates, batch.mean, batch.parents > 0
        # The draws z rather than the solutions: they are white whatever the memory has learnt.
        blank = jnp.zeros_like(state.mean)
        draws = base.ranked_parents(state.noise, batch.order, batch.parents, blank)
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
