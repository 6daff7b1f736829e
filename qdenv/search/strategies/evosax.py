"""Evolution strategies of evosax behind the same face, fed ranks instead of objectives.

evosax (https://github.com/RobertTLange/evosax) ships no types: its objects are `Any` in this file.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from qdenv.search.settings import check_strategy
from qdenv.search.strategies.base import SMALLEST_STEP, Strategy
from qdenv.types import InputError

EVOSAX_NAMES = ("CMA_ES", "CR_FM_NES", "DiscoveredES", "Open_ES", "PGPE", "SimpleES", "SNES")
MIRRORED = ("CR_FM_NES", "Open_ES", "PGPE")  # draw every solution together with its mirror image
ADAM_RATE = 0.1  # in initial step sizes; with evosax' own optimizers these stand still


class EvosaxState(NamedTuple):
    """State of one emitter that runs an evosax strategy."""

    inner: Any
    key: jax.Array  # uint32 [2], for the next tell


def evosax_strategy(name: str, **settings: Any) -> Callable[[int, int, float], Strategy]:
    """Make the constructor of an evosax distribution-based strategy for `STRATEGIES`.

    The number of parents is the strategy's own affair: the selection only decides whether it is
    told at all. Failed rows rank last and stand at the mean, where they pull nowhere.

    Args:
        name: class name in ``evosax.algorithms``.
        settings: further arguments of that class.

    Raises:
        InputError: evosax has no such strategy, or a known defect makes it unfit.
    """
    check_strategy(name)

    def make(dim: int, batch: int, sigma0: float) -> Strategy:
        return wrap(build(name, dim, batch, sigma0, settings), sigma0)

    return make


def build(name: str, dim: int, batch: int, sigma0: float, settings: dict[str, Any]) -> Any:
    """Construct the evosax object; its classes load only when they are used."""
    import evosax.algorithms
    import optax

    if not hasattr(evosax.algorithms, name):
        raise InputError(f"evosax has no strategy {name!r}")
    if name in MIRRORED and batch % 2:
        raise InputError(f"the strategy {name} needs an even batch, not {batch}")
    defaults: dict[str, Any] = {}
    if name in ("Open_ES", "PGPE"):
        defaults["optimizer"] = optax.adam(ADAM_RATE * sigma0)
    if name == "Open_ES":
        defaults["std_schedule"] = optax.constant_schedule(sigma0)
    return getattr(evosax.algorithms, name)(
        population_size=batch, solution=jnp.zeros(dim), **{**defaults, **settings}
    )


def strong(leaf: Any) -> jax.Array:
    """Give a leaf its dtype for good: a Python number in a state would be traced twice."""
    return jnp.asarray(leaf, jnp.asarray(leaf).dtype)


def wrap(algorithm: Any, sigma0: float) -> Strategy:
    """Give an evosax object the face of a `Strategy`."""
    params = algorithm.default_params
    if hasattr(params, "std_init"):
        params = params.replace(std_init=jnp.full_like(jnp.asarray(params.std_init), sigma0))
    batch = algorithm.population_size

    def init(mean: jax.Array, key: jax.Array) -> EvosaxState:
        inner = algorithm.init(key, mean, params)
        inner = inner.replace(best_solution=mean)  # evosax puts NaN there
        return EvosaxState(jax.tree.map(strong, inner), key)

    def ask(state: EvosaxState, key: jax.Array) -> tuple[jax.Array, EvosaxState]:
        ask_key, tell_key = jax.random.split(key)
        with jax.numpy_rank_promotion("allow"):  # evosax adds vectors to matrices
            solutions, inner = algorithm.ask(ask_key, state.inner, params)
        return solutions, EvosaxState(inner, tell_key)

    def tell(
        state: EvosaxState,
        solutions: jax.Array,
        order: jax.Array,
        parents: jax.Array,
        evaluated: jax.Array,
    ) -> EvosaxState:
        ranks = jnp.zeros(batch, jnp.int32).at[order].set(jnp.arange(batch, dtype=jnp.int32))
        rows = jnp.where((ranks < evaluated)[:, None], solutions, state.inner.mean[None])
        fitness = ranks.astype(solutions.dtype)  # evosax minimises: the best has rank 0
        with jax.numpy_rank_promotion("allow"):
            told, _ = algorithm.tell(state.key, rows, fitness, state.inner, params)
        inner = jax.tree.map(
            lambda new, old: strong(jnp.where(parents > 0, new, old)), told, state.inner
        )
        return EvosaxState(inner, state.key)

    def exhausted(state: EvosaxState) -> jax.Array:
        step = jnp.asarray(state.inner.std).max()
        healthy = (step >= SMALLEST_STEP) & jnp.isfinite(step)
        return ~(healthy & jnp.isfinite(state.inner.mean).all())

    return Strategy(init, ask, tell, exhausted)
