"""One writer for each run directory."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from qdenv.io.files import sweep
from qdenv.types import InputError


@contextmanager
def locked(folder: Path) -> Iterator[None]:
    """Keep every other process from writing into a folder, which is made if need be.

    The system frees the lock when this process ends, however it ends. What a process that was
    killed left half written is taken away.

    Args:
        folder: the run directory.

    Raises:
        InputError: another process is at work there, or the place cannot be written to.
    """
    # Only here: it imports asyncio, a good part of what `check` takes altogether.
    import filelock

    lock = filelock.FileLock(folder / ".lock", blocking=False)
    try:
        folder.mkdir(parents=True, exist_ok=True)
        lock.acquire()
    except filelock.Timeout:
        raise InputError(
            f"{folder}: another process is at work on this run: wait for it, or end it first"
        ) from None
    except OSError as error:
        raise InputError(f"{folder}: cannot be written to ({error.strerror or error})") from error
    try:
        for place in (folder, folder / "checkpoints"):
            sweep(place)
        yield
    finally:
        lock.release()
