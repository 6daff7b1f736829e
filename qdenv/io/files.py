"""Files: written whole or not at all, read up to a limited size."""

import codecs
import contextlib
import csv
import errno
import io
import itertools
import json
import os
import re
import stat
import sys
import tempfile
import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from shlex import quote
from typing import Any, BinaryIO

import numpy as np

from qdenv.interrupt import reserved, unfinished
from qdenv.types import DamagedError, InputError

# Prefix of the names under which `write_atomically` writes. It is ours alone: `sweep` deletes by
# it, and a user's hidden files must never match.
TEMPORARY_PREFIX = ".qdenv-tmp-"
# Ours alone, too: old versions of the library of the lock empty the file.
LOCK = ".qdenv-lock"
# Files of all kinds of runs; a search or a training has one of the first two.
RUN_FILES = (
    *("config.json", "checkpoint.npz", "manifest.json", "metrics.csv", "notes.csv", "start.npz"),
    *("checkpoints", "archive.npz", "archive.png", "progress.png", "notes.png", "best_layout.png"),
    *("best_layout.json", "guidance.json", "guidance.png", "before_after.csv", "improve.json"),
    *("curve.jsonl", "agent.npz", "agents"),
)
MEGABYTE = 2**20
_MAX_TEXT = 64 * MEGABYTE  # bytes of a text file
_UTF_16_MARKS = (codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)
_UMASK = os.umask(0)  # it can only be read by setting it
os.umask(_UMASK)


def write_atomically(path: Path, content: bytes | Callable[[BinaryIO], object]) -> None:
    """Write under a temporary name beside `path`, sync, rename: the old file lives until then.

    `content` is the bytes, or a function that writes them to an open binary file; the folder is
    made if need be. Raises InputError if the place cannot be written to.
    """
    write = (lambda file: file.write(content)) if isinstance(content, bytes) else content
    temporary = None
    try:
        if (stream := find_stream(path)) is None:
            path = Path(os.path.realpath(path))  # what a link stands for is written, the link stays
        # Nor may a device or a pipe become a file.
        if stream is not None or not (path.is_file() or path.is_dir() or not path.exists()):
            sys.stdout.flush()  # what was printed before comes first
            buffer = io.BytesIO()
            write(buffer)  # some need to go back in what they write to
            with open(path if stream is None else os.dup(stream), "wb") as device:
                device.write(buffer.getvalue())
            return
        path.parent.mkdir(parents=True, exist_ok=True)
        # mkstemp makes private files; results keep their permissions, or are ordinary ones.
        mode = stat.S_IMODE(path.stat().st_mode) if path.is_file() else 0o666 & ~_UMASK
        if path.is_file() and not mode & 0o222:
            raise PermissionError(errno.EACCES, "the file is read-only")
        handle, temporary = tempfile.mkstemp(
            dir=path.parent, prefix=f"{TEMPORARY_PREFIX}{path.name}."
        )
        unfinished.add(temporary)
        with os.fdopen(handle, "wb") as file:
            write(file)
            file.flush()
            os.fsync(file.fileno())  # or a crash could leave the new name with no content
        os.chmod(temporary, mode)
        os.replace(temporary, path)
    except OSError as error:
        cure = "free some space or choose another place; what was written before is intact"
        reason = error.strerror or error
        raise InputError(f"{path}: cannot be written ({reason}): {cure}") from error
    finally:  # after any error, nothing half written stays
        if temporary is not None:
            with contextlib.suppress(OSError):
                os.unlink(temporary)
            unfinished.discard(temporary)


def find_stream(path: Path) -> int | None:
    """Return the number of the open file that a name like /dev/stdout stands for; None for others.

    Opened by its name once more, a file behind it would be written from its beginning.
    """
    for _ in range(9):  # links to links
        folder = os.path.realpath(path.parent)
        if re.fullmatch(rf"/dev/fd|/proc/{os.getpid()}(/task/\d+)?/fd", folder):
            return int(path.name) if path.name.isdecimal() else None
        if not path.is_symlink():
            break
        path = path.parent / os.readlink(path)
    return None


def check_writable(path: Path) -> None:
    """Raise InputError if a file cannot be written, or made, because something is read-only."""
    if path.exists() and not path.is_file():
        return  # a device or a pipe
    folder = next(one for one in Path(os.path.realpath(path)).parents if one.exists())
    if not folder.is_dir():
        raise InputError(f"{path}: cannot be written ({folder} is a file): choose another place")
    for place in (folder, path) if path.exists() else (folder,):
        if not os.access(place, os.W_OK):
            raise InputError(f"{path}: cannot be written ({place} is read-only): choose another")


def reserve(path: Path, folder: bool = False) -> Path:
    """Make an empty file, or folder, of the first free name of a kind: plan.json, plan-2.json, ...

    No other process gets this name. What is still empty at the end of the program is deleted.
    """
    parents = [one for one in path.parents if not one.exists()]
    path.parent.mkdir(parents=True, exist_ok=True)
    reserved.update(os.path.abspath(parent) for parent in parents)
    numbered = (path.with_name(f"{path.stem}-{n}{path.suffix}") for n in itertools.count(2))
    for free in itertools.chain([path], numbered):
        with contextlib.suppress(FileExistsError):
            if folder:
                free.mkdir()
            else:
                os.close(os.open(free, os.O_CREAT | os.O_EXCL, 0o666))
            reserved.add(os.path.abspath(free))
            return free
    raise AssertionError  # there is always another number


def sweep(folder: Path) -> None:
    """Delete the temporary files that a killed process left in a folder, which must be locked."""
    for path in folder.glob(f"{TEMPORARY_PREFIX}*"):
        with contextlib.suppress(OSError):
            path.unlink()


@contextlib.contextmanager
def locked(folder: Path) -> Iterator[None]:
    """Keep every other process from writing to the folder of a run, which is made if need be.

    The system frees the lock when this process ends, however it ends. What a process that was
    killed left half written is deleted. Raises InputError if another process is at work there, the
    place cannot be written to, or a file in it is a link.
    """
    # Here: it imports asyncio, a good part of what `check` takes altogether.
    import filelock

    lock = filelock.FileLock(folder / LOCK)
    try:
        folder.mkdir(parents=True, exist_ok=True)
        refuse_links(folder)
        lock.acquire(blocking=False)
    except filelock.Timeout:
        busy = f"{folder}: another process is at work on this run"
        raise InputError(f"{busy}: wait for it, or end it first") from None
    except OSError as error:
        raise InputError(f"{folder}: cannot be written to ({error.strerror or error})") from error
    try:
        for name in (".", "checkpoints", "agents"):  # other folders may be runs at work
            sweep(folder / name)
        yield
    finally:
        lock.release()


def refuse_links(folder: Path) -> None:
    """Raise InputError if anything in a folder, or in a folder in it, is a link."""
    for path in (*folder.glob("*"), *folder.glob("*/*")):
        if path.is_symlink():
            raise InputError(f"{path}: is a link, and would be written through: move it away first")


def write_json(path: Path, content: Any) -> None:
    """Write JSON-ready values with one entry a line, atomically."""
    write_atomically(path, (json.dumps(content, indent=1, default=np.generic.item) + "\n").encode())


def write_csv(path: Path, header: Sequence[str], rows: Iterable[Sequence[Any]]) -> None:
    """Write a table as CSV, atomically."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(header)
    writer.writerows(rows)
    write_atomically(path, text.getvalue().encode())


def tidy(value: Any) -> Any:
    """Turn values into JSON's: numpy's to Python's, six digits, null for NaN and infinity."""
    if isinstance(value, Mapping):
        return {str(name): tidy(one) for name, one in value.items()}
    if isinstance(value, list | tuple | np.ndarray):
        return [tidy(one) for one in value]
    value = value.item() if isinstance(value, np.generic) else value
    if isinstance(value, float):
        return float(f"{value:.6g}") if np.isfinite(value) else None  # float32 holds no more
    return value if isinstance(value, str | int | None) else str(value)


def refuse_second_run(folder: Path, begun: Sequence[str] = ()) -> None:
    """Raise InputError if a folder holds a run already, or a file that a new run would replace.

    `begun` are the names of files that a process which was killed left before its run counted.
    """
    for name in RUN_FILES:
        path = folder / name
        if name in begun or not (path.exists() or path.is_symlink()):
            continue
        if name in RUN_FILES[:2]:
            way = f"`qdenv resume {quote(str(folder))}` continues it, or name a new folder"
            raise InputError(f"{folder}: holds a run already; {way}")
        raise InputError(f"{path}: a run would replace it: name a new folder")


def damaged(source: Path | str, reason: object) -> DamagedError:
    """Make the error for a file with wrong content."""
    return DamagedError(f"{source}: cannot be read ({reason})")


@contextlib.contextmanager
def parsing(path: Path, what: str) -> Iterator[None]:
    """Turn any error of a library that reads `path` into DamagedError: not `what`.

    Its warnings, as of styles that do not matter here, are not shown.
    """
    try:
        with warnings.catch_warnings(action="ignore"):
            yield
    except InputError:
        raise
    except Exception as error:
        raise damaged(path, f"not {what}: {error}") from error


def read_bytes(path: Path | str, max_bytes: int = _MAX_TEXT) -> bytes:
    """Read a file, or what a pipe gives; raise InputError if it cannot be read, or is bigger."""
    try:
        with open(path, "rb") as file:
            content = file.read(max_bytes + 1)
    except (OSError, ValueError) as error:  # the latter is for a name that no file can have
        reason = getattr(error, "strerror", None) or error
        raise InputError(f"{path}: cannot be read ({reason})") from error
    if len(content) > max_bytes:
        raise damaged(path, f"bigger than {max_bytes // MEGABYTE} MB")
    return content


def read_text(path: Path | str, max_bytes: int = _MAX_TEXT, what: str = "text") -> str:
    """Read a text file, or what a pipe gives, as UTF-8 or the UTF-16 of Windows' shell.

    Raises InputError if it cannot be read, is bigger, or is not text: "not a `what` file".
    """
    content = read_bytes(path, max_bytes)
    try:
        return content.decode("utf-16" if content.startswith(_UTF_16_MARKS) else "utf-8-sig")
    except UnicodeDecodeError as error:
        raise damaged(path, f"not a {what} file: {error}") from error
