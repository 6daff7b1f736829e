"""How far a long task is: the one protocol that tasks call, and the one bar that shows it."""

import contextlib
import sys
import threading
import time
from collections.abc import Callable, Iterator
from typing import Any, Self, TypeAlias

# What long tasks call: (name of the step, its completed share or -1 if unknown, status)
Progress: TypeAlias = Callable[[str, float, str], None]

_PATIENCE = 2.0  # seconds before anything is shown: quick tasks show nothing
_TICK = 0.25  # seconds between two drawings on a terminal
_FILE_TICK = 10.0  # seconds between two drawings into a file, where each is a line
_COUNTED = "{desc} {percentage:3.0f} %|{bar:24}| {elapsed}, about {remaining} left{postfix}"
_UNCOUNTED = "{desc} {elapsed}{postfix}"


def silent(step: str, share: float, note: str = "") -> None:
    """Show no progress."""


class Bar:
    """A bar on standard error that redraws itself and names what is being compiled.

    A context manager. Any thread may update it; it is a `Progress` itself.
    """

    def __init__(
        self, step: str, total: float = 0, shown: bool | None = None, unit: str = ""
    ) -> None:
        """Show nothing yet.

        A `total` of 0 is unknown: then only the time is shown. A bar with a `unit` shows its number
        and rate, appears at once and stays at the end; others show the share alone. `shown`
        defaults to whether standard error is a terminal.
        """
        self._terminal, self._unit = sys.stderr.isatty(), unit
        self._bar: Any = None
        self._shown = self._terminal if shown is None else shown
        self._ended = threading.Event()
        self._compiling: list[str] = []
        self.begin(step, total)

    def begin(self, step: str, total: float = 0, done: float = 0) -> None:
        """Begin the next step, of which some may be done; the rest is estimated from here on."""
        self._step, self._total, self._first, self._since = step, total, done, time.time()
        self._done, self._note = done, ""
        self._waiting: tuple[str, float] | None = None

    def update(self, count: float = 1) -> None:
        """Advance by `count`."""
        if self._unit and self._done == self._first:
            # Until the first update a search compiles, which says nothing about the rest.
            self._since = time.time()
        self._waiting = None
        self._done += count

    def note(self, text: str) -> None:
        """Show a status behind the bar, like "seed 3 of 10"."""
        self._waiting, self._note = None, text

    def wait_for(self, what: str) -> None:
        """Show, until the next update, what delays it and for how long, in place of the status."""
        self._waiting = what, time.time()

    @contextlib.contextmanager
    def waiting_for(self, what: str) -> Iterator[None]:
        """Show what the block does and for how long, in place of the status."""
        self._waiting = mine = what, time.time()
        yield
        if self._waiting is mine:  # else another thread has something to show meanwhile
            self._waiting = None

    def __call__(self, step: str, share: float, note: str = "") -> None:
        """Show the completed share of a step (0 to 1; -1 if unknown)."""
        if step != self._step:
            self.begin(step, 1.0 if share >= 0 else 0.0)
        self._done, self._note = share, note

    def __enter__(self) -> Self:
        """Start to draw."""
        if self._shown:
            self._stop_listening = _listen(self._compiling)
            self._thread = threading.Thread(target=self._redraw, daemon=True)
            self._thread.start()
        return self

    def __exit__(self, *exception: object) -> None:
        """Remove the bar; one with a unit stays as it is."""
        self._ended.set()
        if self._shown:
            self._stop_listening()
            self._thread.join()

    def _redraw(self) -> None:
        """Draw the bar periodically, in a thread of its own, until the output is closed."""
        delay = _TICK if self._unit else _PATIENCE
        with contextlib.suppress(OSError), contextlib.ExitStack() as self._open:
            while not self._ended.wait(delay):
                delay = _TICK if self._terminal or not self._unit else _FILE_TICK
                self._draw()
            if self._unit:
                self._draw()

    def _draw(self) -> None:
        from tqdm import tqdm  # here: refused command lines must not wait for this import

        if self._bar is None:
            # A delay, however short, keeps tqdm from drawing before it has the description.
            self._bar = tqdm(
                file=sys.stderr,
                dynamic_ncols=True,
                leave=bool(self._unit),
                delay=1e-9,
                unit=self._unit or "it",
            )
            self._open.callback(self._bar.close)
        bar, waiting = self._bar, self._waiting
        notes = [f"{waiting[0]}: {time.time() - waiting[1]:.0f} s" if waiting else self._note]
        notes += [f"compiling {folder}, once on this machine" for folder in self._compiling[-1:]]
        if not self._unit:
            bar.bar_format = _COUNTED if self._total and self._done > 0 else _UNCOUNTED
        bar.total, bar.n = self._total or None, min(self._done, self._total)
        bar.initial, bar.start_t = self._first, self._since
        bar.set_description_str(self._step, refresh=False)
        bar.set_postfix_str(", ".join(filter(None, notes)), refresh=False)
        with bar.get_lock():  # where drawing fails, `refresh` itself never gives it back
            bar.refresh(nolock=True)


def _listen(compiling: list[str]) -> Callable[[], None]:
    """Maintain the stack of qdenv's folders that numba compiles; return what ends that."""
    from numba.core import event  # here: it takes long, and only a shown bar needs it

    class Listener(event.Listener):
        def on_start(self, event: Any) -> None:
            module = event.data["dispatcher"].py_func.__module__
            folder = module.removeprefix("qdenv.").rpartition(".")[0]
            # numba compiles parts of its own on the way: these belong to what they are part of.
            own = module.startswith("qdenv.")
            compiling.append(folder if own else compiling[-1] if compiling else "numba")

        def on_end(self, event: Any) -> None:
            compiling[-1:] = []

    listener = Listener()
    event.register("numba:compile", listener)
    return lambda: event.unregister("numba:compile", listener)
