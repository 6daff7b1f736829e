"""File operations that fail: the process dies at one of them, the disk is full, one fails."""

import builtins
import errno
import io
import os
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import Any, Literal
from unittest import mock

from qdenv.io.files import LOCK  # the system frees it when a process dies

Kind = Literal["death", "full disk", "failure"]
NEVER = 2**62
WRITING = os.O_WRONLY | os.O_RDWR | os.O_CREAT


class DeathError(BaseException):
    """Stands for the end of the process: nothing may catch it and go on."""


class FaultyDisk:
    """Counts the file operations in a folder and lets one of them fail."""

    def __init__(self, folder: Path, kind: Kind = "death", at: int = NEVER, late: bool = False):
        """Choose what fails.

        Args:
            folder: whose files count, with all below it.
            kind: death: nothing works any more. Full disk: nothing can be written any more.
                Failure: one operation fails.
            at: number of the operation, from 1.
            late: the operation is still done before the process dies.
        """
        self._folder, self._kind, self._at, self._late = str(folder), kind, at, late
        self._handles: set[int] = set()  # open files of `os.open`
        self.operations, self.happened = 0, False

    @contextmanager
    def active(self) -> Iterator[None]:
        """Replace the file operations of this process."""
        names = ("replace", "rename", "unlink", "remove", "mkdir", "chmod")
        patches = [
            (os, name, self._operation(getattr(os, name), name == "mkdir")) for name in names
        ]
        patches += [(os, "fsync", self._operation(os.fsync, True)), (os, "open", self._os_open)]
        self._real_os_open, self._real_open = os.open, io.open
        patches += [(module, "open", self._open) for module in (io, builtins)]
        with ExitStack() as stack:
            for module, name, replacement in patches:
                stack.enter_context(mock.patch.object(module, name, replacement))
            try:
                yield
            finally:  # as the system does when a process dies
                for handle in self._handles:
                    os.close(handle)

    def step(
        self, do: Callable[[], Any], writes: bool, close: Callable[[Any], None] | None = None
    ) -> Any:
        """Do one operation, unless it fails.

        Args:
            do: the operation.
            writes: whether it fails on a full disk.
            close: closes the result, as the system does when a process dies.
        """
        self.operations += 1
        now = self.operations == self._at
        if self._kind == "death" and (now or self.happened):
            self.happened = True
            if now and self._late:
                with suppress(OSError):
                    result = do()
                    if close:
                        close(result)
            raise DeathError
        code = errno.ENOSPC if self._kind == "full disk" else errno.EIO
        full = self._kind == "full disk" and self.operations >= self._at and writes
        if full or (self._kind == "failure" and now):
            self.happened = True
            raise OSError(code, os.strerror(code))
        return do()

    def _inside(self, place: Any) -> bool:
        if isinstance(place, int):
            return place in self._handles
        return os.fspath(place).startswith(self._folder)

    def _operation(self, original: Callable[..., Any], writes: bool) -> Callable[..., Any]:
        def operation(place: Any, *rest: Any, **options: Any) -> Any:
            if not self._inside(place):
                return original(place, *rest, **options)
            if self.happened and self._kind == "death" and str(place).endswith(LOCK):
                return None
            return self.step(lambda: original(place, *rest, **options), writes)

        return operation

    def _os_open(self, place: Any, flags: int, *rest: Any, **options: Any) -> int:
        def do() -> int:
            return self._real_os_open(place, flags, *rest, **options)

        # A file without a name, in a folder, is how the library of the lock tries what it can do.
        if not flags & WRITING or not self._inside(place) or os.path.isdir(place):
            return do()
        handle: int = self.step(do, True, os.close)
        if not str(place).endswith(LOCK):
            self._handles.add(handle)
        return handle

    def _open(self, place: Any, mode: str = "r", *rest: Any, **options: Any) -> Any:
        def do() -> Any:
            return self._real_open(place, mode, *rest, **options)

        if not set(mode) & set("wax+") or not self._inside(place):
            return do()
        return self.step(lambda: File(do(), self), True, lambda file: file.__exit__(None))

    def forget(self, handle: int) -> None:
        """Leave a closed file to itself: another may have its number next."""
        self._handles.discard(handle)


class File:
    """A file open for writing, each write of which is an operation that can fail half way."""

    def __init__(self, file: Any, disk: FaultyDisk):
        """Wrap an open file."""
        self._file, self._disk = file, disk

    def write(self, content: Any) -> int:
        """Write, or half of it."""
        failed_before = self._disk.happened
        try:
            written: int = self._disk.step(lambda: self._file.write(content), True)
            return written
        except BaseException:
            if not failed_before:
                self._file.write(content[: len(content) // 2])
                self._file.flush()
            raise

    def __enter__(self) -> "File":
        """Enter the file."""
        self._file.__enter__()
        return self

    def __exit__(self, *error: Any) -> None:
        """Close the file."""
        self._disk.forget(self._file.fileno())
        self._file.close()

    def __getattr__(self, name: str) -> Any:
        """Return any other attribute of the file."""
        return getattr(self._file, name)
