"""Writing files so that a crash, a full disk or a kill never leaves half of one."""

import codecs
import contextlib
import csv
import errno
import io
import json
import os
import stat
import tempfile
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from qdenv.interrupt import unfinished
from qdenv.types import DamagedError, InputError

# Prefix of the names under which `write_atomically` writes. It is ours alone: `sweep` deletes by
# it, and a user's hidden files must never match.
TEMPORARY_PREFIX = ".qdenv-tmp-"
DIGITS = 6  # significant ones of a number in a file: single precision holds no more


def write_atomically(path: Path, content: bytes | Callable[[BinaryIO], None]) -> None:
    """Write under a temporary name beside `path`, sync, rename: the old file lives until then.

    Args:
        path: the file to make or replace; its folder is made if need be.
        content: the bytes, or a function that writes them to an open binary file.

    Raises:
        InputError: the place cannot be written to (read-only, full, not a folder).
    """
    temporary = None
    path = Path(os.path.realpath(path))  # what a link stands for is written, the link stays
    try:
        if path.exists() and not path.is_file() and not path.is_dir():
            _write_through(path, content)
            return
        path.parent.mkdir(parents=True, exist_ok=True)
        mode = _mode_of(path)
        handle, temporary = tempfile.mkstemp(
            dir=path.parent, prefix=f"{TEMPORARY_PREFIX}{path.name}."
        )
        unfinished.add(temporary)
        with os.fdopen(handle, "wb") as file:
            if isinstance(content, bytes):
                file.write(content)
            else:
                content(file)
            file.flush()
            os.fsync(file.fileno())
        os.chmod(temporary, mode)
        os.replace(temporary, path)
    except OSError as error:
        raise InputError(
            f"{path}: cannot be written ({error.strerror or error}): free some space or choose "
            "another place; what was written before is intact"
        ) from error
    finally:  # whatever went wrong, nothing half written stays
        if temporary is not None:
            with contextlib.suppress(OSError):
                os.unlink(temporary)
            unfinished.discard(temporary)


def _mode_of(path: Path) -> int:
    """Choose a file's permissions: those that it has, or an ordinary file's."""
    if not path.is_file():
        return 0o666 & ~_UMASK
    mode = stat.S_IMODE(path.stat().st_mode)
    if not mode & 0o222:
        raise PermissionError(errno.EACCES, "the file is read-only")
    return mode


def sweep(folder: Path) -> None:
    """Delete the temporary files that a killed process left in a folder, and nothing else.

    Args:
        folder: must be locked, so that no other process is writing there.
    """
    for path in folder.glob(f"{TEMPORARY_PREFIX}*"):
        with contextlib.suppress(OSError):
            path.unlink()


def _write_through(path: Path, content: bytes | Callable[[BinaryIO], None]) -> None:
    """Write to a device or a pipe, like /dev/stdout, which must not become a file."""
    buffer = io.BytesIO()
    if isinstance(content, bytes):
        buffer.write(content)
    else:
        content(buffer)
    with path.open("wb") as device:
        device.write(buffer.getvalue())


def write_json(path: Path, content: Any) -> None:
    """Write JSON-ready values with one entry a line, atomically.

    Raises:
        InputError: the place cannot be written to.
    """
    write_atomically(path, (json.dumps(content, indent=1) + "\n").encode())


def write_csv(path: Path, header: Sequence[str], rows: Iterable[Sequence[Any]]) -> None:
    """Write a table as CSV, atomically.

    Raises:
        InputError: the place cannot be written to.
    """
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(header)
    writer.writerows(rows)
    write_atomically(path, text.getvalue().encode())


# mkstemp makes private files; results are ordinary ones. The mask can only be read by setting it.
_UMASK = os.umask(0)
os.umask(_UMASK)


def tidy(value: Any) -> Any:
    """Turn values into JSON's: numpy's to Python's, six digits, null for what is no number."""
    if isinstance(value, Mapping):
        return {str(name): tidy(one) for name, one in value.items()}
    if isinstance(value, list | tuple | np.ndarray):
        return [tidy(one) for one in value]
    if isinstance(value, bool | np.bool_):
        return bool(value)
    if isinstance(value, int | np.integer):
        return int(value)
    if isinstance(value, float | np.floating):
        return float(f"{value:.{DIGITS}g}") if np.isfinite(value) else None
    return value if isinstance(value, str | None) else str(value)


MEGABYTE = 2**20
LARGEST = 64 * MEGABYTE  # of a file of text
UTF_16 = (codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)


def damaged(source: Path | str, reason: object) -> DamagedError:
    """Make the error for a file that holds something else than it should."""
    return DamagedError(f"{source}: cannot be read ({reason})")


def unreadable(path: Path | str, error: OSError) -> InputError:
    """Make the error for a file that the system does not give out."""
    return InputError(f"{path}: cannot be read ({error.strerror or error})")


def read_bytes(path: Path | str, most: int = LARGEST) -> bytes:
    """Read a whole file, or what a pipe gives.

    Args:
        path: the file.
        most: bytes; no more are ever read.

    Raises:
        InputError: it cannot be read, or is bigger.
    """
    try:
        with open(path, "rb") as file:
            content = file.read(most + 1)
    except OSError as error:
        raise unreadable(path, error) from error
    except ValueError as error:  # a name that no file can have
        raise InputError(f"{path}: cannot be read ({error})") from error
    if len(content) > most:
        raise damaged(path, f"bigger than {most // MEGABYTE} MB")
    return content


def read_text(path: Path | str, most: int = LARGEST, what: str = "text") -> str:
    """Read a text file as UTF-8, or as the UTF-16 of Windows' shell.

    Args:
        path: the file, or a pipe.
        most: bytes of it.
        what: the file should hold, for the message.

    Raises:
        InputError: it cannot be read, is bigger, or is no text.
    """
    content = read_bytes(path, most)
    try:
        return content.decode("utf-16" if content.startswith(UTF_16) else "utf-8-sig")
    except UnicodeDecodeError as error:
        raise damaged(path, f"not a {what} file: {error}") from error
