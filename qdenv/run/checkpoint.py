"""Checkpoints: a pytree of arrays and a manifest in one .npz; what a resumed run must share.

Only rows that hold anything but zeros are stored, and they are copied piece by piece: no second
copy of an archive is ever made.
"""

from __future__ import annotations

import dataclasses
import json
import logging
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from qdenv.io.arrays import SCHEMA, Rows, read_state, write_state
from qdenv.io.files import damaged
from qdenv.lazy import jax, jnp
from qdenv.run.config import RunConfig, config_to_json
from qdenv.search.store import stores_in
from qdenv.types import DamagedError, InputError, Measure

_MANIFEST = "manifest"
# A store doubles before a batch might not fit, and at most half of what it refers to is let go.
_MOST_GROWN = 8
# Settings that decide how long a run takes or how far it goes, but none of its results.
_WITHOUT_EFFECT = ("evaluations", "checkpoint_every", "workers", "backend")
_LOG = logging.getLogger(__name__)


class Manifest(NamedTuple):
    """What a checkpoint holds beside its arrays."""

    iteration: int  # the last that is in it
    schema: int = SCHEMA  # of the checkpoint
    lengths: tuple[int, ...] = ()  # rows of each leaf
    settings: Mapping[str, Any] = {}  # what decides the run's result


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
    other = InputError(f"{path}: belongs to another configuration")
    if len(manifest.lengths) != len(leaves):
        raise other
    growing = {id(leaf) for store in stores_in(initial) for leaf in store}
    for number, (leaf, length) in enumerate(zip(leaves, manifest.lengths, strict=True)):
        like = _as_bits(leaf)
        # Taken out one by one: what is restored is not held twice for long.
        held, rows = arrays.pop(f"{number}.changed", None), arrays.pop(f"{number}.rows", None)
        if rows is None or (held is None) != (like.ndim == 0):
            raise damaged(path, "an array is missing")
        if rows.dtype != like.dtype or rows.shape[1:] != like.shape[1:] or rows.ndim != like.ndim:
            raise other
        bits = rows
        if held is None:
            fits = length == 0
        else:
            if held.shape != (len(rows),) or held.dtype.kind not in "iu":
                raise damaged(path, "an array does not say which of its rows are held")
            fits = length == len(like)
            if id(leaf) in growing:
                fits = 0 < length <= _MOST_GROWN * (len(held) + len(like))
            fits = fits and (not held.size or 0 <= held.min() <= held.max() < length)
        if not fits:
            raise other
        if held is not None:
            bits = np.zeros((length, *rows.shape[1:]), rows.dtype)
            bits[held] = rows
        if _is_key(leaf):
            leaves[number] = jax.random.wrap_key_data(jnp.asarray(bits))
        else:
            leaves[number] = jnp.asarray(bits.view(leaf.dtype))
    return jax.tree.unflatten(structure, leaves), manifest


def _is_key(leaf: Any) -> bool:
    return isinstance(leaf, jax.Array) and jax.dtypes.issubdtype(leaf.dtype, jax.dtypes.prng_key)


def _as_bits(leaf: Any) -> np.ndarray:
    """View floats as integers: minus zero and NaN differ from zero, and must be stored."""
    array = np.asarray(jax.random.key_data(leaf) if _is_key(leaf) else leaf)
    return array.view(f"u{array.itemsize}") if array.dtype.kind == "f" else array


def load_newest(saved: Sequence[Path], initial: Any) -> tuple[Manifest, Any]:
    """Load the newest undamaged checkpoint, as `RunDirectory.load_checkpoint` describes.

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
            _LOG.warning("%s: going on from the checkpoint before it", error)
    return Manifest(0), initial


def result_settings(
    config: RunConfig, measures: Sequence[Measure], reads: Mapping[str, str]
) -> dict[str, Any]:
    """Return what decides the result of a run, by the names of config.json (``algorithm.sigma0``).

    Args:
        config: the resolved configuration.
        measures: axes of the archive.
        reads: checksums of what the domain reads beside its settings.
    """
    axes = tuple((float(axis.low), float(axis.high), axis.cells) for axis in measures)
    found = {f"the {name} of checksum": reads[name] for name in reads}

    def collect(content: dict[str, Any], prefix: str) -> None:
        for name, value in content.items():
            if isinstance(value, dict):
                collect(value, f"{prefix}{name}.")
            elif name not in _WITHOUT_EFFECT:
                found[f"{prefix}{name}"] = value

    # Through JSON, so that it compares with what a checkpoint holds.
    collect(json.loads(json.dumps(config_to_json(dataclasses.replace(config, archive=axes)))), "")
    return found


def check_same_search(now: Mapping[str, Any], then: Mapping[str, Any], path: Path) -> None:
    """Refuse to resume with other settings than a checkpoint was made with.

    Args:
        now: `result_settings` of the run.
        then: those in the checkpoint; only names in both are compared, as new versions add some.
        path: the run directory.

    Raises:
        InputError: a setting differs; the line names it.
    """
    for name, value in now.items():
        if name in then and then[name] != value:
            raise InputError(
                f"{path}: its checkpoint was made with {name} {then[name]}, now it is {value}: "
                "put that back, or train anew in another folder"
            )
