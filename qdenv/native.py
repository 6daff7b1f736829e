"""Functions compiled by numba for one core of the host, free of the interpreter lock.

Machine code is kept on disk between processes, in a folder of the user's cache that is named by
the hash of the sources it can depend on: the module that declares it and all it imports of this
package. numba itself watches only the file of the outermost function, its place and age; with any
of these sources changed, the folder is another one, so stale code cannot run, and the same sources
elsewhere (another checkout or installation) find what was compiled.
"""

import ast
import contextlib
import functools
import hashlib
import logging
import os
import shutil
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeAlias, TypeVar

import numba
import numpy as np
import platformdirs
from numba import types
from numba.core.caching import IndexDataCacheFile
from numba.core.registry import CPUDispatcher
from numba.extending import register_jitable

MAX_FOLDERS = 128  # a dozen per state of the sources: other branches, other installations

_NOT_KEPT = "%s: compiled code cannot be kept here (%s): every run compiles"
_LOG = logging.getLogger(__name__)
_logged: dict[str, logging.LogRecord] = {}
# What all functions of a folder have in common is logged once.
_LOG.addFilter(lambda record: _logged.setdefault(record.getMessage(), record) is record)
_PACKAGE = Path(__file__).parent

# An array of shape [] in a record, which kernels update as ``x[()]``: a number, though numpy's
# annotations call that an array.
Scalar: TypeAlias = Any
Numbers: TypeAlias = Any  # several of them in one `np.record`, from `numbers`

Function = TypeVar("Function", bound=Callable[..., Any])


def compiled(
    function: Function, forceinline: bool = False, inner_options: tuple[str, ...] = ()
) -> Function:
    """Compile `function`, with a disk cache where there is a writable place for one.

    `inner_options` names numba settings to switch on, or off if a name begins with `_`.
    """
    folder = _cache_folder(function.__module__)
    # numba reads its setting when a function is declared. A changed environment would reach other
    # packages, and processes started from here that may run other sources.
    before = numba.config.CACHE_DIR
    numba.config.CACHE_DIR = str(folder or "")
    try:
        options = {"cache": folder is not None, "nogil": True, "forceinline": forceinline}
        made: Any = numba.njit(**options)(function)
    finally:
        numba.config.CACHE_DIR = before
    # A later version may drop some: the code is then only slower, or takes longer to compile.
    known = getattr(getattr(made, "targetdescr", None), "options", None)
    for name in inner_options:
        if hasattr(known, name):
            made.targetoptions[name] = not name.startswith("_")
    # Inner attributes of numba: without them, a full or damaged cache is an error again, and code
    # is found only by the very files that it was compiled from.
    if folder is not None and hasattr(made, "_cache"):
        place = f"{function.__module__}.{function.__qualname__}-{function.__code__.co_firstlineno}"
        name = "-".join((place, *inner_options))  # other options make other code
        made._cache._cache_file = IndexDataCacheFile(str(folder), name, source_stamp=None)
        made._cache = _Forgiving(made._cache, folder)
    return made


class _Forgiving:
    """A disk cache of numba that never fails: what it cannot read or write is compiled again."""

    def __init__(self, cache: Any, folder: Path) -> None:
        self._cache, self._folder = cache, folder

    def __getattr__(self, name: str) -> Any:
        return getattr(self._cache, name)

    def load_overload(self, *arguments: Any) -> Any:
        """Load machine code, or forget all of this function's where it is damaged."""
        try:
            return self._cache.load_overload(*arguments)
        except Exception:  # whatever unpickling can raise
            with contextlib.suppress(OSError):
                self._cache.flush()
            return None

    def save_overload(self, *arguments: Any) -> None:
        """Save machine code, or log that the folder takes none."""
        try:
            self._cache.save_overload(*arguments)
        except OSError as error:
            _LOG.warning(_NOT_KEPT, self._folder.parent, error.strerror)


def kernel(function: Function, forceinline: bool = False) -> Function:
    """Compile a function that borrows its arrays: it makes none, keeps none and returns none.

    numba counts references, atomically, whenever an array is taken out of a record or a record is
    handed on, which takes a large part of a small step. Here the caller holds all arrays until
    the call ends, so nothing needs counting. A function that does make an array in spite of its
    promise is refused when it is compiled.

    Much of a kernel's machine code would unpack Python's records. Most kernels are called by
    kernels alone: only those that Python calls are compiled with that code.
    """
    options = "_nrt", "no_cfunc_wrapper"
    made: Any = compiled(function, forceinline, (*options, "no_cpython_wrapper"))
    if isinstance(made, CPUDispatcher):  # else NUMBA_DISABLE_JIT is set
        made.__class__, made.outer = _Kernel, compiled(function, forceinline, options)
    return made


class _Kernel(CPUDispatcher):
    def __call__(self, *arguments: Any) -> Any:
        return self.outer(*arguments)

    def get_call_template(self, args: tuple, kws: dict) -> tuple:
        # Else numba compiles once more for constants, and for short integers.
        kinds = [
            types.int64 if isinstance(kind, types.Integer) and kind.signed else kind
            for kind in map(types.unliteral, args)
        ]
        return super().get_call_template(tuple(kinds), kws)


# Compile a `kernel` into its callers: a call hands over seven words per array of a record.
inlined = functools.partial(kernel, forceinline=True)


def formula(function: Function) -> Function:
    """Write a short function out in each kernel that calls it, before that is compiled.

    It is never compiled by itself, which saves much of the time of compiling the kernels.
    """
    return numba.njit(inline="always", nogil=True)(function)


def shared(rule: Function) -> Function:
    """Let compiled functions call `rule`, which stays the plain Python function that it is."""
    return register_jitable(rule)


def numbers(*names: str) -> Numbers:
    """Make int64 numbers that kernels read and change as ``record.name``; all of them are 0."""
    return np.zeros(1, np.dtype((np.record, [(name, np.int64) for name in names])))[0]


@functools.cache
def _cache_folder(module: str) -> Path | None:
    """Find a module's folder in NUMBA_CACHE_DIR, else in the user's cache; None if read-only."""
    # The files that the module is made of: its own and all those it imports of this package. A
    # module of another package may use any of ours.
    sources = set() if _source(module) else set(_PACKAGE.rglob("*.py"))
    waiting = [module]
    while waiting:
        path = _source(waiting.pop())
        if path is not None and path not in sources:
            sources.add(path)
            waiting += _imports(path)
    digest = hashlib.sha256(f"{numba.__version__} {sys.version}".encode())
    for path in sorted(sources):
        digest.update(str(path.relative_to(_PACKAGE)).encode())
        digest.update(path.read_bytes())
    home = Path(numba.config.CACHE_DIR or platformdirs.user_cache_path()) / "qdenv"
    if str(home).startswith("~"):  # a user without a home
        return None
    folder = home / digest.hexdigest()[:16]
    try:
        folder.mkdir(parents=True, exist_ok=True)
        tempfile.TemporaryFile(dir=folder).close()
        os.utime(folder)  # in use: the last to be thrown out
    except OSError as error:
        _LOG.warning(_NOT_KEPT, home, error.strerror)
        return None
    _forget_old(home)
    return folder


def _source(module: str) -> Path | None:
    """Find the file of a module of this package; None for any other name."""
    first, *parts = module.split(".")
    if first != _PACKAGE.name:
        return None
    base = _PACKAGE.joinpath(*parts)
    files = (base.with_suffix(".py"), base / "__init__.py")
    return next((path for path in files if path.is_file()), None)


@functools.cache
def _imports(path: Path) -> tuple[str, ...]:
    """List the names that a file imports; a name taken from a module may itself be a module."""
    names: list[str] = []
    for node in ast.walk(ast.parse(path.read_bytes())):
        if isinstance(node, ast.Import):
            names += [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom) and node.module:
            names += [node.module, *(f"{node.module}.{alias.name}" for alias in node.names)]
    return tuple(names)


def _forget_old(home: Path) -> None:
    """Remove our folders but the last used ones; other processes may be doing the same."""
    with contextlib.suppress(OSError):
        by_age = sorted(home.glob("[0-9a-f]" * 16), key=lambda folder: folder.stat().st_mtime)
        for folder in by_age[:-MAX_FOLDERS]:
            shutil.rmtree(folder, ignore_errors=True)
