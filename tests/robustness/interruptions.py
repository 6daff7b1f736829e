"""Attacks on runs: one that is interrupted at any moment is resumed to the same bytes."""

import csv
import io
import os
import re
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from typing import NamedTuple
from unittest import mock

import jax
import numpy as np
from jax.experimental.compilation_cache import compilation_cache

import qdenv
from qdenv.io.files import LOCK
from qdenv.run import loop
from qdenv.run.config import override
from qdenv.search.settings import CmaMaeConfig
from robustness.campaign import Attack, Attempt
from robustness.faulty_disk import DeathError, FaultyDisk, Kind

MOST_TROUBLES = 6  # in a row, until the run is left in peace
# Five iterations of two mazes: the writing is attacked, whatever is searched.
SMALL = {"rows": 6, "cols": 6, "timesteps": 40, "steps": 4, "kernel_sizes": (3, 1), "hidden": 4}
SHORT = {"simulations": 2, "algorithm": CmaMaeConfig(emitters=1, batch=2), "evaluations": 10}
AXES = {"archive": ((0, 16, 8), (0, 40, 8)), "checkpoint_every": 2}
CONFIG = override(qdenv.find_preset("maze-quick"), SMALL | SHORT | AXES)
KINDS: tuple[Kind, ...] = ("death", "death", "death", "full disk", "failure")
# The same with more iterations.
OPTIONS = (
    "maze-quick --rows 6 --cols 6 --timesteps 40 --steps 4 --kernel-sizes 3 1 --hidden 4 "
    "--simulations 2 --emitters 1 --batch 2 --evaluations 60 --archive 0 16 8 0 40 8 --no-progress"
)
SIGNALS_SENT = (signal.SIGKILL,) * 3 + (signal.SIGTERM, signal.SIGINT)
EARLY = 0.15  # share of signals at any moment after the start, the others after the run began
HANGS = 300.0  # seconds after which a process counts as hung
INTERRUPTED = 130  # exit code


class Reference(NamedTuple):
    """An uninterrupted run."""

    contents: dict[str, bytes]  # of its folder
    size: float  # file operations, or seconds from its beginning to the end of the process
    start: float = 0.0  # seconds from the start of the process to the beginning of the run


def contents(run: Path) -> dict[str, bytes]:
    """Read what must be the same however often a run was interrupted, by name.

    Without seconds, and without the number of checkpoints, which depends on the clock; of pictures
    and of the manifest, which holds the time, only the names.
    """
    files: dict[str, bytes] = {}
    for path in sorted(run.rglob("*")):
        name = path.relative_to(run).as_posix()
        if not path.is_file() or name == LOCK:
            continue
        if re.fullmatch(r"checkpoints/[0-9]{6}\.npz", name):
            files["the newest checkpoint"] = path.name.encode() + path.read_bytes()
        elif name == "manifest.json" or path.suffix == ".png":
            files[name] = b""
        elif name == "metrics.csv":
            rows = csv.DictReader(io.StringIO(path.read_text()))
            files[name] = repr([{**row, "seconds": ""} for row in rows]).encode()
        else:
            files[name] = path.read_bytes()
    return files


def differences(expected: Mapping[str, bytes], actual: Mapping[str, bytes]) -> list[str]:
    """List the files that are missing, left behind or different."""
    faults = [f"{name} is missing" for name in expected if name not in actual]
    faults += [f"{name} was left behind" for name in actual if name not in expected]
    both = [name for name in expected if name in actual]
    return faults + [f"{name} differs" for name in both if actual[name] != expected[name]]


@cache
def compiled() -> tempfile.TemporaryDirectory:
    """Make the folder of the programs that XLA compiles, which the runs share."""
    return tempfile.TemporaryDirectory(prefix="qdenv-robustness-compiled-")


@contextmanager
def compiling_once() -> Iterator[None]:
    """Let the runs of this process share what XLA compiles."""
    settings = {
        "jax_compilation_cache_dir": compiled().name,
        "jax_persistent_cache_min_compile_time_secs": 0.0,
        "jax_persistent_cache_min_entry_size_bytes": -1,
    }
    before = {name: getattr(jax.config, name) for name in settings}
    try:
        for name, value in settings.items():
            jax.config.update(name, value)
        compilation_cache.reset_cache()  # else the settings of its first use stay
        yield
    finally:
        for name, value in before.items():
            jax.config.update(name, value)
        compilation_cache.reset_cache()


def train_or_resume(run: Path) -> None:
    """Begin the run, or resume it."""
    if (run / "config.json").exists():
        loop.resume(run, progress=False)
    else:
        loop.train(CONFIG, run, progress=False)


@cache
def uninterrupted() -> Reference:
    """Make the run in this process."""
    with tempfile.TemporaryDirectory() as folder:
        run = Path(folder) / "run"
        disk = FaultyDisk(run)
        with disk.active():
            train_or_resume(run)
        return Reference(contents(run), disk.operations)


def fail_operations(rng: np.random.Generator, folder: Path) -> Attempt:
    """Let file operations of a run fail, resume it, and compare."""
    run, notes, faults = folder / "run", Counter[str](), []
    with compiling_once(), mock.patch.object(tempfile, "tempdir", str(folder)):
        expected = uninterrupted()
        for _ in range(rng.integers(1, MOST_TROUBLES + 1)):
            # Fewer operations are left than the whole run has: early ones are likelier.
            at = 1 + int(expected.size * rng.random() ** 2)
            kind = KINDS[rng.integers(len(KINDS))]
            disk = FaultyDisk(run, kind, at, late=bool(rng.integers(2)))
            try:
                with disk.active():
                    train_or_resume(run)
            except (DeathError, Exception) as error:
                if not isinstance(error, DeathError if kind == "death" else qdenv.InputError):
                    faults.append(f"{kind} at operation {at}: {error!r}")
            notes[kind] += disk.happened
        try:
            train_or_resume(run)
        except Exception as error:
            faults.append(f"cannot be resumed: {error!r}")
    faults += differences(expected.contents, contents(run))
    faults += [f"{path} was left behind" for path in folder.iterdir() if path != run]
    return Attempt(sum(notes.values()), faults, notes)


def start(run: Path, temporary: Path, compile: bool = False) -> subprocess.Popen:
    """Begin or resume a run in a process of its own.

    Only an uninterrupted one may `compile` for the others: a killed one could leave half a program.
    """
    begun = (run / "config.json").exists()
    command = f"resume {run} --no-progress" if begun else f"train {OPTIONS} --out {run}"
    settings = {
        "JAX_COMPILATION_CACHE_DIR": compiled().name,
        "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS": "0" if compile else "1e6",
        "JAX_PERSISTENT_CACHE_MIN_ENTRY_SIZE_BYTES": "-1",
        "TMPDIR": str(temporary),
    }
    return subprocess.Popen(
        [sys.executable, "-m", "qdenv", *command.split()],
        env={**os.environ, **settings},
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
    )


def await_first_file(run: Path, process: subprocess.Popen) -> None:
    """Wait until a process makes or renames the first file of a run, or ends."""

    def changed() -> int:
        return run.stat().st_mtime_ns if run.exists() else 0

    before = changed()
    while process.poll() is None and changed() == before:
        time.sleep(0.005)


@cache
def uninterrupted_process() -> Reference:
    """Make the run in a process of its own, twice: the second compiles nothing."""
    with tempfile.TemporaryDirectory() as folder:
        for run in (Path(folder) / "first", Path(folder) / "run"):
            begin = time.monotonic()
            process = start(run, Path(folder), compile=True)
            await_first_file(run, process)
            begun = time.monotonic()
            _, stderr = process.communicate(timeout=HANGS)
            if process.returncode:
                raise RuntimeError(f"the run cannot be made at all: {stderr[-300:]}")
        return Reference(contents(run), time.monotonic() - begun, begun - begin)


def send_signals(rng: np.random.Generator, folder: Path) -> Attempt:
    """Send signals to the process of a run at any moment, resume it, and compare."""
    run, temporary = folder / "run", folder / "temporary"
    temporary.mkdir()
    expected, notes, faults = uninterrupted_process(), Counter[str](), []
    for _ in range(rng.integers(1, MOST_TROUBLES + 1)):
        number = SIGNALS_SENT[rng.integers(len(SIGNALS_SENT))]
        process = start(run, temporary)
        if rng.random() < EARLY:
            time.sleep(rng.random() * expected.start)
        else:
            await_first_file(run, process)
            # The rest takes less time than the whole run.
            time.sleep(rng.random() ** 2 * expected.size)
        process.send_signal(number)
        if number != signal.SIGKILL and rng.random() < 0.3:  # once more
            time.sleep(rng.random() * 0.2)
            process.send_signal(number)
        stderr = ""
        try:
            _, stderr = process.communicate(timeout=HANGS)
            code = process.returncode
        except subprocess.TimeoutExpired:
            process.kill()
            process.communicate()
            faults.append(f"hangs after {number.name}")
            code = -number
        notes[number.name if code else "finished before"] += 1
        # Before the program is loaded, a signal ends it like any process.
        if code not in (0, -number, INTERRUPTED) or (code and "Traceback" in stderr):
            faults.append(f"{number.name}: exit code {code}, {stderr[-300:]!r}")
    last = start(run, temporary)
    _, stderr = last.communicate(timeout=HANGS)
    if last.returncode:
        faults.append(f"cannot be resumed, exit code {last.returncode}: {stderr[-300:]!r}")
    faults += differences(expected.contents, contents(run))
    faults += [f"{path} was left behind" for path in temporary.iterdir()]
    return Attempt(sum(notes.values()) - notes["finished before"], faults, notes)


OPERATIONS = Attack(
    "operations",
    "a run that dies at a file operation, or finds the disk full, is resumed to the same bytes",
    "troubles",
    fail_operations,
)
SIGNALS = Attack(
    "signals",
    "a process that is killed or interrupted is resumed to the same bytes",
    "signals",
    send_signals,
)
