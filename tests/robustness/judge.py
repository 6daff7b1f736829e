"""Command lines run in a process that may be killed, and what they must not do."""

from __future__ import annotations

import atexit
import contextlib
import json
import os
import re
import selectors
import subprocess
import sys
import time
from collections.abc import Sequence
from pathlib import Path

from qdenv.types import printable
from robustness import worker
from robustness.worker import Ending

LONGEST = 10.0  # CPU seconds of one command line
LATEST = 300.0  # seconds until it must end, however busy the machine is
MOST = 1024.0  # megabytes above the start
RENEWED = 3072.0  # megabytes at which a process that kept too much is replaced
HANGS = "hangs: killed"
TRIES = 3  # of what hangs
TICK = 0.05
CONTROL = re.compile(r"[\x00-\x08\x0b\x0c\x0e-\x1f\x7f-\x9f]")
TICKS = os.sysconf("SC_CLK_TCK")


class Judge:
    """Runs command lines one after the other and says what each broke."""

    def __init__(
        self, program: str = "qdenv.cli:run", longest: float = LONGEST, most: float = MOST
    ) -> None:
        """Start nothing yet.

        Args:
            program: module:function that takes the words of a command line.
            longest: CPU seconds a command line may take.
            most: megabytes it may take.
        """
        self._program, self._longest, self._most = program, longest, most
        self._process: subprocess.Popen[str] | None = None

    def fault_of(self, argv: Sequence[str], folder: Path, limited: bool = True) -> str | None:
        """Run a command line in a folder; None where all promises held.

        What takes long is tried again: programs are compiled once on a machine, and kept, some at
        each try.

        Args:
            argv: what follows `qdenv`.
            folder: to run in.
            limited: whether it must end soon.
        """
        fault = None
        for _ in range(TRIES):
            fault = self._tried(argv, folder, limited)
            if fault is None or not fault.startswith(HANGS):
                break
        return fault

    def _tried(self, argv: Sequence[str], folder: Path, limited: bool) -> str | None:
        process = self._ready()
        assert process.stdin is not None and process.stdout is not None
        begun, before = time.monotonic(), _cpu_seconds(process.pid)
        process.stdin.write(json.dumps({"argv": list(argv), "folder": str(folder)}) + "\n")
        process.stdin.flush()
        with selectors.DefaultSelector() as selector:
            selector.register(process.stdout, selectors.EVENT_READ)
            while not selector.select(TICK):
                spent = _cpu_seconds(process.pid) - before
                if limited and (spent > self._longest or time.monotonic() - begun > LATEST):
                    self.close()
                    return f"{HANGS} after {spent:.0f} CPU seconds"
        answer = process.stdout.readline()
        if not answer:
            code = process.wait()
            self.close()
            return f"dies with exit code {code}"
        return verdict(Ending(**json.loads(answer)), self._most)

    def _ready(self) -> subprocess.Popen[str]:
        if self._process is not None and _megabytes(self._process.pid) > RENEWED:
            self.close()
        if self._process is None:
            cache = os.environ.get("XDG_CACHE_HOME", str(Path.home() / ".cache"))
            programs = {"JAX_COMPILATION_CACHE_DIR": f"{cache}/qdenv/jax"}
            self._process = subprocess.Popen(
                [sys.executable, worker.__file__, self._program],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=subprocess.DEVNULL,
                text=True,
                env=programs | dict(os.environ),
            )
            atexit.register(self.close)
        return self._process

    def close(self) -> None:
        """End the process."""
        process, self._process = self._process, None
        if process is not None:
            process.kill()
            process.communicate()
            atexit.unregister(self.close)


def verdict(ending: Ending, most: float = MOST) -> str | None:
    """Say which promise a command line broke; None where all held."""
    if ending.error:
        *_, place, _, last = ["", "", *ending.error.strip().splitlines()][-4:]
        return f"ends in a traceback: {printable(last)} ({printable(place.strip())})"
    if ending.code not in (0, 1, 2):  # 1: `check` says what a layout breaks
        return f"ends with exit code {ending.code}"
    if ending.megabytes > most:
        return f"takes {ending.megabytes:.0f} MB more than before"
    # A bar draws over itself; what is left of it is no message.
    lines = [line.rpartition("\r")[2] for line in ending.said.split("\n")]
    if ending.code == 2:
        said = [line for line in lines if line.strip()]
        if len(said) != 1 or not said[0].startswith("qdenv: "):
            return f"says {len(said)} lines: {printable(' / '.join(said))}"
    for line in [*lines, *ending.logged]:
        if CONTROL.search(line) or "\n" in line:
            return f"says what is no printable line: {printable(line)}"
    return None


def _cpu_seconds(pid: int) -> float:
    """Read what a process has used up; 0 where the system does not tell."""
    with contextlib.suppress(OSError, IndexError, ValueError):
        fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
        return (int(fields[11]) + int(fields[12])) / TICKS
    return 0.0


def _megabytes(pid: int) -> float:
    """Read how much memory a process holds; 0 where the system does not tell."""
    with contextlib.suppress(OSError, IndexError, ValueError):
        pages = int(Path(f"/proc/{pid}/statm").read_text().split()[1])
        return pages * os.sysconf("SC_PAGE_SIZE") / 2**20
    return 0.0
