"""Kills: a search that dies at any moment and is resumed leaves what an uninterrupted one does."""

import os
import signal
import subprocess
import sys
import tempfile
import time
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

from qdenv.bench.robustness.attack import Attack, Attempt
from qdenv.bench.robustness.dying import DeathError, Trouble
from qdenv.bench.robustness.kept import contents, differences
from qdenv.domains.maze import MazeConfig
from qdenv.generate.settings import NcaConfig
from qdenv.presets import find_preset
from qdenv.search.settings import CmaMaeConfig
from qdenv.training import loop
from qdenv.training.config import RunConfig
from qdenv.types import InputError

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
# The same for a process of its own, with more iterations to be hit.
OPTIONS = (
    "maze-quick --rows 6 --cols 6 --timesteps 40 --steps 4 --kernel-sizes 3 1 --hidden 4 "
    "--simulations 2 --emitters 1 --batch 2 --evaluations 60 --archive 0 16 8 0 40 8 --no-progress"
)
MOST_TROUBLES = 6  # in a row, until the run is left in peace
EARLY = 0.15  # of signals come at any moment after the start, the others after the run began
LOOK = 0.005  # seconds between looks at whether the run has begun
HANGS = 300.0  # seconds after which a process counts as hung
SIGNALS = (signal.SIGKILL, signal.SIGKILL, signal.SIGKILL, signal.SIGTERM, signal.SIGINT)
INTERRUPTED = 130


class Reference(NamedTuple):
    """An uninterrupted run.

    Attributes:
        contents: of its folder, as `kept.contents` reads it.
        size: file operations, or seconds from its beginning to the end of the process.
        start: seconds from the start of the process to the beginning of the run.
    """

    contents: dict[str, bytes]
    size: float
    start: float = 0.0


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
            kind = chance.choice(["death", "death", "death", "full disk", "failure"])
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


def start(run: Path, elsewhere: Path, keep: bool = False) -> subprocess.Popen:
    """Begin or continue a run in a process of its own.

    Args:
        run: its folder.
        elsewhere: a folder for temporary files.
        keep: add to what is compiled; a process that is killed could leave half of it.
    """
    begun = (run / "config.json").exists()
    words = f"resume {run} --no-progress" if begun else f"train {OPTIONS} --out {run}"
    settings = {
        "JAX_COMPILATION_CACHE_DIR": compiled().name,
        "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS": "0" if keep else "1e6",
        "JAX_PERSISTENT_CACHE_MIN_ENTRY_SIZE_BYTES": "-1",
        "TMPDIR": str(elsewhere),
    }
    return subprocess.Popen(
        [sys.executable, "-m", "qdenv", *words.split()],
        env={**os.environ, **settings},
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
    )


def await_begin(run: Path, work: subprocess.Popen) -> None:
    """Wait until a run shows a sign of life, or its process ends."""
    before = (run / ".lock").stat().st_mtime_ns if (run / ".lock").exists() else 0
    while work.poll() is None:
        if (run / ".lock").exists() and (run / ".lock").stat().st_mtime_ns != before:
            return
        time.sleep(LOOK)


@lru_cache(maxsize=1)
def whole_process() -> Reference:
    """Make the run in a process of its own, uninterrupted, twice: the second compiles nothing."""
    with tempfile.TemporaryDirectory() as folder:
        for run in (Path(folder) / "first", Path(folder) / "run"):
            begin = time.monotonic()
            work = start(run, Path(folder), keep=True)
            await_begin(run, work)
            begun = time.monotonic()
            _, said = work.communicate(timeout=HANGS)
            if work.returncode:
                raise RuntimeError(f"the run cannot be made at all: {said[-300:]}")
        return Reference(contents(run), time.monotonic() - begun, begun - begin)


def attempt_signals(chance: np.random.Generator, folder: Path) -> Attempt:
    """Send signals to the process of a run at any moment, go on, and compare."""
    run, elsewhere = folder / "run", folder / "elsewhere"
    elsewhere.mkdir()
    wanted, notes, faults = whole_process(), Counter[str](), []
    for _ in range(chance.integers(1, MOST_TROUBLES + 1)):
        number = SIGNALS[chance.integers(len(SIGNALS))]
        work = start(run, elsewhere)
        if chance.random() < EARLY:
            time.sleep(chance.random() * wanted.start)
        else:
            await_begin(run, work)
            time.sleep(chance.random() * wanted.size)
        work.send_signal(number)
        if number != signal.SIGKILL and chance.random() < 0.3:  # once more
            time.sleep(chance.random() * 0.2)
            work.send_signal(number)
        name, faulty = _judge(work, number)
        notes[name] += 1
        faults += faulty
    last = start(run, elsewhere)
    _, said = last.communicate(timeout=HANGS)
    if last.returncode:
        faults.append(f"cannot be resumed, exit code {last.returncode}: {said[-300:]!r}")
    faults += differences(wanted.contents, contents(run))
    faults += [f"{path} was left behind" for path in elsewhere.iterdir()]
    return Attempt(sum(notes.values()) - notes["finished before"], tuple(faults), notes)


def _judge(work: subprocess.Popen, number: signal.Signals) -> tuple[str, list[str]]:
    """Wait for the end of a process that was sent a signal: (what happened, faults)."""
    try:
        _, said = work.communicate(timeout=HANGS)
    except subprocess.TimeoutExpired:
        work.kill()
        work.communicate()
        return f"{number.name}", [f"hangs after {number.name}"]
    if work.returncode == 0:
        return "finished before", []
    # Before the program is loaded, a signal ends it as it ends any process.
    expected = (-number, INTERRUPTED)
    fine = work.returncode in expected and "Traceback" not in said
    line = f"{number.name}: exit code {work.returncode}, {said[-300:]!r}"
    return number.name, [] if fine else [line]


OPERATIONS = Attack(
    "operations",
    "a run that dies at a file operation, or finds the disk full, is resumed to the same bytes",
    "troubles",
    attempt_operations,
)
SIGKILLS = Attack(
    "signals",
    "a process that is killed or interrupted is resumed to the same bytes",
    "signals",
    attempt_signals,
)
