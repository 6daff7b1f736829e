"""Files of the trainer: weights and checkpoints."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import DTypeLike

from qdenv.io.arrays import read_state, write_arrays, write_state
from qdenv.simulate.maze.policy import Weights, load_weights
from qdenv.types import InputError

_FACTS = "facts"


class Facts(NamedTuple):
    """What a checkpoint of a training says beside its arrays."""

    cpu_seconds: float = 0.0  # spent so far


def save_weights(weights: Weights, path: Path, dtype: DTypeLike = np.float32) -> None:
    """Write an agent that `policy.load_weights` reads.

    Raises:
        InputError: the file cannot be written.
    """
    named = zip(Weights._fields, weights, strict=True)
    arrays: dict[str, np.ndarray] = {name: np.asarray(array, dtype) for name, array in named}
    write_arrays(path, arrays, compressed=True)


def mean_weights(paths: Sequence[Path]) -> Weights:
    """Average agents of one training, weight by weight (Izmailov et al. 2018).

    Late agents of one training lie around a point that does better than they where mazes are
    unlike those of the training.

    Raises:
        InputError: a file is missing, damaged, or of an agent of another size.
    """
    every = [load_weights(path) for path in paths]
    for path, weights in zip(paths, every, strict=True):
        if [part.shape for part in weights] != [part.shape for part in every[0]]:
            raise InputError(f"{path}: an agent of another size than {paths[0]}")
    return Weights(*(np.mean(parts, axis=0) for parts in zip(*every, strict=True)))


def save_state(path: Path, state: Any, facts: dict[str, Any]) -> None:
    """Write a pytree of arrays with JSON-ready facts beside it.

    Raises:
        InputError: the file cannot be written.
    """
    leaves = jax.tree.leaves(state)
    write_state(path, {str(n): np.asarray(leaf) for n, leaf in enumerate(leaves)}, facts, _FACTS)


def load_state(path: Path, like: Any) -> tuple[Any, Facts]:
    """Read what `save_state` wrote, bit for bit.

    Args:
        path: the .npz file.
        like: pytree of the same structure, shapes and dtypes.

    Returns:
        (state, facts).

    Raises:
        InputError: missing, damaged, newer, or of a run with other sizes.
    """
    leaves, structure = jax.tree.flatten(like)
    arrays, facts = read_state(path, _FACTS, Facts)
    wanted = {str(number): (leaf.shape, leaf.dtype) for number, leaf in enumerate(leaves)}
    if {name: (leaf.shape, leaf.dtype) for name, leaf in arrays.items()} != wanted:
        raise InputError(f"{path} belongs to a run with other sizes: keep units, lanes and bank")
    return jax.tree.unflatten(structure, [jnp.asarray(arrays[name]) for name in wanted]), facts
