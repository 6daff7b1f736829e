"""Arrays and facts in one .npz: written whole or not at all, read without pickle.

The facts are JSON stored as bytes in a member of their own, so that one file is one state: arrays
and facts of different moments cannot meet.
"""

import json
import zipfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from qdenv.files import write_atomically
from qdenv.types import InputError

SCHEMA = 1


def write_arrays(path: Path, arrays: Mapping[str, np.ndarray], compressed: bool = False) -> None:
    """Write named arrays as .npz, atomically.

    Raises:
        InputError: the file cannot be written.
    """
    save = np.savez_compressed if compressed else np.savez
    members: dict[str, Any] = dict(arrays)  # any name may be a member, says no stub of numpy

    def write(file: BinaryIO) -> None:
        save(file, **members)

    write_atomically(path, write)


def write_state(
    path: Path, arrays: Mapping[str, np.ndarray], facts: Mapping[str, Any], member: str
) -> None:
    """Write the arrays of a state and JSON-ready facts about it, atomically.

    Args:
        path: the .npz file.
        arrays: by name.
        facts: JSON-ready; ``schema`` is added.
        member: name under which the facts are stored.

    Raises:
        InputError: the file cannot be written.
    """
    text = json.dumps({"schema": SCHEMA, **facts})
    write_arrays(path, {**arrays, member: np.frombuffer(text.encode(), np.uint8)})


def read_state(path: Path, member: str) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
    """Read what `write_state` wrote: (arrays, facts).

    Raises:
        InputError: there is no such file, or it is damaged or of a newer schema.
    """
    try:
        with open(path, "rb") as stream, np.load(stream, allow_pickle=False) as file:
            arrays = dict(file)
        facts = json.loads(arrays.pop(member).tobytes())
        schema = facts["schema"]
    except FileNotFoundError:
        raise InputError(f"there is no checkpoint {path}: nothing to resume") from None
    except (OSError, ValueError, KeyError, TypeError, EOFError, zipfile.BadZipFile) as error:
        raise InputError(f"{path} is no readable checkpoint ({error})") from error
    if schema > SCHEMA:
        raise InputError(f"{path} was written by a newer qdenv: please upgrade")
    return arrays, facts
