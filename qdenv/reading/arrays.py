"""Arrays in .npz: headers are read by their plain form and checked before anything is allocated."""

import math
import re
import zipfile
from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType
from typing import NamedTuple

import numpy as np

from qdenv.reading.files import damaged
from qdenv.reading.zips import open_zip

MAGIC = b"\x93NUMPY"
LENGTHS = {1: 2, 2: 4, 3: 4}  # bytes of the header's length, by version of the format
LONGEST_HEADER = 1000
HEADER = re.compile(
    r"\{'descr': '([<>|=]?)([biufU])([0-9]{1,4})', "
    r"'fortran_order': (True|False), 'shape': \(((?:[0-9]{1,18},? ?){0,32})\), \} *\n"
)
SIZES = {"b": (1,), "i": (1, 2, 4, 8), "u": (1, 2, 4, 8), "f": (2, 4, 8), "U": range(1, 1001)}
ENDING = ".npy"
PIECE = 2**18  # bytes that are expanded at once


class Column(NamedTuple):
    """What an array must be."""

    kinds: str = "biuf"  # of numbers, as numpy's letters: b, i, u, f; U for words
    ndim: int | None = None  # number of axes; None for any
    finite: bool = False  # no NaN, no infinity


class Header(NamedTuple):
    """What the head of a member says."""

    dtype: np.dtype  # of the array
    shape: tuple[int, ...]  # of the array
    fortran: bool  # the first axis varies fastest
    length: int  # bytes of the head


ANY = Column("biufU")
NONE: Mapping[str, Column] = MappingProxyType({})


def read_arrays(
    path: Path | str,
    columns: Mapping[str, Column] = NONE,
    others: Column | None = ANY,
    known: Mapping[str, Column] = NONE,
) -> dict[str, np.ndarray]:
    """Read an .npz file, without pickle.

    Args:
        path: the file.
        columns: arrays that must be there, by name.
        others: what further arrays must be; None for: none is read.
        known: what some further arrays must be, if they are there.

    Returns:
        arrays by name.

    Raises:
        InputError: it cannot be read, or is damaged; the line names the file and the array.
    """
    with open_zip(path) as archive:
        names = [name.removesuffix(ENDING) for name in archive.namelist() if name.endswith(ENDING)]
        if missing := [name for name in columns if name not in names]:
            raise damaged(path, f"{missing[0]} is missing")
        wanted = {name: {**known, **columns}.get(name, others) for name in names}
        kept = {name: column for name, column in wanted.items() if column is not None}
        heads = {name: _read_header(archive, name, path) for name in kept}
        for name, column in kept.items():
            _check(heads[name], column, name, path)
        return {
            name: _read_values(archive, name, heads[name], column.finite, path)
            for name, column in kept.items()
        }


def _read_header(archive: zipfile.ZipFile, name: str, source: Path | str) -> Header:
    """Read the head of a member; its size must be that of the array it announces.

    numpy's own reader evaluates the head as Python; what numpy writes is always of one form.
    """
    with archive.open(name + ENDING) as member:
        magic = member.read(8)
        count = LENGTHS.get(magic[6], 0) if magic[:6] == MAGIC and len(magic) == 8 else 0
        length = int.from_bytes(member.read(count), "little")
        text = member.read(min(length, LONGEST_HEADER)).decode("latin-1")
    found = HEADER.fullmatch(text)
    if not count or not found or int(found[3]) not in SIZES[found[2]]:
        raise damaged(source, f"{name} is no array of numbers")
    size = int(found[3]) * (4 if found[2] == "U" else 1)
    shape = tuple(int(part) for part in found[5].replace(" ", "").split(",") if part)
    head = 8 + count + length
    if head + math.prod(shape) * size != archive.getinfo(name + ENDING).file_size:
        raise damaged(source, f"{name} has another size than its head says")
    return Header(np.dtype("".join(found.groups()[:3])), shape, found[4] == "True", head)


def _check(header: Header, column: Column, name: str, source: Path | str) -> None:
    if header.dtype.kind not in column.kinds:
        raise damaged(source, f"{name} holds {header.dtype}, not numbers of kind {column.kinds}")
    if column.ndim is not None and len(header.shape) != column.ndim:
        raise damaged(source, f"{name} has {len(header.shape)} axes, not {column.ndim}")


def _read_values(
    archive: zipfile.ZipFile, name: str, header: Header, finite: bool, source: Path | str
) -> np.ndarray:
    shape = header.shape[::-1] if header.fortran else header.shape
    values = np.empty(shape, header.dtype)
    space = values.reshape(-1).view(np.uint8) if values.size else np.empty(0, np.uint8)
    with archive.open(name + ENDING) as member:
        member.read(header.length)
        for start in range(0, max(space.size, 1), PIECE):
            piece = space[start : start + PIECE]
            got = member.readinto(piece.data)  # type: ignore[attr-defined]
            if got < piece.size:
                raise damaged(source, f"{name} is cut")
        member.read(1)  # the end, where the checksum is looked at
    values = values.astype(header.dtype.newbyteorder("="), copy=False)
    if finite and values.dtype.kind == "f" and not np.isfinite(values).all():
        raise damaged(source, f"{name} holds numbers that are not finite")
    return values.T if header.fortran else values
