"""Ctrl-C and SIGTERM: print how to go on, and exit, whatever is running.

Compiled code and compilers do not look at Python's signals for seconds, and a process that is torn
down in the middle of them crashes. So a thread of its own waits for the signal, saves what is done
and ends the process without tearing anything down. Nothing is lost by that: files are written
under other names and renamed when they are whole.
"""

import atexit
import contextlib
import os
import shlex
import signal
import socket
import sys
import threading
from collections.abc import Callable
from types import FrameType

EXIT_CODE = 130  # what shells expect of a program ended by Ctrl-C
_FLUSH_SECONDS = 0.3
_LOOK_SECONDS = 0.05

unfinished: set[str] = set()  # files under way, which are deleted
reserved: set[str] = set()  # names of results to come, which are deleted while they are empty
_again: list[str] = [""]  # the command of this program, in backticks; "" in a notebook
_way: list[str] = [""]  # the command that goes on
_unsaved: list[Callable[[], None]] = []  # saves what is done, before the end
undisturbed = threading.Lock()  # held while what would be saved changes
_SIGNALS = (signal.SIGINT, signal.SIGTERM)


def watch(program: str = "qdenv") -> None:
    """Answer Ctrl-C and SIGTERM from now on; for programs, not for notebooks.

    `program` is how it was called, to say how to call it again. A second call changes nothing.
    """
    if signal.getsignal(signal.SIGINT) is _ignore:
        return
    _again[0] = f"`{program} {shlex.join(sys.argv[1:])}`"
    reader, writer = socket.socketpair()
    writer.setblocking(False)
    # Python's own handler does nothing; the number of the signal arrives at the socket at once.
    for number in _SIGNALS:
        signal.signal(number, _ignore)
    signal.set_wakeup_fd(writer.fileno(), warn_on_full_buffer=False)

    def wait() -> None:
        with reader, writer:
            _await_signal(reader)
            if _unsaved:
                _save(reader)
            with contextlib.suppress(OSError):
                # A name of a file that is no UTF-8 is written as it came.
                os.write(2, f"\n{last_words()}\n".encode(errors="surrogateescape"))
            # A thread that is printing holds a lock: wait for it a little, not for ever.
            flushing = threading.Thread(target=sys.stdout.flush, daemon=True)
            flushing.start()
            flushing.join(_FLUSH_SECONDS)
            discard_unfinished()
            os._exit(EXIT_CODE)

    threading.Thread(target=wait, daemon=True, name="interrupt").start()


def _ignore(number: int, frame: FrameType | None) -> None:
    """Do nothing: the thread hears of it."""


def _await_signal(reader: socket.socket) -> None:
    """Wait for a signal that ends this program."""
    while reader.recv(1)[0] not in _SIGNALS:
        pass


def _save(reader: socket.socket) -> None:
    """Save what is done; another signal ends this, too."""

    def save() -> None:
        with undisturbed:
            if _unsaved:  # else it was saved meanwhile
                _unsaved[0]()

    with contextlib.suppress(OSError):
        os.write(2, b"\nqdenv: saving; interrupt again to quit at once\n")
    saving = threading.Thread(target=save, daemon=True)
    saving.start()
    reader.settimeout(_LOOK_SECONDS)
    while saving.is_alive():
        with contextlib.suppress(TimeoutError):
            _await_signal(reader)
            return


def save_first(save: Callable[[], None] | None) -> None:
    """Set what an interruption saves before the end, in a thread; None for nothing.

    Work that goes on waits where it would change what is saved: it holds `undisturbed` there.
    """
    _unsaved[:] = [] if save is None else [save]


@atexit.register
def discard_unfinished() -> None:
    """Delete unfinished files, and what is reserved and still empty."""
    for path in list(unfinished):
        with contextlib.suppress(OSError):
            os.unlink(path)
    for path in sorted(reserved, key=len, reverse=True):  # what lies in a folder before it
        with contextlib.suppress(OSError):
            if os.path.isdir(path):
                os.rmdir(path)
            elif os.path.getsize(path) == 0:
                os.unlink(path)
    unfinished.clear()
    reserved.clear()


def advise(folder: object = None) -> None:
    """Set what `advice` names: `qdenv resume` with a run's `folder`, or else this program.

    In a program the first call counts: later ones are about a part of the same work.
    """
    if not (_again[0] and _way[0]):
        _way[0] = f"`qdenv resume {shlex.quote(str(folder))}`" if folder else _again[0]


def advice() -> str:
    """Return how to go on after an interruption; "" if nothing is known."""
    if _way[0]:
        return f"{_way[0]} goes on"
    return f"{_again[0]} runs it again" if _again[0] else ""


def last_words() -> str:
    """Return the line that an interrupted command ends with."""
    return f"qdenv: stopped; {advice()}" if advice() else "qdenv: stopped"
