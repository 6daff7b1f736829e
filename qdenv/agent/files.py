"""Files of the trainer: weights and checkpoints."""

from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import DTypeLike

from qdenv.checkpoints import read_state, write_arrays, write_state
from qdenv.simulate.maze.policy import Weights
from qdenv.types import InputError

_FACTS = "facts"


class Facts(NamedTuple):
    """What a checkpoint of a training says beside its arrays.

    Attributes:
        cpu_seconds: spent so far.
    """

    cpu_seconds: float = 0.0


def save_weights(weights: Weights, path: Path, dtype: DTypeLike = np.float32) -> None:
    """Write an agent that `policy.load_weights` reads.

    Raises:
        InputError: the file cannot be written.
    """
    named = zip(Weights._fields, weights, strict=True)
    arrays: dict[str, np.ndarray] = {name: np.asarray(array, dtype) for name, array in named}
    write_arrays(path, arrays, compressed=True)


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
