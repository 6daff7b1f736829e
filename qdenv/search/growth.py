"""Searches run from the host: compiled, donated, with stores no larger than what was found."""

from collections.abc import Mapping
from typing import Any

import jax

from qdenv.search.base import Algorithm
from qdenv.search.store import is_store, stores_in
from qdenv.types import Array, Score

FIRST_ROWS = 1024  # of a store; it doubles when need be, so a search compiles few times


def growing(algorithm: Algorithm) -> Algorithm:
    """Compile an algorithm for a loop on the host; its arrays grow between iterations.

    Every `Store` in the state starts small and doubles before a batch might not fit, up to the
    size at which it always does. What is found is the same: bit for bit that of `algorithm`.

    Args:
        algorithm: pure functions whose shapes never change.

    Returns:
        the same search as jitted functions (`archive` is left as it is). `tell` consumes the state
        that it is given, `ask` leaves it whole and copies nothing of it.
    """
    full = [
        len(store.used) for store in stores_in(jax.eval_shape(algorithm.init, jax.random.key(0)))
    ]
    changed: list[int] = []  # leaves of the state that `ask` changes, known once it is traced

    @jax.jit
    def ask_for_changes(state: Any) -> tuple[jax.Array, list[jax.Array]]:
        solutions, after = algorithm.ask(state)
        pairs = list(zip(jax.tree.leaves(state), jax.tree.leaves(after), strict=True))
        changed[:] = [number for number, (old, new) in enumerate(pairs) if new is not old]
        return solutions, [pairs[number][1] for number in changed]

    def ask(state: Any) -> tuple[jax.Array, Any]:
        solutions, new = ask_for_changes(state)
        leaves, structure = jax.tree.flatten(state)
        for number, leaf in zip(changed, new, strict=True):
            leaves[number] = leaf
        return solutions, jax.tree.unflatten(structure, leaves)

    tell = jax.jit(algorithm.tell, donate_argnums=0)

    @jax.jit
    def init(key: jax.Array) -> Any:
        # XLA makes no more of the zeros of an empty store than the rows that are left of them.
        sizes = [min(rows, max(FIRST_ROWS, 1 + algorithm.batch_size)) for rows in full]
        return _resized(algorithm.init(key), sizes)

    def tell_with_room(
        state: Any, solutions: Array, score: Score, extras: Mapping[str, Array]
    ) -> Any:
        sizes = []
        for store, most in zip(stores_in(state), full, strict=True):
            rows, needed = len(store.used), int(store.used.sum()) + len(solutions)
            while rows < min(needed, most):
                rows = min(2 * rows, most)
            sizes.append(rows)
        return tell(_resized(state, sizes), solutions, score, extras)

    return algorithm._replace(init=init, ask=ask, tell=tell_with_room)


def is_whole(state: Any) -> bool:
    """Tell whether a state can be read: `tell` has not consumed any part of it."""
    arrays = [leaf for leaf in jax.tree.leaves(state) if isinstance(leaf, jax.Array)]
    return not any(array.is_deleted() for array in arrays)


def _resized(state: Any, sizes: list[int]) -> Any:
    """Give every store in a state its number of rows; those that have it stay as they are."""
    left = iter(sizes)

    def fit(node: Any) -> Any:
        if not is_store(node):
            return node
        rows = next(left)
        return node if rows == len(node.used) else node.resized(rows)

    return jax.tree.map(fit, state, is_leaf=is_store)
