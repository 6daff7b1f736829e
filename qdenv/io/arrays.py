"""Arrays and facts in .npz files: written whole or not at all, read within limits, no pickle.

The list of members is checked before it is read, a member's size before it is expanded, an array's
header before anything is allocated. Facts are JSON in a member of their own, so that one file is
one state: arrays and facts of different moments cannot meet.
"""

import json
import math
import os
import struct
import tokenize
import zipfile
import zlib
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from types import MappingProxyType
from typing import Any, BinaryIO, NamedTuple, TypeVar

import numpy as np

from qdenv.io.files import MEGABYTE, damaged, write_atomically
from qdenv.io.records import parse_json, structured
from qdenv.types import InputError

SCHEMA = 2
_MAX_MEMBERS = 10_000
_MAX_DIRECTORY = 4 * MEGABYTE  # bytes of the list of members
# An archive may expand to this many bytes, or else to this multiple of its own size.
MAX_EXPANDED, MAX_RATIO = 64 * MEGABYTE, 30
_MAX_HEADER = 1000  # characters of an array's header: what numpy parses as a Python literal
PIECE = 2**24  # bytes that are copied at once
# Errors that the zip module and numpy raise for wrong bytes.
_DAMAGES = (
    zipfile.BadZipFile,
    zlib.error,
    struct.error,
    EOFError,
    MemoryError,
    OverflowError,
    RuntimeError,
    SyntaxError,
    tokenize.TokenError,  # of a header that numpy takes for one of Python 2
    ValueError,
)
T = TypeVar("T")
# An array, or some rows of one ([N, ...], int [n]), which are written piece by piece.
Content = np.ndarray | tuple[np.ndarray, np.ndarray]


class Column(NamedTuple):
    """What an array must be."""

    kinds: str = "biuf"  # of numbers, as numpy's letters: b, i, u, f; U for text
    ndim: int | None = None  # number of axes; None for any
    finite: bool = False  # no NaN, no infinity


_ANY = Column("biufU")
_NONE: Mapping[str, Column] = MappingProxyType({})


@contextmanager
def open_zip(path: Path | str) -> Iterator[zipfile.ZipFile]:
    """Open an archive whose members are plain, few, and of a sensible size in all.

    Raises InputError if it cannot be read; `DamagedError` if it is not such an archive, or turns
    out to be damaged while it is open.
    """
    try:
        with open(path, "rb") as stream:
            _check_directory(stream, path)
            with zipfile.ZipFile(stream) as archive:
                _check_members(archive, os.fstat(stream.fileno()).st_size, path)
                yield archive
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror or error})") from error
    except InputError:
        raise
    except _DAMAGES as error:
        raise damaged(path, str(error) or type(error).__name__) from error


def _check_directory(stream: BinaryIO, source: Path | str) -> None:
    """Refuse an archive whose list of members is too long: zipfile would read all of it."""
    # By what zipfile itself finds at the end of the file (private names, older than Python 3).
    end = zipfile._EndRecData(stream)  # type: ignore[attr-defined]
    # None of our archives has a comment.
    if end is None or end[zipfile._ECD_COMMENT_SIZE]:  # type: ignore[attr-defined]
        raise damaged(source, "no archive, or its end is missing")
    if end[zipfile._ECD_SIZE] > _MAX_DIRECTORY:  # type: ignore[attr-defined]
        raise damaged(source, "too many members")
    stream.seek(0)


def _check_members(archive: zipfile.ZipFile, size: int, source: Path | str) -> None:
    """Refuse members that are encrypted, packed oddly, named twice, or too large in all."""
    members = archive.infolist()
    if len(members) > _MAX_MEMBERS or len({one.filename for one in members}) < len(members):
        raise damaged(source, "too many members, or two of one name")
    for one in members:
        plain = one.compress_type in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)
        if one.flag_bits & 1 or not plain:  # the bit of encryption
            raise damaged(source, f"{one.filename} is encrypted or packed in an unknown way")
    # Bombs of overlapping members expand the same bytes again and again.
    if sum(one.compress_size for one in members) > size:
        raise damaged(source, "members overlap")
    expanded = sum(one.file_size for one in members)
    if expanded > max(MAX_EXPANDED, MAX_RATIO * size):
        reason = f"would take {expanded // MEGABYTE:,} MB, the file has {size:,} bytes"
        raise damaged(source, reason)


def read_arrays(
    path: Path | str,
    columns: Mapping[str, Column] = _NONE,
    others: Column | None = _ANY,
    known: Mapping[str, Column] = _NONE,
) -> dict[str, np.ndarray]:
    """Read the arrays of an .npz file by name, without pickle.

    `columns` are those that must be there, `known` those that may. Further ones must be like
    `others`; where that is None they are not read. Raises InputError, which names the file and the
    array, if it cannot be read, or is damaged.
    """
    with open_zip(path) as archive:
        names = [name[:-4] for name in archive.namelist() if name.endswith(".npy")]
        if missing := [name for name in columns if name not in names]:
            raise damaged(path, f"{missing[0]} is missing")
        listed = {name: {**known, **columns}.get(name, others) for name in names}
        expected = {name: column for name, column in listed.items() if column is not None}
        for name, column in expected.items():  # all headers before any values
            _check_header(archive, name, column, path)
        arrays = {}
        for name, column in expected.items():
            with archive.open(f"{name}.npy") as member:
                values: np.ndarray = np.lib.format.read_array(
                    member, allow_pickle=False, max_header_size=_MAX_HEADER
                )
                member.read(1)  # the end, where the checksum is compared
            # Files of other machines: jax and numba take native byte order alone.
            values = values.astype(values.dtype.newbyteorder("="), copy=False)
            if column.finite and values.dtype.kind == "f" and not np.isfinite(values).all():
                raise damaged(path, f"{name} holds numbers that are not finite")
            arrays[name] = values
        return arrays


def _check_header(archive: zipfile.ZipFile, name: str, column: Column, path: Path | str) -> None:
    """Refuse an array of another kind, or whose size is not what its header announces."""
    with archive.open(f"{name}.npy") as member:
        try:
            version = np.lib.format.read_magic(member)
            read = {
                (1, 0): np.lib.format.read_array_header_1_0,
                (2, 0): np.lib.format.read_array_header_2_0,
            }[version]
            shape, _, dtype = read(member, _MAX_HEADER)
        except (KeyError, *_DAMAGES) as error:
            raise damaged(path, f"{name} is not an array of numbers") from error
        bytes_left = archive.getinfo(f"{name}.npy").file_size - member.tell()
    if dtype.kind not in _ANY.kinds or dtype.itemsize == 0 or min(shape, default=0) < 0:
        raise damaged(path, f"{name} is not an array of numbers")
    if math.prod(shape) * dtype.itemsize != bytes_left:
        raise damaged(path, f"{name} has another size than its header says")
    if dtype.kind not in column.kinds:
        raise damaged(path, f"{name} holds {dtype}, not numbers of kind {column.kinds}")
    if column.ndim is not None and len(shape) != column.ndim:
        raise damaged(path, f"{name} has {len(shape)} axes, not {column.ndim}")


def write_arrays(path: Path, arrays: Mapping[str, Content], compressed: bool = False) -> None:
    """Write named arrays as .npz, atomically; rows become an array of their own."""

    def write(file: BinaryIO) -> None:
        with zipfile.ZipFile(file, "w") as archive:
            for name, content in arrays.items():
                entry = zipfile.ZipInfo(f"{name}.npy")
                # Fractions are weights, which are noise: compressing them saves a fourteenth and
                # takes eight times as long as all else.
                if compressed and (isinstance(content, tuple) or content.dtype.kind != "f"):
                    entry.compress_type = zipfile.ZIP_DEFLATED
                with archive.open(entry, "w", force_zip64=True) as member:
                    if not isinstance(content, tuple):
                        np.lib.format.write_array(member, np.asarray(content), allow_pickle=False)
                        continue
                    array, rows = content
                    header = np.lib.format.header_data_from_array_1_0(array[:0])
                    header["shape"] = (len(rows), *array.shape[1:])
                    np.lib.format.write_array_header_1_0(member, header)
                    step = max(1, PIECE // max(array[:1].nbytes, 1))
                    for start in range(0, len(rows), step):
                        member.write(array[rows[start : start + step]].tobytes())

    write_atomically(path, write)


def write_state(
    path: Path, arrays: Mapping[str, Content], facts: Mapping[str, Any], member: str
) -> None:
    """Write the arrays of a state and, as `member`, JSON-ready facts about it, atomically."""
    text = json.dumps({"schema": SCHEMA, **facts})
    write_arrays(path, {**arrays, member: np.frombuffer(text.encode(), np.uint8)})


def read_state(path: Path, member: str, kind: type[T]) -> tuple[dict[str, np.ndarray], T]:
    """Read what `write_state` wrote: (arrays, facts); `kind` is the type of the facts.

    Raises DamagedError if the file is damaged, InputError if it does not exist or is newer.
    """
    if not path.exists():
        raise InputError(f"there is no checkpoint {path}: nothing to resume")
    arrays = read_arrays(path, {member: Column("u", 1)}, Column())
    place = f"{path}, {member}"
    content = parse_json(arrays.pop(member).tobytes().decode(errors="replace"), place)
    # First of all: the rest of a newer one may be of another form.
    schema = structured(content, dict[str, Any], place).get("schema")
    if structured(schema, int, f"{place}, schema") > SCHEMA:
        raise InputError(f"{path} was written by a newer qdenv: please upgrade")
    return arrays, structured(content, kind, place)
