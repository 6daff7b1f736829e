"""Kills: a search that dies while it writes is resumed to what an uninterrupted one leaves."""

import tempfile
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from typing import NamedTuple
from unittest import mock

import jax
import numpy as np
from jax.experimental.compilation_cache import compilation_cache

from qdenv.domains.maze import MazeConfig
from qdenv.generate import NcaConfig
from qdenv.presets import find_preset
from qdenv.run import loop
from qdenv.run.config import RunConfig
from qdenv.search.settings import CmaMaeConfig
from qdenv.types import InputError
from robustness.attack import Attack, Attempt
from robustness.dying import DeathError, Kind, Trouble
from robustness.kept import contents, differences

# Five iterations of two mazes: what dies is the writing, whatever is searched.
CONFIG: RunConfig = replace(
    find_preset("maze-quick"),
    evaluation=replace(
        find_preset("maze-quick").evaluation,
        domain=MazeConfig(rows=6, cols=6, timesteps=40),
        generator=NcaConfig(steps=4, kernel_sizes=(3, 1), hidden=4),
        simulations=2,
    ),
    algorithm=CmaMaeConfig(emitters=1, batch=2),
    evaluations=10,
    archive=((0, 16, 8), (0, 40, 8)),
    checkpoint_every=2,
)
MOST_TROUBLES = 6  # in a row, until the run is left in peace
# Most of what goes wrong is a death.
KINDS: tuple[Kind, ...] = ("death", "death", "death", "full disk", "failure")


class Reference(NamedTuple):
    """An uninterrupted run."""

    contents: dict[str, bytes]  # of its folder, as `kept.contents` reads it
    size: float  # file operations, or seconds from its beginning to the end of the process
    start: float = 0.0  # seconds from the start of the process to the beginning of the run


@lru_cache(maxsize=1)
def compiled() -> tempfile.TemporaryDirectory:
    """Make the folder in which what XLA compiled is kept for the next run."""
    return tempfile.TemporaryDirectory(prefix="qdenv-robustness-compiled-")


@contextmanager
def compiling_once() -> Iterator[None]:
    """Let the runs of this process share what XLA compiles."""
    wanted = {
        "jax_compilation_cache_dir": compiled().name,
        "jax_persistent_cache_min_compile_time_secs": 0.0,
        "jax_persistent_cache_min_entry_size_bytes": -1,
    }
    before = {name: getattr(jax.config, name) for name in wanted}
    try:
        for name, value in wanted.items():
            jax.config.update(name, value)
        compilation_cache.reset_cache()  # else it stays as it was first used
        yield
    finally:
        for name, value in before.items():
            jax.config.update(name, value)
        compilation_cache.reset_cache()


def go_on(run: Path) -> None:
    """Begin the run, or continue it where there is one."""
    if (run / "config.json").exists():
        loop.resume(run, progress=False)
    else:
        loop.train(CONFIG, run, progress=False)


@lru_cache(maxsize=1)
def whole() -> Reference:
    """Make the run in this process, uninterrupted, once."""
    with tempfile.TemporaryDirectory() as folder:
        run = Path(folder) / "run"
        trouble = Trouble(run)
        with trouble.looming():
            go_on(run)
        return Reference(contents(run), trouble.operations)


def attempt_operations(chance: np.random.Generator, folder: Path) -> Attempt:
    """Let file operations of a run go wrong, go on, and compare."""
    run, notes, faults = folder / "run", Counter[str](), []
    with compiling_once(), mock.patch.object(tempfile, "tempdir", str(folder)):
        wanted = whole()
        for _ in range(chance.integers(1, MOST_TROUBLES + 1)):
            # What is left to do has fewer operations than the whole run: early ones are likelier.
            at = 1 + int(wanted.size * chance.random() ** 2)
            kind = KINDS[chance.integers(len(KINDS))]
            trouble = Trouble(run, kind, at, late=bool(chance.integers(2)))
            try:
                with trouble.looming():
                    go_on(run)
            except (DeathError, InputError) as error:
                if isinstance(error, InputError) != (kind != "death"):
                    faults.append(f"{kind} at operation {at}: {error!r}")
            except Exception as error:  # of any kind: a traceback is a fault
                faults.append(f"{kind} at operation {at}: {error!r}")
            notes[kind] += trouble.happened
        try:
            go_on(run)
        except Exception as error:
            faults.append(f"cannot be resumed: {error!r}")
    faults += differences(wanted.contents, contents(run))
    faults += [f"{path} was left behind" for path in folder.iterdir() if path != run]
    return Attempt(sum(notes.values()), tuple(faults), notes)


OPERATIONS = Attack(
    "operations",
    "a run that dies at a file operation, or finds the disk full, is resumed to the same bytes",
    "troubles",
    attempt_operations,
)
