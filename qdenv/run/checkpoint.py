"""Checkpoints: a pytree of arrays as one .npz with a manifest inside, no pickle.

Only rows that hold anything but zeros are stored, and they are copied piece by piece: no second
copy of an archive is ever made.
"""

from __future__ import annotations

import logging
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from qdenv.io.arrays import SCHEMA, Rows, read_state, write_state
from qdenv.io.files import damaged
from qdenv.lazy import jax, jnp
from qdenv.search.store import stores_in
from qdenv.types import DamagedError, InputError

_MANIFEST = "manifest"
# A store doubles before a batch might not fit, and at most half of what it refers to is let go.
MOST_GROWN = 8
LOG = logging.getLogger(__name__)


class Manifest(NamedTuple):
    """What a checkpoint says beside its arrays."""

    iteration: int  # the last that is in it
    schema: int = SCHEMA  # of the checkpoint
    lengths: tuple[int, ...] = ()  # rows of each leaf
    # what decides the run's result; empty where an older qdenv did not say it
    settings: Mapping[str, Any] = {}


def save_checkpoint(path: Path, state: Any, manifest: dict[str, Any]) -> None:
    """Write `state` atomically.

    Args:
        path: the .npz file.
        state: pytree of arrays.
        manifest: JSON-ready facts of `Manifest`, ``iteration`` at least.

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


def load_checkpoint(path: Path, initial: Any) -> tuple[Any, Manifest]:
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
    arrays, manifest = read_state(path, _MANIFEST, Manifest)
    if manifest.iteration < 0:
        raise damaged(path, f"iteration {manifest.iteration}")
    leaves, structure = jax.tree.flatten(initial)
    plain = [_as_bits(leaf) for leaf in leaves]
    lengths = manifest.lengths
    if len(lengths) != len(leaves):
        raise another(path)
    growing = {id(leaf) for store in stores_in(initial) for leaf in store}
    for number, (leaf, like) in enumerate(zip(leaves, plain, strict=True)):
        # Taken out one by one: what is restored is not held twice for long.
        held = arrays.pop(f"{number}.changed", None)
        rows = check_leaf(arrays.pop(f"{number}.rows", None), held, like, path)
        fits = lengths[number] == (len(like) if like.ndim else 0)
        if id(leaf) in growing and held is not None:
            fits = 0 < lengths[number] <= MOST_GROWN * (len(held) + len(like))
        if not fits:
            raise another(path)
        bits = filled(rows, held, lengths[number], None, path)
        leaves[number] = _from_bits(bits, leaf)
    return jax.tree.unflatten(structure, leaves), manifest


def _is_key(leaf: Any) -> bool:
    return isinstance(leaf, jax.Array) and jax.dtypes.issubdtype(leaf.dtype, jax.dtypes.prng_key)


def _from_bits(bits: np.ndarray, like: Any) -> jax.Array:
    if _is_key(like):
        return jax.random.wrap_key_data(jnp.asarray(bits))
    return jnp.asarray(bits.view(like.dtype))


def _as_bits(leaf: Any) -> np.ndarray:
    """View floats as integers: minus zero and NaN are no zeros, and they are stored as they are."""
    array = np.asarray(jax.random.key_data(leaf) if _is_key(leaf) else leaf)
    return array.view(f"u{array.itemsize}") if array.dtype.kind == "f" else array


def load_newest(saved: Sequence[Path], initial: Any) -> tuple[Manifest, Any]:
    """Load the newest checkpoint that is whole, as `RunDirectory.load_checkpoint` says.

    Args:
        saved: checkpoints, the newest last.
        initial: state of a search that begins.
    """
    for older, path in enumerate(reversed(saved), start=1):
        try:
            state, manifest = load_checkpoint(path, initial)
            return manifest, state
        except DamagedError as error:
            if older == len(saved):
                raise InputError(
                    f"{error}: no checkpoint is whole, delete {path.parent} to begin anew"
                ) from error
            LOG.warning("%s: going on from the checkpoint before it", error)
    return Manifest(0), initial


def another(source: Path) -> InputError:
    """Make the error for a checkpoint whose arrays have other forms than this search's."""
    return InputError(f"{source}: belongs to another configuration")


def check_leaf(
    rows: np.ndarray | None, held: np.ndarray | None, like: np.ndarray, source: Path
) -> np.ndarray:
    """Refuse stored rows that are none of an array.

    Args:
        rows: as stored; None where they are missing.
        held: which rows of the array they are; None for an array without axes.
        like: the array of a search that begins; it may have another length.
        source: the file.

    Returns:
        `rows`.

    Raises:
        DamagedError: something is missing, or the parts contradict each other.
        InputError: they are of another configuration.
    """
    if rows is None or (held is None) != (like.ndim == 0):
        raise damaged(source, "an array is missing")
    if rows.dtype != like.dtype or rows.shape[1:] != like.shape[1:] or rows.ndim != like.ndim:
        raise another(source)
    if held is not None and (held.shape != (len(rows),) or held.dtype.kind not in "iu"):
        raise damaged(source, "an array does not say which of its rows are held")
    return rows


def filled(
    rows: np.ndarray, held: np.ndarray | None, length: int, base: np.ndarray | None, source: Path
) -> np.ndarray:
    """Put checked rows back into an array.

    Args:
        rows: [n, ...].
        held: int [n]; None for an array without axes.
        length: of the array.
        base: what stands in the other rows; zeros unless given.
        source: the file.

    Raises:
        InputError: a row lies outside.
    """
    if held is None:
        return rows
    if held.size and not 0 <= held.min() <= held.max() < length:
        raise another(source)
    array = np.zeros((length, *rows.shape[1:]), rows.dtype) if base is None else base.copy()
    array[held] = rows
    return array
