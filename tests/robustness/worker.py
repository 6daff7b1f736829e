"""A process of its own that runs command lines as `qdenv` would, and says how each ended.

Started as ``python tests/robustness/worker.py MODULE:FUNCTION``, where the function takes the
words of a command line and returns an exit code. Each line of input is {"argv", "folder"} as JSON,
each line of output the fields of `Ending`.
"""

import contextlib
import importlib
import io
import json
import logging
import os
import sys
import time
import traceback
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

STATUS = Path("/proc/self/status")
RESET = Path("/proc/self/clear_refs")  # 5 written there resets the peak


class Ending(NamedTuple):
    """How a command line ended."""

    code: int | None  # exit code
    error: str  # the traceback, if one escaped
    said: str  # what it wrote to standard error
    logged: list[str]  # messages of the log
    megabytes: float  # how far memory rose above what it was before, at most
    seconds: float  # CPU seconds it took


class Listener(logging.Handler):
    """Keeps the messages of the log, which the program would print."""

    def __init__(self) -> None:
        """Begin with none."""
        super().__init__(logging.WARNING)
        self.heard: list[str] = []

    def emit(self, record: logging.LogRecord) -> None:
        """Keep a message."""
        if record.name.startswith("qdenv"):
            self.heard.append(record.getMessage())


def memory(name: str) -> float:
    """Read a size of this process in megabytes (``VmRSS``, ``VmHWM``); 0 where none is told."""
    lines = STATUS.read_text().splitlines() if STATUS.exists() else []
    return next((int(line.split()[1]) / 1024 for line in lines if line.startswith(name)), 0.0)


def attempt(run: Callable[[list[str]], Any], argv: list[str], folder: str) -> Ending:
    """Run a command line in a folder."""
    os.chdir(folder)
    listener, said, error = Listener(), io.StringIO(), ""
    logging.getLogger().addHandler(listener)
    with contextlib.suppress(OSError):
        RESET.write_text("5")
    before, begun = memory("VmRSS"), time.process_time()
    try:
        with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(said):
            code = run(argv)
    except SystemExit as stop:  # help was printed
        code = stop.code if isinstance(stop.code, int) else 0 if stop.code is None else 1
    except BaseException:
        code, error = None, traceback.format_exc()
    finally:
        logging.getLogger().removeHandler(listener)
    spent, risen = time.process_time() - begun, memory("VmHWM") - before
    return Ending(code, error, said.getvalue(), listener.heard, risen, spent)


def main() -> None:
    """Run what is asked for, line by line, until the input ends."""
    answers = os.fdopen(os.dup(1), "w")
    nowhere = os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, 1)  # what solvers print is no answer
    module, _, function = sys.argv[1].partition(":")
    run = getattr(importlib.import_module(module), function)
    for line in sys.stdin:
        asked = json.loads(line)
        ending = attempt(run, asked["argv"], asked["folder"])
        print(json.dumps(ending._asdict()), file=answers, flush=True)


if __name__ == "__main__":
    main()
