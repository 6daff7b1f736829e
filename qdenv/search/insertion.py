"""What an archive says of a batch, and how its winners are written."""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp


class Insertion(NamedTuple):
    """What an archive says of each solution of a batch, seen against the archive before it."""

    status: jax.Array  # int32 [B], 2 found a new cell, 1 improved a filled one, 0 was not accepted
    value: jax.Array  # float [B], objective minus the cell's threshold; -inf for a failed solution


def first_of_best(objective: jax.Array, candidates: jax.Array, same_cell: jax.Array) -> jax.Array:
    """Mark the best candidate of each cell, the first of the batch on a tie.

    Args:
        objective: float [B].
        candidates: bool [B].
        same_cell: bool [B, B].
    """
    index = jnp.arange(objective.shape[0])
    above = objective[None, :] > objective[:, None]
    tied_before = (objective[None, :] == objective[:, None]) & (index[None, :] < index[:, None])
    # Pairs of rows instead of a scatter: scatters of equal targets land in no defined order.
    beaten = (same_cell & candidates[None, :] & (above | tied_before)).any(axis=1)
    return candidates & ~beaten


def put(stored: Any, target: jax.Array, rows: Any) -> Any:
    """Write rows [B, ...] to the cells `target` (int32 [B]); cells out of bounds are dropped."""
    return jax.tree.map(
        lambda old, new: old.at[target].set(jnp.asarray(new, old.dtype), mode="drop"), stored, rows
    )
