"""Zip archives: the directory is looked at before it is read, a member before it is expanded."""

import os
import struct
import zipfile
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import BinaryIO

from qdenv.reading.files import MEGABYTE, damaged, unreadable
from qdenv.types import InputError

MOST_MEMBERS = 10_000
DIRECTORY = 4 * MEGABYTE  # bytes of the list of members
# What is expanded may be this large in all, or else this many times as large as the file.
EXPANDED, RATIO = 64 * MEGABYTE, 30
END, LOCATOR, END_64 = b"PK\5\6", b"PK\6\7", b"PK\6\6"
PLAIN = (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)
ENCRYPTED = 1  # bit of a member's flags
# What the zip module makes of wrong bytes.
DAMAGES = (
    zipfile.BadZipFile,
    zlib.error,
    struct.error,
    EOFError,
    OverflowError,
    RuntimeError,
    ValueError,
)


@contextmanager
def open_zip(path: Path | str) -> Iterator[zipfile.ZipFile]:
    """Open an archive whose members are plain, few, and of a sensible size in all.

    Raises:
        InputError: it cannot be read; `DamagedError` where it is no such archive, or turns out to
            be damaged while it is open.
    """
    try:
        with open(path, "rb") as stream:
            check_directory(stream, path)
            with zipfile.ZipFile(stream) as archive:
                check_members(archive, os.fstat(stream.fileno()).st_size, path)
                yield archive
    except OSError as error:
        raise unreadable(path, error) from error
    except InputError:
        raise
    except DAMAGES as error:
        raise damaged(path, str(error) or type(error).__name__) from error


def check_directory(stream: BinaryIO, source: Path | str) -> None:
    """Refuse an archive whose list of members is too long to read; it has no comment at its end.

    Raises:
        DamagedError: it is, or this is no archive.
    """
    size = stream.seek(0, os.SEEK_END)
    if size < 22:
        raise damaged(source, "no archive: too short")
    tail = _read_at(stream, max(0, size - 42), 42)
    end = tail[-22:]
    if end[:4] != END or end[20:] != b"\0\0":
        raise damaged(source, "no archive, or its end is missing")
    (directory,) = struct.unpack("<L", end[12:16])
    if tail[:4] == LOCATOR:  # of a long archive, whose true end comes before
        place = struct.unpack("<Q", tail[8:16])[0]
        long_end = _read_at(stream, place, 56) if place < size else b""
        if len(long_end) < 56 or long_end[:4] != END_64:
            raise damaged(source, "no archive, or its end is missing")
        (directory,) = struct.unpack("<Q", long_end[40:48])
    if directory > DIRECTORY:
        raise damaged(source, "too many members")
    stream.seek(0)


def _read_at(stream: BinaryIO, place: int, count: int) -> bytes:
    stream.seek(place)
    return stream.read(count)


def check_members(archive: zipfile.ZipFile, size: int, source: Path | str) -> None:
    """Refuse members that are encrypted, packed oddly, named twice, or too large in all.

    Args:
        archive: its list of members has been read, nothing else.
        size: bytes of the file.
        source: for messages.

    Raises:
        DamagedError: there is one.
    """
    members = archive.infolist()
    if len(members) > MOST_MEMBERS or len({one.filename for one in members}) < len(members):
        raise damaged(source, "too many members, or two of one name")
    for one in members:
        if one.flag_bits & ENCRYPTED or one.compress_type not in PLAIN:
            raise damaged(source, f"{one.filename} is encrypted or packed in an unknown way")
    if sum(one.compress_size for one in members) > size:
        raise damaged(source, "members overlap")
    expanded = sum(one.file_size for one in members)
    if expanded > max(EXPANDED, RATIO * size):
        raise damaged(
            source, f"would take {expanded // MEGABYTE:,} MB, the file has {size:,} bytes"
        )
