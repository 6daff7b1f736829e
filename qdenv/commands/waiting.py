"""What a person sees while a command works: what it does, how far it is, how long it will take.

    with waiting("simulating", total=10) as bar:
        for seed in range(10):
            ...
            bar.update()
            bar.print(f"seed {seed}: done")

Nothing is shown of what takes less than two seconds, nor where standard error is no terminal.
"""

import sys
import threading
import time
from typing import Any, Self

PATIENCE = 2.0  # seconds that pass before anything is shown
TICK = 0.25  # seconds between two pictures
COUNTED = "{desc} {percentage:3.0f} %|{bar:24}| {elapsed}, about {remaining} left{postfix}"
UNCOUNTED = "{desc} {elapsed}{postfix}"
COMPILING = "numba:compile"  # the event of which numba tells


class waiting:  # noqa: N801 (read as a verb: `with waiting("simulating") as bar`)
    """A bar on standard error that moves by itself and names what is compiled meanwhile.

    A context manager. Any thread may move it; called as ``bar(doing, share)`` it is what
    `repair.recipe.repair_layout` and the studies take as `progress`.
    """

    def __init__(self, doing: str, total: float = 0, shown: bool | None = None) -> None:
        """Show nothing yet.

        Args:
            doing: what takes its time, like "simulating".
            total: how much there is to do; 0 where nobody knows, then only the time is shown.
            shown: None for on a terminal only.
        """
        self._shown = sys.stderr.isatty() if shown is None else shown
        self._bar: Any = None
        self._ended = threading.Event()
        self._compiled: list[str] = []
        self.begin(doing, total)

    def begin(self, doing: str, total: float = 0) -> None:
        """Begin the next step; what is left is reckoned from here on."""
        self._step = (doing, total, time.time())
        self._done, self._note = 0.0, ""

    def update(self, count: float = 1) -> None:
        """Move on."""
        self._done += count

    def note(self, text: str) -> None:
        """Say how things stand behind the bar, like "seed 3 of 10"."""
        self._note = text

    def __call__(self, doing: str, share: float, note: str = "") -> None:
        """Show which share of a step is done (0 to 1; below 0 where nobody knows)."""
        if doing != self._step[0]:
            self.begin(doing, 1.0 if share >= 0 else 0.0)
        self._done, self._note = share, note

    def print(self, line: str) -> None:
        """Print a line to standard output above the bar."""
        from tqdm import tqdm  # here: who is refused should not wait for it

        tqdm.write(line)
        sys.stdout.flush()  # a reader behind a pipe waits for it, too

    def __enter__(self) -> Self:
        """Start the clock."""
        if self._shown:
            self._deafen = self._listen()
            self._thread = threading.Thread(target=self._tick, daemon=True)
            self._thread.start()
        return self

    def __exit__(self, *exception: object) -> None:
        """Take the bar away."""
        self._ended.set()
        if self._shown:
            self._deafen()
            self._thread.join()

    def _tick(self) -> None:
        """Draw the bar again and again, in a thread of its own."""
        rest = PATIENCE
        while not self._ended.wait(rest):
            rest = TICK
            self._draw()
        if self._bar is not None:
            self._bar.close()

    def _draw(self) -> None:
        from tqdm import tqdm  # here: who is refused should not wait for it

        doing, total, since = self._step
        compiling = [f"compiling {room}, once on this machine" for room in self._compiled[-1:]]
        if self._bar is None:
            # A delay, however short, keeps it from drawing before it knows what.
            self._bar = tqdm(file=sys.stderr, dynamic_ncols=True, leave=False, delay=1e-9)
        bar = self._bar
        bar.bar_format = COUNTED if total and self._done > 0 else UNCOUNTED
        bar.total, bar.n, bar.start_t = total or None, min(self._done, total), since
        bar.set_description_str(doing, refresh=False)
        bar.set_postfix_str(", ".join(filter(None, [self._note, *compiling])), refresh=False)
        bar.refresh()

    def _listen(self) -> Any:
        """Hear of what numba compiles; returns what ends that."""
        from numba.core import event  # here: takes long, and only who waits needs it

        compiled = self._compiled

        class Ear(event.Listener):
            def on_start(self, event: Any) -> None:
                module = event.data["dispatcher"].py_func.__module__
                # numba compiles parts of its own on the way.
                own = module.startswith("qdenv.")
                room = module.removeprefix("qdenv.").rpartition(".")[0]
                compiled.append(room if own else compiled[-1] if compiled else "numba")

            def on_end(self, event: Any) -> None:
                compiled[-1:] = []

        ear = Ear()
        event.register(COMPILING, ear)
        return lambda: event.unregister(COMPILING, ear)
