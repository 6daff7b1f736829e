"""Files of the trainer: weights, checkpoints; written whole or not at all, no pickle."""

import json
import zipfile
from pathlib import Path
from typing import Any

import jax
import numpy as np

from qdenv.files import write_atomically
from qdenv.simulate.maze.policy import Weights
from qdenv.types import InputError

SCHEMA = 1
_FACTS = "facts"


def save_weights(weights: Weights, path: Path, dtype: type = np.float32) -> None:
    """Write an agent that `policy.load_weights` reads.

    Raises:
        InputError: the file cannot be written.
    """
    named = {name: np.asarray(array, dtype) for name, array in weights._asdict().items()}
    write_atomically(path, lambda file: np.savez_compressed(file, **named))


def save_state(path: Path, state: Any, facts: dict[str, Any]) -> None:
    """Write a pytree of arrays with JSON-ready facts beside it.

    Raises:
        InputError: the file cannot be written.
    """
    arrays = {str(number): np.asarray(leaf) for number, leaf in enumerate(jax.tree.leaves(state))}
    arrays[_FACTS] = np.frombuffer(json.dumps({"schema": SCHEMA, **facts}).encode(), np.uint8)
    write_atomically(path, lambda file: np.savez(file, **arrays))


def load_state(path: Path, like: Any) -> tuple[Any, dict[str, Any]]:
    """Read what `save_state` wrote, bit for bit.

    Args:
        path: the .npz file.
        like: pytree of the same structure, shapes and kinds.

    Returns:
        (state, facts).

    Raises:
        InputError: missing, damaged, newer, or of a run with other sizes.
    """
    leaves, structure = jax.tree.flatten(like)
    try:
        with np.load(path, allow_pickle=False) as file:
            facts = json.loads(file[_FACTS].tobytes())
            found = [file[str(number)] for number in range(len(file.files) - 1)]
    except FileNotFoundError:
        raise InputError(f"there is no checkpoint {path}: train without --resume first") from None
    except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile) as error:
        raise InputError(f"{path} is no readable checkpoint: {error}") from None
    if facts["schema"] > SCHEMA:
        raise InputError(f"{path} was written by a newer qdenv: please upgrade")
    ours = [(leaf.shape, leaf.dtype) for leaf in leaves]
    if [(leaf.shape, leaf.dtype) for leaf in found] != ours:
        raise InputError(f"{path} belongs to a run with other sizes: keep units, lanes and bank")
    return jax.tree.unflatten(structure, [jax.numpy.asarray(leaf) for leaf in found]), facts
