"""Checkpoints: a pytree of arrays and a manifest in one .npz.

Only rows that hold anything but zeros are stored, and they are copied piece by piece: no second
copy of an archive is ever made.
"""

import logging
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from qdenv.io.arrays import Content, read_state, write_state
from qdenv.io.files import damaged
from qdenv.search.base import plain_key, stores_in
from qdenv.types import DamagedError, InputError

_MANIFEST = "manifest"
# A store doubles before a batch might not fit, and at most half of what it refers to is let go.
_MOST_GROWN = 8
_KEPT = 2  # checkpoints: if the newest is damaged, the run goes on from the one before
_LOG = logging.getLogger(__name__)


class Manifest(NamedTuple):
    """What a checkpoint holds beside its arrays."""

    iteration: int  # the last that is in it
    lengths: tuple[int, ...] = ()  # rows of each leaf
    settings: Mapping[str, Any] = {}  # what decides the run's result


def save_checkpoint(run: Path, iteration: int, state: Any, settings: Mapping[str, Any]) -> None:
    """Write the state of a search after `iteration`, a pytree of arrays; the one before stays.

    `run` is the run directory; `settings`, JSON-ready, are what decides the run's result. Raises
    InputError if the file cannot be written.
    """
    arrays: dict[str, Content] = {}
    leaves = [_as_bits(leaf) for leaf in jax.tree.leaves(state)]
    for number, leaf in enumerate(leaves):
        arrays[f"{number}.rows"] = leaf
        if leaf.ndim:
            # Most cells of an archive are empty for most of a run: their rows are zeros.
            held = np.flatnonzero(leaf.reshape(len(leaf), -1).any(axis=1)).astype(np.int32)
            arrays[f"{number}.changed"] = held
            arrays[f"{number}.rows"] = leaf, held
    lengths = [leaf.shape[0] if leaf.ndim else 0 for leaf in leaves]
    manifest = {"lengths": lengths, "iteration": iteration, "settings": settings}
    write_state(run / "checkpoints" / f"{iteration:06d}.npz", arrays, manifest, _MANIFEST)
    for old in _list(run)[:-_KEPT]:
        old.unlink(missing_ok=True)


def load_newest(run: Path, initial: Any, settings: Mapping[str, Any]) -> tuple[int, Any]:
    """Load the newest undamaged checkpoint, with a warning where a newer one is damaged.

    Returns (iteration, state), bit for bit; 0 and `initial`, the state of a search that begins,
    where none is saved. Raises InputError if all are damaged, or they are of another search, other
    `settings` or a newer qdenv.
    """
    saved = _list(run)
    for path in reversed(saved):
        try:
            state, manifest = _load(path, initial)
        except DamagedError as error:
            if path == saved[0]:
                raise InputError(f"{error}: none is whole, train in another folder") from error
            _LOG.warning("%s: going on from the checkpoint before it", error)
            continue
        for name, value in settings.items():
            # Only names in both are compared, as new versions add some.
            if manifest.settings.get(name, value) != value:
                made = f"its checkpoint was made with {name} {manifest.settings[name]}"
                cure = "put that back, or train in another folder"
                raise InputError(f"{run}: {made}, now it is {value}: {cure}")
        return manifest.iteration, state
    return 0, initial


def _list(run: Path) -> list[Path]:
    """List the checkpoints of a run, the newest last; files of other names are not ours."""
    every = (run / "checkpoints").glob("*.npz")
    ours = (path for path in every if re.fullmatch(r"[0-9]{6,9}", path.stem))
    return sorted(ours, key=lambda path: int(path.stem))


def _load(path: Path, initial: Any) -> tuple[Any, Manifest]:
    """Read a checkpoint: (state, manifest); stores may be longer or shorter than in `initial`."""
    arrays, manifest = read_state(path, _MANIFEST, Manifest)
    if manifest.iteration < 0:
        raise damaged(path, f"iteration {manifest.iteration}")
    leaves, structure = jax.tree.flatten(initial)
    other = InputError(f"{path}: belongs to another configuration")
    if len(manifest.lengths) != len(leaves):
        raise other
    growing = {id(leaf) for store in stores_in(initial) for leaf in store}
    for number, (leaf, length) in enumerate(zip(leaves, manifest.lengths, strict=True)):
        like = _as_bits(leaf)
        # Taken out one by one: what is restored is not held twice for long.
        held, bits = arrays.pop(f"{number}.changed", None), arrays.pop(f"{number}.rows", None)
        if bits is None or (held is None) != (like.ndim == 0):
            raise damaged(path, "an array is missing")
        if bits.dtype != like.dtype or bits.shape[1:] != like.shape[1:] or bits.ndim != like.ndim:
            raise other
        if held is None:
            fits = length == 0
        elif held.shape != (len(bits),) or held.dtype.kind not in "iu":
            raise damaged(path, "an array does not say which of its rows are held")
        else:
            fits = length == len(like)
            if id(leaf) in growing:
                fits = 0 < length <= _MOST_GROWN * (len(held) + len(like))
            fits = fits and (not held.size or 0 <= held.min() <= held.max() < length)
        if not fits:
            raise other
        if held is not None:
            rows, bits = bits, np.zeros((length, *bits.shape[1:]), bits.dtype)
            bits[held] = rows
        if jnp.issubdtype(leaf.dtype, jax.dtypes.prng_key):
            leaves[number] = jax.random.wrap_key_data(jnp.asarray(bits))
        else:
            leaves[number] = jnp.asarray(bits.view(leaf.dtype))
    return jax.tree.unflatten(structure, leaves), manifest


def _as_bits(leaf: Any) -> np.ndarray:
    """View floats as integers: minus zero and NaN differ from zero, and must be stored."""
    array = np.asarray(plain_key(leaf))
    return array.view(f"u{array.itemsize}") if array.dtype.kind == "f" else array
