"""Ctrl-C: one line that says how to go on, and the end at once, whatever is under way.

Compiled code and compilers do not look at Python's signals for seconds, and a process that is torn
down in the middle of them crashes. So a thread of its own waits for the signal and ends the
process without tearing anything down. Nothing is lost by that: files are written under other
names and renamed when they are whole.
"""

import contextlib
import os
import shlex
import signal
import socket
import sys
import threading
from typing import NoReturn

EXIT_CODE = 130  # what shells expect of a program ended by Ctrl-C
FLUSH_SECONDS = 0.3

unfinished: set[str] = set()  # files under way, which are taken away
_way: list[str] = [""]  # how to go on


def watch(program: str = "qdenv") -> None:
    """Answer Ctrl-C from now on; for programs, not for notebooks.

    Args:
        program: how it was called, to say how to call it again.
    """
    advise(f"`{program} {shlex.join(sys.argv[1:])}` begins anew")
    reader, writer = socket.socketpair()
    writer.setblocking(False)
    # Python's own handler does nothing; the number of the signal arrives at the socket at once.
    signal.signal(signal.SIGINT, lambda number, frame: None)
    signal.set_wakeup_fd(writer.fileno(), warn_on_full_buffer=False)

    def wait() -> None:
        with reader, writer:
            while reader.recv(1) != bytes([signal.SIGINT]):
                pass
            leave()

    threading.Thread(target=wait, daemon=True, name="interrupt").start()


def advise(way: str) -> None:
    """Set how to go on after an interruption, like "`qdenv resume runs/first` goes on"."""
    _way[0] = way


def last_words() -> str:
    """Write the line of an interrupted command."""
    return f"qdenv: stopped; {_way[0]}" if _way[0] else "qdenv: stopped"


def leave() -> NoReturn:
    """Say how to go on, take unfinished files away, and end the process."""
    with contextlib.suppress(OSError):
        os.write(2, f"\n{last_words()}\n".encode())
    # Whoever prints at this moment holds a lock: wait for it a little, not for ever.
    flushing = threading.Thread(target=sys.stdout.flush, daemon=True)
    flushing.start()
    flushing.join(FLUSH_SECONDS)
    for path in list(unfinished):
        with contextlib.suppress(OSError):
            os.unlink(path)
    os._exit(EXIT_CODE)
