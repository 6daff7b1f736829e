"""Arrays and facts in one .npz: written whole or not at all, read without pickle.

The facts are JSON stored as bytes in a member of their own, so that one file is one state: arrays
and facts of different moments cannot meet.
"""

import json
import zipfile
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, BinaryIO, NamedTuple, TypeVar

import numpy as np

from qdenv.files import write_atomically
from qdenv.reading.arrays import Column, read_arrays
from qdenv.reading.json import parse_json
from qdenv.reading.strict import structured
from qdenv.types import InputError

SCHEMA = 2  # 1: a search held one dense array of solutions for each archive; still read
PIECE = 2**24  # bytes that are copied at once
NUMBERS = Column()
T = TypeVar("T")


class _Written(NamedTuple):
    """What every state says of itself."""

    schema: int


class Rows(NamedTuple):
    """Some rows of an array, which are copied piece by piece when they are written."""

    array: np.ndarray  # [N, ...]
    numbers: np.ndarray  # int [n], which rows

    def pieces(self) -> Iterator[np.ndarray]:
        """Copy the rows, about `PIECE` bytes at a time."""
        row = self.array[:1].nbytes
        step = max(1, PIECE // max(row, 1))
        for start in range(0, len(self.numbers), step):
            yield self.array[self.numbers[start : start + step]]


def write_arrays(
    path: Path, arrays: Mapping[str, np.ndarray | Rows], compressed: bool = False
) -> None:
    """Write named arrays as .npz, atomically; rows of an array become an array of their own.

    Args:
        path: the .npz file.
        arrays: by name.
        compressed: whether to compress those that are no fractions: weights are noise, of which
            compressing saves a fourteenth and takes eight times as long as all else.

    Raises:
        InputError: the file cannot be written.
    """

    def write(file: BinaryIO) -> None:
        with zipfile.ZipFile(file, "w") as archive:
            for name, content in arrays.items():
                entry = zipfile.ZipInfo(f"{name}.npy")
                if compressed and not (
                    isinstance(content, np.ndarray) and content.dtype.kind == "f"
                ):
                    entry.compress_type = zipfile.ZIP_DEFLATED
                with archive.open(entry, "w", force_zip64=True) as member:
                    _write_member(member, content)

    write_atomically(path, write)


def _write_member(member: Any, content: np.ndarray | Rows) -> None:
    if isinstance(content, Rows):
        header = np.lib.format.header_data_from_array_1_0(content.array[:0])
        header["shape"] = (len(content.numbers), *content.array.shape[1:])
        np.lib.format.write_array_header_1_0(member, header)
        for piece in content.pieces():
            member.write(piece.tobytes())
    else:
        np.lib.format.write_array(member, np.asarray(content), allow_pickle=False)


def write_state(
    path: Path, arrays: Mapping[str, np.ndarray | Rows], facts: Mapping[str, Any], member: str
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


def read_state(path: Path, member: str, kind: type[T]) -> tuple[dict[str, np.ndarray], T]:
    """Read what `write_state` wrote: (arrays, facts).

    Args:
        path: the .npz file.
        member: name under which the facts are stored.
        kind: NamedTuple of the facts that are needed.

    Raises:
        DamagedError: the file is damaged.
        InputError: there is no such file, or it is of a newer schema.
    """
    if not path.exists():
        raise InputError(f"there is no checkpoint {path}: nothing to resume")
    arrays = read_arrays(path, {member: Column("u", 1)}, NUMBERS)
    place = f"{path}, {member}"
    content = parse_json(arrays.pop(member).tobytes().decode(errors="replace"), place)
    if structured(content, _Written, place).schema > SCHEMA:
        raise InputError(f"{path} was written by a newer qdenv: please upgrade")
    return arrays, structured(content, kind, place)
