"""The progress bar of a run, which says what it waits for until the first evaluations are done."""

import contextlib
import functools
import sys
import threading
import time
from collections.abc import Callable, Iterator
from typing import Any, Self

from numba.core import event
from tqdm import tqdm

from qdenv.pipeline import Pipeline
from qdenv.search.base import Algorithm

TICK = 1.0  # seconds


class Progress(event.Listener):
    """A bar of evaluations that names what is compiled, and for how long, while it stands still.

    Both compilers are watched: what XLA traces is compiled next, and numba tells of each function
    of which it finds no machine code on this machine.
    """

    def __init__(self, total: int, shown: bool) -> None:
        """Show nothing yet.

        Args:
            total: evaluations of the run.
            shown: False shows nothing ever.
        """
        self._total, self._shown = total, shown
        self._bar: Any = None
        self._moves = threading.Event()
        self._waits_for = self._state = ""

    def __enter__(self) -> Self:
        """Start to watch."""
        event.register("numba:compile", self)
        return self

    def __exit__(self, *exception: object) -> None:
        """Stop watching; the bar stays as it is."""
        event.unregister("numba:compile", self)
        self._moves.set()
        if self._bar is not None:
            self._bar.close()

    def begin(self, done: int) -> None:
        """Show the bar of a run of which `done` evaluations were done before."""
        # Into a file a line now and then will do.
        often = {"mininterval": 0.1 if sys.stderr.isatty() else 10.0, "smoothing": 0.1}
        self._bar = tqdm(
            total=self._total, initial=done, unit="eval", disable=not self._shown, **often
        )
        self._done, self._since = done, time.perf_counter()
        if self._shown:
            waits_for = (lambda: self._waits_for), self._since, self._moves
            threading.Thread(target=self._tell, args=waits_for, daemon=True).start()

    def advance(self, evaluations: int) -> None:
        """Move on within an iteration; any thread may call this."""
        self._set_moving()
        self._bar.update(evaluations)

    def update(self, evaluations: int, state: str) -> None:
        """End an iteration of so many evaluations and say how the search stands."""
        self._set_moving()
        self._done += evaluations
        self._state = state
        self._bar.set_postfix_str(state, refresh=False)
        # Layouts of later populations may be done already.
        self._bar.update(max(0, self._done - self._bar.n))
        self._bar.refresh()  # a tick a moment ago would make tqdm leave this state out

    def _set_moving(self) -> None:
        if not self._moves.is_set():
            self._moves.set()
            self._bar.set_postfix_str("", refresh=False)
            self._bar.unpause()  # what compiling took tells nothing of how long the rest takes

    @contextlib.contextmanager
    def during(self, what: str) -> Iterator[None]:
        """Say what an iteration waits for, where nothing else moves for a while."""
        done = threading.Event()
        if (
            self._shown and self._moves.is_set()
        ):  # until the first evaluations are done others speak
            since = time.perf_counter()
            threading.Thread(
                target=self._tell, args=(lambda: what, since, done), daemon=True
            ).start()
        try:
            yield
        finally:
            done.set()
            if self._moves.is_set():
                self._bar.set_postfix_str(self._state, refresh=False)

    def over_pipeline(self, pipeline: Pipeline) -> Pipeline:
        """Watch the stages of an evaluation."""
        return pipeline._replace(
            grow=self._told("generator and repair", pipeline.grow),
            simulate=self._told("simulator", pipeline.simulate),
            score=self._told("score", pipeline.score),
        )

    def over_algorithm(self, algorithm: Algorithm) -> Algorithm:
        """Watch a search."""
        return algorithm._replace(
            ask=self._told("search", algorithm.ask), tell=self._told("search", algorithm.tell)
        )

    def on_start(self, event: Any) -> None:
        """Hear that numba compiles a function; its machine code is kept for later runs."""
        module = event.data["dispatcher"].py_func.__module__
        if module.startswith("qdenv."):  # numba compiles parts of its own on the way
            room = module.removeprefix("qdenv.").rpartition(".")[0]
            self._waits_for = f"compiling {room}, once on this machine"

    def on_end(self, event: Any) -> None:
        """Hear that numba is done."""

    def _told(self, what: str, function: Callable) -> Callable:
        """Let a function say that it is traced, which is when it will be compiled."""

        @functools.wraps(function)
        def traced(*given: Any) -> Any:
            self._waits_for = f"compiling and running the {what}"
            return function(*given)

        return traced

    def _tell(self, what: Callable[[], str], since: float, done: threading.Event) -> None:
        while not done.wait(TICK):
            self._bar.set_postfix_str(f"{what()}: {time.perf_counter() - since:.0f} s")
