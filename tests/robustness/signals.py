"""Signals: a process that is killed or interrupted at any moment is resumed to the same bytes."""

import os
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from functools import lru_cache
from pathlib import Path

import numpy as np

from robustness.attack import Attack, Attempt
from robustness.kept import contents, differences
from robustness.kills import MOST_TROUBLES, Reference, compiled

# As in `kills`, with more iterations to be hit.
OPTIONS = (
    "maze-quick --rows 6 --cols 6 --timesteps 40 --steps 4 --kernel-sizes 3 1 --hidden 4 "
    "--simulations 2 --emitters 1 --batch 2 --evaluations 60 --archive 0 16 8 0 40 8 --no-progress"
)
EARLY = 0.15  # of signals come at any moment after the start, the others after the run began
LOOK = 0.005  # seconds between looks at whether the run has begun
HANGS = 300.0  # seconds after which a process counts as hung
SENT = (signal.SIGKILL, signal.SIGKILL, signal.SIGKILL, signal.SIGTERM, signal.SIGINT)
INTERRUPTED = 130


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
    """Wait until a process makes or renames the first file of a run, or ends."""

    def changed() -> int:
        return run.stat().st_mtime_ns if run.exists() else 0

    before = changed()
    while work.poll() is None and changed() == before:
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
        number = SENT[chance.integers(len(SENT))]
        work = start(run, elsewhere)
        if chance.random() < EARLY:
            time.sleep(chance.random() * wanted.start)
        else:
            await_begin(run, work)
            # What is left to do takes less time than the whole run.
            time.sleep(chance.random() ** 2 * wanted.size)
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


SIGNALS = Attack(
    "signals",
    "a process that is killed or interrupted is resumed to the same bytes",
    "signals",
    attempt_signals,
)
