"""Emitters: evolution strategies that rank by an archive's verdict and restart from its elites."""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from qdenv.search.archive import GridArchive, Insertion
from qdenv.search.strategies.base import Strategy
from qdenv.types import Array, InputError

FLAT = 1e-12  # best and worst ranking values closer than this restart the emitter (pyribs)

# A ranker turns (insertion, objective) into sort keys, the most important first.
Ranker = Callable[[Insertion, Array], tuple[Array, ...]]
RANKERS: dict[str, Ranker] = {
    "imp": lambda insertion, objective: (insertion.value,),
    "2imp": lambda insertion, objective: (insertion.status, insertion.value),
    "obj": lambda insertion, objective: (objective,),
    "2obj": lambda insertion, objective: (insertion.status, objective),
}

# A selection gives the number of parents from (accepted, successes), both int32, and b.
Selection = Callable[[Array, Array, int], Array]
SELECTIONS: dict[str, Selection] = {
    "mu": lambda accepted, successes, batch: jnp.minimum(batch // 2, successes),
    "filter": lambda accepted, successes, batch: accepted,
}


class EmittersState(NamedTuple):
    """State of E emitters side by side."""

    strategy: Any  # pytree, leading axis E
    iterations: Array  # int32
    restarts: Array  # int32 [E]


class Emitters(NamedTuple):
    """E emitters as a record of functions.

    Attributes:
        init: key -> state; consumes the key.
        ask: (state, key) -> (solutions float [E * b, P], state); consumes the key.
        tell: (state, key, solutions, insertion, objective, usable, archive) -> state, the
            arrays with a leading axis E * b; `archive` holds the batch already. Consumes the key.
    """

    init: Callable[[Array], EmittersState]
    ask: Callable[[EmittersState, Array], tuple[Array, EmittersState]]
    tell: Callable[..., EmittersState]


def rank(keys: tuple[Array, ...], usable: Array) -> jax.Array:
    """Order rows best first (int32 [b]); unusable rows come last, ties are reversed (pyribs).

    Args:
        keys: arrays [b], the most important first.
        usable: bool [b].
    """
    return jnp.flip(jnp.lexsort((*reversed(keys), usable)))


def is_flat(keys: tuple[Array, ...], order: Array, successes: Array) -> jax.Array:
    """Tell whether the best and the worst of at least two usable rows rank the same."""
    last = order[jnp.maximum(successes - 1, 0)]
    gaps = jnp.stack([(key[order[0]] - key[last]).astype(float) for key in keys])
    return (successes >= 2) & (jnp.sqrt(jnp.square(gaps).sum()) < FLAT)


def restart_rule(rule: str | int) -> Callable[[Array, Array], Array]:
    """Give the function (accepted, iterations) -> bool that decides on a restart.

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


def choose(which: Array, new: Any, old: Any) -> Any:
    """Take the emitters marked by `which` (bool [E]) from `new`, the others from `old`."""

    def pick(one: Array, other: Array) -> jax.Array:
        return jnp.where(which.reshape(-1, *[1] * (one.ndim - 1)), one, other)

    return jax.tree.map(pick, new, old)


def make_emitters(
    strategy: Strategy,
    x0: Array,
    emitters: int,
    batch: int,
    ranker: Ranker,
    selection: Selection,
    restart: Callable[[Array, Array], Array],
) -> Emitters:
    """Join E copies of a strategy, each adapting to its own b rows of every batch.

    Each emitter ranks its rows, recombines the best, and restarts from a random elite (from `x0`
    while the archive is empty) when the rule says so, when its rows cannot be told apart or when
    its distribution is degenerate.
    """

    def init(key: Array) -> EmittersState:
        means = jnp.broadcast_to(x0, (emitters, *x0.shape))
        states = jax.vmap(strategy.init)(means, jax.random.split(key, emitters))
        return EmittersState(states, jnp.int32(0), jnp.zeros(emitters, jnp.int32))

    def ask(state: EmittersState, key: Array) -> tuple[Array, EmittersState]:
        states = strategy.refresh(state.strategy)
        solutions, states = jax.vmap(strategy.ask)(states, jax.random.split(key, emitters))
        return solutions.reshape(emitters * batch, -1), state._replace(strategy=states)

    def adapt(
        state: Any, solutions: Array, insertion: Insertion, objective: Array, usable: Array
    ) -> tuple[Any, Array, Array]:
        keys = ranker(insertion, objective)
        order = rank(keys, usable)
        successes = usable.sum(dtype=jnp.int32)
        accepted = (insertion.status > 0).sum(dtype=jnp.int32)
        parents = selection(accepted, successes, batch)
        state = strategy.tell(state, solutions, order, parents, successes)
        spent = strategy.exhausted(state) | is_flat(keys, order, successes)
        return state, accepted, spent

    def tell(
        state: EmittersState,
        key: Array,
        solutions: Array,
        insertion: Insertion,
        objective: Array,
        usable: Array,
        archive: GridArchive,
    ) -> EmittersState:
        rows = (solutions, insertion, objective, usable)
        rows = jax.tree.map(lambda leaf: leaf.reshape(emitters, batch, *leaf.shape[1:]), rows)
        states, accepted, spent = jax.vmap(adapt)(state.strategy, *rows)
        iterations = state.iterations + 1
        again = spent | restart(accepted, iterations)
        elite_key, fresh_key = jax.random.split(key)
        means = archive.sample_solutions(elite_key, emitters, x0)

        def renew(old: Any) -> Any:
            fresh = jax.vmap(strategy.init)(means, jax.random.split(fresh_key, emitters))
            return choose(again, fresh, old)

        states = jax.lax.cond(again.any(), renew, lambda old: old, states)
        return EmittersState(states, iterations, state.restarts + again)

    return Emitters(init, ask, tell)
