"""Emitters: evolution strategies that rank by an archive's verdict and restart from its elites.

The emitters of CMA-ME, Fontaine, Togelius, Nikolaidis and Hoover 2020,
https://arxiv.org/abs/1912.02400, with the choices of pyribs' `EvolutionStrategyEmitter`.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import chex
import jax
import jax.numpy as jnp

from qdenv.search.archive import GridArchive
from qdenv.search.insertion import Insertion
from qdenv.search.store import StoredElites
from qdenv.search.strategies.base import Strategy
from qdenv.types import InputError

FLAT = 1e-12  # best and worst ranking values closer than this restart the emitter (pyribs)

# A ranker turns (insertion, objective) into sort keys, the most important first.
Ranker = Callable[[Insertion, jax.Array], tuple[jax.Array, ...]]
RANKERS: dict[str, Ranker] = {
    "imp": lambda insertion, objective: (insertion.value,),
    "2imp": lambda insertion, objective: (insertion.status, insertion.value),
    "obj": lambda insertion, objective: (objective,),
    "2obj": lambda insertion, objective: (insertion.status, objective),
}

# A selection gives the number of parents from (accepted, successes), both int32, and b.
Selection = Callable[[jax.Array, jax.Array, int], jax.Array]
SELECTIONS: dict[str, Selection] = {
    "mu": lambda accepted, successes, batch: jnp.minimum(batch // 2, successes),
    "filter": lambda accepted, successes, batch: accepted,
}

# A restart rule decides from (accepted rows of each emitter int32 [E], iterations int32): bool [E].
RestartRule = Callable[[jax.Array, jax.Array], jax.Array]


class EmittersState(NamedTuple):
    """State of E emitters side by side."""

    strategy: Any  # pytree, leading axis E
    iterations: jax.Array  # int32
    restarts: jax.Array  # int32 [E]


class Emitters(NamedTuple):
    """E emitters as a record of functions."""

    init: Callable[[jax.Array], Any]  # key -> state, a pytree; consumes the key
    # (state, key) -> (solutions float [E * b, P], state); consumes the key
    ask: Callable[[Any, jax.Array], tuple[jax.Array, Any]]
    # (state, key, solutions, insertion, objective, usable, archive) -> state, the arrays with a
    # leading axis E * b; `archive` holds the batch already. Consumes the key.
    tell: Callable[..., Any]


def rank(keys: tuple[jax.Array, ...], usable: jax.Array) -> jax.Array:
    """Order rows best first (int32 [b]); unusable rows come last, ties are reversed (pyribs).

    Args:
        keys: arrays [b], the most important first.
        usable: bool [b].
    """
    return jnp.flip(jnp.lexsort((*reversed(keys), usable)))


def is_flat(keys: tuple[jax.Array, ...], order: jax.Array, successes: jax.Array) -> jax.Array:
    """Tell whether the best and the worst of at least two usable rows rank the same."""
    last = order[jnp.maximum(successes - 1, 0)]
    gaps = jnp.stack([(key[order[0]] - key[last]).astype(float) for key in keys])
    return (successes >= 2) & (jnp.sqrt(jnp.square(gaps).sum()) < FLAT)


def restart_rule(rule: str | int) -> RestartRule:
    """Give the restart rule of a setting.

    Raises:
        InputError: the rule is neither "no_improvement", "basic" nor a positive period.
    """
    if rule == "no_improvement":
        return lambda accepted, iterations: accepted == 0
    if rule == "basic":
        return lambda accepted, iterations: jnp.zeros_like(accepted, bool)
    if isinstance(rule, int) and not isinstance(rule, bool) and rule > 0:
        return lambda accepted, iterations: jnp.full_like(accepted, iterations % rule == 0, bool)
    raise InputError(
        f"unknown restart rule {rule!r}: use no_improvement, basic or a number of iterations"
    )


def choose(which: jax.Array, new: Any, old: Any) -> Any:
    """Take the emitters marked by `which` (bool [E]) from `new`, the others from `old`."""

    def pick(one: jax.Array, other: jax.Array) -> jax.Array:
        return jnp.where(which.reshape(-1, *[1] * (one.ndim - 1)), one, other)

    return jax.tree.map(pick, new, old)


def restarted(
    strategy: Strategy, states: Any, which: jax.Array, means: jax.Array, key: jax.Array
) -> Any:
    """Start the marked emitters afresh; consumes the key.

    Args:
        strategy: of all emitters.
        states: pytree with a leading axis E.
        which: bool [E], the emitters to restart.
        means: float [E, P], where each would start.
        key: of the fresh states.
    """

    def renew(old: Any) -> Any:
        fresh = jax.vmap(strategy.init)(means, jax.random.split(key, means.shape[0]))
        return choose(which, fresh, old)

    # Restarts are rare and a fresh full covariance matrix is not free: most iterations skip this.
    return jax.lax.cond(which.any(), renew, lambda old: old, states)


def make_adaptation(
    strategy: Strategy, batch: int, ranker: Ranker, selection: Selection
) -> Callable[..., tuple[Any, jax.Array, jax.Array]]:
    """Make the function with which one emitter learns from its own b rows.

    Returns:
        (state, solutions [b, P], insertion, objective [b], usable bool [b]) -> (state, number of
        accepted rows int32, spent bool). A spent emitter must restart: its rows cannot be told
        apart or its distribution is degenerate.
    """

    def adapt(
        state: Any,
        solutions: jax.Array,
        insertion: Insertion,
        objective: jax.Array,
        usable: jax.Array,
    ) -> tuple[Any, jax.Array, jax.Array]:
        keys = ranker(insertion, objective)
        order = rank(keys, usable)
        # Failed rows rank last, so the first `successes` places of the order are real.
        successes = usable.sum(dtype=jnp.int32)
        accepted = (insertion.status > 0).sum(dtype=jnp.int32)
        parents = selection(accepted, successes, batch)
        state = strategy.tell(state, solutions, order, parents, successes)
        spent = strategy.exhausted(state) | is_flat(keys, order, successes)
        return state, accepted, spent

    return adapt


def make_emitters(
    strategy: Strategy,
    x0: jax.Array,
    emitters: int,
    batch: int,
    ranker: Ranker,
    selection: Selection,
    restart: RestartRule,
) -> Emitters:
    """Join E copies of a strategy, each adapting to its own b rows of every batch.

    Each emitter ranks its rows, recombines the best, and restarts from a random elite (from `x0`
    while the archive is empty) when the rule says so, when its rows cannot be told apart or when
    its distribution is degenerate.
    """
    adapt = make_adaptation(strategy, batch, ranker, selection)

    def init(key: jax.Array) -> EmittersState:
        means = jnp.broadcast_to(x0, (emitters, *x0.shape))
        states = jax.vmap(strategy.init)(means, jax.random.split(key, emitters))
        return EmittersState(states, jnp.int32(0), jnp.zeros(emitters, jnp.int32))

    def ask(state: EmittersState, key: jax.Array) -> tuple[jax.Array, EmittersState]:
        states = strategy.refresh(state.strategy)
        solutions, states = jax.vmap(strategy.ask)(states, jax.random.split(key, emitters))
        chex.assert_shape(solutions, (emitters, batch, x0.shape[0]))
        return solutions.reshape(emitters * batch, -1), state._replace(strategy=states)

    def tell(
        state: EmittersState,
        key: jax.Array,
        solutions: jax.Array,
        insertion: Insertion,
        objective: jax.Array,
        usable: jax.Array,
        archive: GridArchive | StoredElites,
    ) -> EmittersState:
        chex.assert_shape(solutions, (emitters * batch, x0.shape[0]))
        rows = (solutions, insertion, objective, usable)
        # Emitters never see each other's rows, so a vmap over them is exact.
        rows = jax.tree.map(lambda leaf: leaf.reshape(emitters, batch, *leaf.shape[1:]), rows)
        states, accepted, spent = jax.vmap(adapt)(state.strategy, *rows)
        iterations = state.iterations + 1
        again = spent | restart(accepted, iterations)
        elite_key, fresh_key = jax.random.split(key)
        means = archive.sample_solutions(elite_key, emitters, x0)
        states = restarted(strategy, states, again, means, fresh_key)
        return EmittersState(states, iterations, state.restarts + again)

    return Emitters(init, ask, tell)
