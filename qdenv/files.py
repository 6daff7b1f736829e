"""Writing files so that a crash, a full disk or a kill never leaves half of one."""

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
from qdenv.types import InputError

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
