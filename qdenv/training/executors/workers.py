"""The workers of a Dask cluster, none of which is trusted to live (https://distributed.dask.org).

Killed workers, slow ones and those of other versions cost time, never an answer.
"""

from __future__ import annotations

import logging
import statistics
import time
from collections import deque
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

from qdenv.training.executors.task import WrongWorkerError, timed, versions
from qdenv.types import InputError

if TYPE_CHECKING:
    from distributed import Client, Future

LOG = logging.getLogger(__name__)
TRIES = 3  # of a task that raises an error
DEATHS = 10  # times that a task may end its workers before it is to blame
PATIENCE = 30.0  # seconds without any answer, or SLOW times what one takes, until others are asked
SLOW = 5.0
REMEMBERED = 100  # answers whose time says what one takes


class Workers:
    """Workers that all do one kind of task, whose answer depends on nothing but the task."""

    def __init__(
        self,
        client: Client,
        work: Callable[..., Any],
        progress: Callable[[int], None] = lambda tasks: None,
    ) -> None:
        """Send nothing yet.

        Args:
            client: of the cluster.
            work: what is done with each task.
            progress: told how many tasks more are done.
        """
        self._client, self._work, self._progress = client, work, progress
        self._seconds: deque[float] = deque([0.0], REMEMBERED)

    def begin(self, tasks: Sequence[tuple]) -> Batch:
        """Send all tasks, each a tuple of arguments; several batches may be out at once."""
        return Batch(self, tasks)

    def submit(self, task: tuple, among: Sequence[str] = ()) -> Future:
        """Send one task to whoever is free, if possible among these workers."""
        chosen = {"workers": list(among), "allow_other_workers": True} if among else {}
        return self._client.submit(timed, self._work, *task, pure=False, **chosen)

    def answered(self, seconds: float) -> None:
        """Note that a task is done, and how long its worker worked on it."""
        self._seconds.append(seconds)
        self._progress(1)

    @property
    def patience(self) -> float:
        """Seconds without any answer after which others are asked, too."""
        return max(PATIENCE, SLOW * statistics.median(self._seconds))

    def without(self, futures: Sequence[Future]) -> list[str]:
        """List the workers that have nothing to do with these tasks."""
        keys = {future.key for future in futures}
        held = self._client.processing()
        return [address for address, mine in held.items() if not keys & {*mine}]

    def dismiss(self) -> int:
        """Send away the workers of other versions; say how many there were."""
        said = self._client.run(versions, on_error="return")
        wrong = {address: one for address, one in said.items() if one != versions()}
        for address, one in wrong.items():
            LOG.warning("worker %s is sent away: it has %s, not %s", address, one, versions())
        if wrong:
            self._client.retire_workers(list(wrong))
        if wrong and len(wrong) == len(said):
            raise InputError(
                "every worker has other versions than the search: install the same qdenv and "
                f"packages there ({versions()})"
            )
        return len(wrong)

    def forget(self, futures: list[Future]) -> None:
        """Take back what nobody waits for any more."""
        self._client.cancel(futures, force=True)


class Batch:
    """Tasks under way, by their numbers."""

    def __init__(self, workers: Workers, tasks: Sequence[tuple]) -> None:
        """Send all tasks."""
        self._workers, self._tasks = workers, tasks
        self._sent: dict[int, list[Future]] = {number: [] for number in range(len(tasks))}
        self._answers: dict[int, Any] = {}
        self._errors = dict.fromkeys(self._sent, 0)
        self._deaths = dict.fromkeys(self._sent, 0)
        for number in self._sent:
            self._send(number)
        self._heard = 0.0  # when the last answer came

    def finish(self) -> list[Any]:
        """Wait for all answers and give them in order.

        Raises:
            InputError: no worker has the versions of the search, or a task keeps killing workers.
            Exception: whatever a task raises each time it is tried.
        """
        import distributed

        self._heard = time.monotonic()  # until now nobody listened
        while self._sent:
            futures = [future for sent in self._sent.values() for future in sent]
            left = self._heard + self._workers.patience - time.monotonic()
            try:
                distributed.wait(futures, max(left, 0.01), "FIRST_COMPLETED")
            except TimeoutError:
                self._ask_others()
                continue
            for number in list(self._sent):
                self._look(number)
        return [self._answers[number] for number in sorted(self._answers)]

    def _send(self, number: int, among: Sequence[str] = ()) -> None:
        self._sent[number].append(self._workers.submit(self._tasks[number], among))

    def _ask_others(self) -> None:
        """Send what is still out once more: its worker may hang. The first answer counts."""
        LOG.warning("%d tasks are overdue and sent to others, too", len(self._sent))
        out = [future for sent in self._sent.values() for future in sent]
        others = self._workers.without(out)
        for number in self._sent:
            self._send(number, others)
        self._heard = time.monotonic()

    def _look(self, number: int) -> None:
        """Take the answer of a task, or send it again if its worker failed."""
        for future in [one for one in self._sent[number] if one.done()]:
            if future.status == "finished":
                seconds, self._answers[number] = future.result()
                self._workers.forget(self._sent.pop(number))
                self._heard = time.monotonic()
                self._workers.answered(seconds)
                return
            self._sent[number].remove(future)
            self._excuse(number, future)
        if not self._sent[number]:
            self._send(number)

    def _excuse(self, number: int, future: Future) -> None:
        """Decide whether what went wrong is worth another try."""
        from distributed import KilledWorker

        error = future.exception() if future.status == "error" else None
        if error is None:  # lost with its worker
            return
        if isinstance(error, KilledWorker):
            self._deaths[number] += 1
            if self._deaths[number] >= DEATHS:
                raise InputError(f"workers keep dying ({error}): give them more memory")
            return
        foreign = isinstance(error, WrongWorkerError | ImportError | AttributeError)
        if foreign and self._workers.dismiss():
            return
        self._errors[number] += 1
        if self._errors[number] >= TRIES:
            raise error
