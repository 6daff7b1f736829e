"""Command lines run in a process that may be killed, and checked against what they must not do.

Started as a program, this file is that process: each line of its input is {"argv", "folder"} as
JSON, each line of its output an `Ending`. It imports nothing but the standard library and what
its argument MODULE:FUNCTION names, a function of the words of a command line.
"""

import atexit
import contextlib
import importlib
import io
import json
import logging
import os
import re
import selectors
import subprocess
import sys
import time
import traceback
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

LONGEST = 10.0  # CPU seconds of one command line
LATEST = 300.0  # seconds until it must end, however busy the machine is
MOST = 1024.0  # megabytes above the start
RENEWED = 3072.0  # megabytes at which the process is replaced
HANGS = "hangs: killed"
# Become a user to whom permissions apply, which root is not: without its capabilities to look into
# every folder, 1 and 2 of capabilities(7), whose bound prctl lowers by its command 24. It takes
# effect in the next program, and changes nothing for anybody but root.
BECOME_ORDINARY = "import ctypes; [ctypes.CDLL(None).prctl(24, one, 0, 0, 0) for one in (1, 2)]"
RUN = "os.execv(sys.executable, [sys.executable, *sys.argv[1:]])"
TRIES = 3  # of what hangs
CONTROL = re.compile(r"[\x00-\x08\x0b\x0c\x0e-\x1f\x7f-\x9f]")


class Ending(NamedTuple):
    """How a command line ended."""

    code: int | None  # exit code
    error: str  # the traceback, if one escaped
    stderr: str
    log: list[str]  # messages that the program would print
    megabytes: float  # peak of memory above the start


class Sandbox:
    """Runs command lines one after the other and names the promise that each broke."""

    def __init__(
        self, program: str = "qdenv.cli.main:run", longest: float = LONGEST, most: float = MOST
    ) -> None:
        """Start nothing yet; the limits are CPU seconds and megabytes of one command line."""
        self._program, self._longest, self._most = program, longest, most
        self._process: subprocess.Popen[str] | None = None

    def fault_of(self, argv: Sequence[str], folder: Path, limited: bool = True) -> str | None:
        """Run a command line in a folder, with limits or without; None if it kept all promises.

        One that hangs is tried again: it may have compiled programs, which are cached.
        """
        fault = None
        for _ in range(TRIES):
            fault = self._run(argv, folder, limited)
            if fault is None or not fault.startswith(HANGS):
                break
        return fault

    def _run(self, argv: Sequence[str], folder: Path, limited: bool) -> str | None:
        process = self._start()
        assert process.stdin is not None and process.stdout is not None
        begin, before = time.monotonic(), cpu_seconds(process.pid)
        process.stdin.write(json.dumps({"argv": list(argv), "folder": str(folder)}) + "\n")
        process.stdin.flush()
        with selectors.DefaultSelector() as selector:
            selector.register(process.stdout, selectors.EVENT_READ)
            while not selector.select(0.05):
                spent = cpu_seconds(process.pid) - before
                if limited and (spent > self._longest or time.monotonic() - begin > LATEST):
                    self.close()
                    return f"{HANGS} after {spent:.0f} CPU seconds"
        answer = process.stdout.readline()
        if not answer:
            code = process.wait()
            self.close()
            return f"dies with exit code {code}"
        return fault_in(Ending(**json.loads(answer)), self._most)

    def _start(self) -> subprocess.Popen[str]:
        if self._process is not None and memory("VmRSS", self._process.pid) > RENEWED:
            self.close()
        if self._process is None:
            cache = os.environ.get("XDG_CACHE_HOME", str(Path.home() / ".cache"))
            self._process = subprocess.Popen(
                prepared([__file__, self._program]),
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=subprocess.DEVNULL,
                text=True,
                env={"JAX_COMPILATION_CACHE_DIR": f"{cache}/qdenv/jax", **os.environ},
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


def prepared(argv: Sequence[str], prepare: str = BECOME_ORDINARY) -> list[str]:
    """Return the words that start Python with arguments after something was done to the process."""
    return [sys.executable, "-c", f"import os, sys; {prepare}; {RUN}", *argv]


def start(
    argv: Sequence[str], folder: Path, prepare: str = BECOME_ORDINARY, **options: object
) -> subprocess.Popen:
    """Start Python with arguments in a folder, after something was done to the process."""
    streams = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE} | options
    return subprocess.Popen(prepared(argv, prepare), cwd=folder, text=True, **streams)  # type: ignore[call-overload]


def fault_in(ending: Ending, most: float = MOST) -> str | None:
    """Return the promise that a command line broke, or None."""
    if ending.error:
        *_, place, _, last = ["", "", *ending.error.strip().splitlines()][-4:]
        return f"ends in a traceback: {printable(last)} ({printable(place.strip())})"
    if ending.code not in (0, 1, 2):  # 1: `check` on a layout that breaks rules
        return f"ends with exit code {ending.code}"
    if ending.megabytes > most:
        return f"takes {ending.megabytes:.0f} MB more than before"
    # A progress bar draws over itself; the rest of its line is no message.
    lines = [line.rpartition("\r")[2] for line in ending.stderr.split("\n")]
    messages = [line for line in lines if line.strip()]
    if ending.code == 2 and (len(messages) != 1 or not messages[0].startswith("qdenv: ")):
        return f"says {len(messages)} lines: {printable(' / '.join(messages))}"
    for line in [*lines, *ending.log]:
        if CONTROL.search(line) or "\n" in line:
            return f"says what is no printable line: {printable(line)}"
    return None


def printable(text: str) -> str:
    """Escape what is not printable."""
    return "".join(char if char.isprintable() else ascii(char)[1:-1] for char in text)


def cpu_seconds(pid: int) -> float:
    """Return the CPU seconds of a process; 0 without /proc."""
    with contextlib.suppress(OSError, IndexError, ValueError):
        fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
        return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")
    return 0.0


def memory(name: str, pid: int | str = "self") -> float:
    """Return VmRSS or VmHWM of a process in megabytes; 0 without /proc."""
    with contextlib.suppress(OSError):
        for line in Path(f"/proc/{pid}/status").read_text().splitlines():
            if line.startswith(name):
                return int(line.split()[1]) / 1024
    return 0.0


def run(program: Callable[[list[str]], Any], argv: list[str], folder: str) -> Ending:
    """Run a command line in this process, in a folder."""
    os.chdir(folder)
    log, stderr, error = io.StringIO(), io.StringIO(), ""
    handler = logging.StreamHandler(log)
    handler.setLevel(logging.WARNING)
    handler.terminator = "\0"  # a message may have several lines, which is a fault
    logging.getLogger("qdenv").addHandler(handler)
    with contextlib.suppress(OSError):
        Path("/proc/self/clear_refs").write_text("5")  # resets the peak of memory
    before = memory("VmRSS")
    try:
        with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(stderr):
            code = program(argv)
    except SystemExit as stop:  # help was printed
        code = stop.code if isinstance(stop.code, int) else 0 if stop.code is None else 1
    except BaseException:
        code, error = None, traceback.format_exc()
    finally:
        logging.getLogger("qdenv").removeHandler(handler)
    messages = log.getvalue().split("\0")
    return Ending(code, error, stderr.getvalue(), messages, memory("VmHWM") - before)


def main() -> None:
    """Run command lines until the input ends."""
    answers = os.fdopen(os.dup(1), "w")
    os.dup2(os.open(os.devnull, os.O_WRONLY), 1)  # solvers print there
    module, _, function = sys.argv[1].partition(":")
    program = getattr(importlib.import_module(module), function)
    for line in sys.stdin:
        print(json.dumps(run(program, **json.loads(line))._asdict()), file=answers, flush=True)


if __name__ == "__main__":
    main()
