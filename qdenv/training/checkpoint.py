"""Checkpoints: a pytree of arrays as one .npz with a manifest inside, no pickle.

Only rows that hold anything but zeros are stored, and they are copied piece by piece: no second
copy of an archive is ever made.
"""

from __future__ import annotations

import logging
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from qdenv.checkpoints import DamagedError, Rows, read_state, write_state
from qdenv.lazy import jax, jnp
from qdenv.search.store import stores_in
from qdenv.training.dense import upgraded
from qdenv.types import InputError

_MANIFEST = "manifest"
LOG = logging.getLogger(__name__)


def save_checkpoint(path: Path, state: Any, manifest: dict[str, Any]) -> None:
    """Write `state` atomically.

    Args:
        path: the .npz file.
        state: pytree of arrays.
        manifest: JSON-ready facts, returned by `load_checkpoint`.

    Raises:
        InputError: the file cannot be written.
    """
    arrays: dict[str, np.ndarray | Rows] = {}
    leaves = [_as_bits(leaf) for leaf in jax.tree.leaves(state)]
    for number, leaf in enumerate(leaves):
        if leaf.ndim == 0:
            arrays[f"{number}.rows"] = leaf
            continue
        held = np.flatnonzero(leaf.reshape(len(leaf), -1).any(axis=1)).astype(np.int32)
        arrays[f"{number}.changed"] = held
        arrays[f"{number}.rows"] = Rows(leaf, held)
    lengths = [leaf.shape[0] if leaf.ndim else 0 for leaf in leaves]
    write_state(path, arrays, {"lengths": lengths, **manifest}, _MANIFEST)


def load_checkpoint(path: Path, initial: Any) -> tuple[Any, dict[str, Any]]:
    """Read a checkpoint back, bit for bit.

    Args:
        path: the .npz file.
        initial: an initial state of the same search; stores of solutions may have other lengths.

    Returns:
        (state, manifest).

    Raises:
        DamagedError: the file is damaged.
        InputError: it is of a newer schema, or of another configuration.
    """
    arrays, manifest = read_state(path, _MANIFEST)
    try:
        return _fitted(path, arrays, manifest, initial)
    except (KeyError, IndexError, ValueError, TypeError) as error:
        if isinstance(error, InputError):
            raise
        raise DamagedError(f"{path} is no readable checkpoint ({error!r})") from error


def _fitted(
    path: Path, arrays: dict[str, np.ndarray], manifest: dict[str, Any], initial: Any
) -> tuple[Any, dict[str, Any]]:
    """Put the arrays of a checkpoint into the form of an initial state."""
    another = InputError(f"{path}: belongs to another configuration")
    leaves, structure = jax.tree.flatten(initial)
    plain = [_as_bits(leaf) for leaf in leaves]
    if manifest["schema"] == 1:
        try:
            arrays, manifest = upgraded(arrays, manifest, initial, plain)
        except (KeyError, IndexError, ValueError) as error:  # arrays of other shapes
            raise another from error
    if len(manifest["lengths"]) != len(leaves):
        raise another
    growing = {id(leaf) for store in stores_in(initial) for leaf in store}
    for number, (leaf, like) in enumerate(zip(leaves, plain, strict=True)):
        # Taken out one by one: what is restored is not held twice for long.
        rows, held = arrays.pop(f"{number}.rows"), arrays.pop(f"{number}.changed", None)
        length = manifest["lengths"][number]
        as_long = not like.ndim or length == len(like) or id(leaf) in growing
        if not as_long or rows.dtype != like.dtype or rows.shape[1:] != like.shape[1:]:
            raise another
        leaves[number] = _restore(leaf, rows, held, length)
    return jax.tree.unflatten(structure, leaves), manifest


def _restore(like: Any, rows: np.ndarray, held: np.ndarray | None, length: int) -> jax.Array:
    bits = rows
    if held is not None:
        bits = np.zeros((length, *rows.shape[1:]), rows.dtype)
        bits[held] = rows
    if _is_key(like):
        return jax.random.wrap_key_data(jnp.asarray(bits))
    return jnp.asarray(bits.view(like.dtype))


def _is_key(leaf: Any) -> bool:
    return isinstance(leaf, jax.Array) and jax.dtypes.issubdtype(leaf.dtype, jax.dtypes.prng_key)


def _as_bits(leaf: Any) -> np.ndarray:
    """View floats as integers: minus zero and NaN are no zeros, and they are stored as they are."""
    array = np.asarray(jax.random.key_data(leaf) if _is_key(leaf) else leaf)
    return array.view(f"u{array.itemsize}") if array.dtype.kind == "f" else array


def load_newest(saved: Sequence[Path], initial: Any) -> tuple[dict[str, Any], Any]:
    """Load the newest checkpoint that is whole, as `RunDirectory.load_checkpoint` says.

    Args:
        saved: checkpoints, the newest last.
        initial: state of a search that begins.
    """
    for older, path in enumerate(reversed(saved), start=1):
        try:
            state, manifest = load_checkpoint(path, initial)
            return {**manifest, "iteration": int(manifest["iteration"])}, state
        except (DamagedError, KeyError, TypeError) as error:
            if older == len(saved):
                raise InputError(
                    f"{error}: no checkpoint is whole, delete {path.parent} to begin anew"
                ) from error
            LOG.warning("%s: going on from the checkpoint before it", error)
    return {"iteration": 0}, initial
