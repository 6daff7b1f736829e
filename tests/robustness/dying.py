"""File operations that go wrong: the process dies at one of them, the disk is full, one fails."""

import builtins
import errno
import io
import os
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import Any, Literal
from unittest import mock

Kind = Literal["death", "full disk", "failure"]
NEVER = 2**62
WRITING = os.O_WRONLY | os.O_RDWR | os.O_CREAT
LOCK = ".lock"  # the system frees it when a process dies


class DeathError(BaseException):
    """Stands for the end of the process: nothing may catch it and go on."""


class Trouble:
    """Counts the file operations in a folder and lets one of them go wrong.

    Attributes:
        operations: how many there were.
        happened: whether it went wrong.
    """

    def __init__(self, folder: Path, kind: Kind = "death", at: int = NEVER, late: bool = False):
        """Let nothing go wrong yet.

        Args:
            folder: whose files count, with all below it.
            kind: death: nothing works any more. Full disk: nothing can be written any more.
                Failure: one operation fails.
            at: number of the operation, from 1.
            late: the operation is done all the same, before the process dies.
        """
        self._folder, self._kind, self._at, self._late = str(folder), kind, at, late
        self._handles: set[int] = set()
        self.operations, self.happened = 0, False

    @contextmanager
    def looming(self) -> Iterator[None]:
        """Watch the file operations of this process, and let one go wrong."""
        opened = io.open
        with ExitStack() as stack:
            for name in ("replace", "rename", "unlink", "remove", "mkdir", "chmod"):
                watched = self._watched(getattr(os, name), needs_room=name == "mkdir")
                stack.enter_context(mock.patch.object(os, name, watched))
            stack.enter_context(mock.patch.object(os, "open", self._watched_open(os.open)))
            stack.enter_context(mock.patch.object(os, "fsync", self._watched(os.fsync, True)))
            for module in (io, builtins):
                stack.enter_context(mock.patch.object(module, "open", self._watched_file(opened)))
            try:
                yield
            finally:  # as the system does for the dead
                for handle in self._handles:
                    os.close(handle)

    def _is_ours(self, place: Any) -> bool:
        if isinstance(place, int):
            return place in self._handles
        return os.fspath(place).startswith(self._folder)

    def step(
        self, do: Callable[[], Any], needs_room: bool, close: Callable[[Any], None] | None = None
    ) -> Any:
        """Do one operation, unless it goes wrong.

        Args:
            do: does it.
            needs_room: whether it cannot be done on a full disk.
            close: closes what it opened, as the system does for the dead.
        """
        self.operations += 1
        begins = self.operations == self._at
        if self._kind == "death" and (begins or self.happened):
            self.happened = True
            if begins and self._late:
                with suppress(OSError):
                    result = do()
                    if close:
                        close(result)
            raise DeathError
        if self._kind == "full disk" and self.operations >= self._at and needs_room:
            self.happened = True
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        if self._kind == "failure" and begins:
            self.happened = True
            raise OSError(errno.EIO, os.strerror(errno.EIO))
        return do()

    def forget(self, handle: int) -> None:
        """Watch an open file no longer."""
        self._handles.discard(handle)

    def _watched(self, original: Callable[..., Any], needs_room: bool) -> Callable[..., Any]:
        def operation(place: Any, *rest: Any, **options: Any) -> Any:
            if not self._is_ours(place):
                return original(place, *rest, **options)
            if self.happened and self._kind == "death" and str(place).endswith(LOCK):
                return None
            return self.step(lambda: original(place, *rest, **options), needs_room)

        return operation

    def _watched_open(self, original: Callable[..., int]) -> Callable[..., int]:
        def operation(place: Any, flags: int, *rest: Any, **options: Any) -> int:
            if not flags & WRITING or not self._is_ours(place):
                return original(place, flags, *rest, **options)

            def do() -> int:
                return original(place, flags, *rest, **options)

            handle: int = self.step(do, True, os.close)
            if not str(place).endswith(LOCK):
                self._handles.add(handle)
            return handle

        return operation

    def _watched_file(self, original: Callable[..., Any]) -> Callable[..., Any]:
        def operation(place: Any, mode: str = "r", *rest: Any, **options: Any) -> Any:
            writes = bool(set(mode) & set("wax+"))
            if not writes or not self._is_ours(place):
                return original(place, mode, *rest, **options)

            def do() -> File:
                return File(original(place, mode, *rest, **options), self)

            return self.step(do, True, lambda file: file.__exit__(None, None, None))

        return operation


class File:
    """A file open for writing, each write of which is an operation that can go wrong half way."""

    def __init__(self, file: Any, trouble: Trouble):
        """Wrap an open file."""
        self._file, self._trouble = file, trouble

    def write(self, content: Any) -> int:
        """Write, or half of it."""
        begun = self._trouble.happened
        try:
            written: int = self._trouble.step(lambda: self._file.write(content), True)
            return written
        except BaseException:
            if not begun:
                self._file.write(content[: len(content) // 2])
                self._file.flush()
            raise

    def __enter__(self) -> "File":
        """Enter the file."""
        self._file.__enter__()
        return self

    def __exit__(self, *error: Any) -> None:
        """Close the file, whose number another may have next."""
        self._trouble.forget(self._file.fileno())
        self._file.__exit__(*error)

    def __getattr__(self, name: str) -> Any:
        """Be the file in all else."""
        return getattr(self._file, name)
