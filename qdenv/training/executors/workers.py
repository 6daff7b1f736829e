"""The workers of a Dask cluster, none of which is trusted to live (https://distributed.dask.org).

Killed workers, slow ones and those of other versions cost time, never an answer.
"""

from __future__ import annotations

import logging
import statistics
import time
from collections import deque
from collections.abc import Callable, Mapping, Sequence
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
        progress: Callable[[int], None] = lambda size: None,
    ) -> None:
        """Send nothing yet.

        Args:
            client: of the cluster.
            work: what is done with each task.
            progress: told how much more is done.
        """
        self._client, self._work, self._progress = client, work, progress
        self._seconds: deque[float] = deque([0.0], REMEMBERED)

    def begin(self, tasks: Sequence[tuple], sizes: Sequence[int] = ()) -> Batch:
        """Send all tasks; several batches may be out at once.

        Args:
            tasks: a tuple of arguments each.
            sizes: how much progress each of them is; 1 unless given.
        """
        return Batch(self, tasks, sizes or [1] * len(tasks))

    def submit(self, tasks: Sequence[tuple], among: Sequence[str] = ()) -> list[Future]:
        """Send tasks to whoever is free, if possible among these workers."""
        chosen = {"workers": list(among), "allow_other_workers": True} if among else {}
        columns = [self._work] * len(tasks), *zip(*tasks, strict=True)
        sent: list[Future] = self._client.map(timed, *columns, pure=False, **chosen)
        return sent

    def answers(self, futures: Mapping[int, Future], sizes: Sequence[int]) -> dict[int, Any]:
        """Fetch answers that are there, by the numbers of their tasks, in one go.

        Where something went wrong in the meantime there is none.

        Args:
            futures: by number.
            sizes: of all tasks.
        """
        said = self._client.gather(dict(futures), errors="skip")
        whole = {number: answer for number, answer in said.items() if answer is not None}
        self._seconds.extend(took / sizes[number] for number, (took, _) in whole.items())
        return {number: answer for number, (_, answer) in whole.items()}

    def advance(self, size: int) -> None:
        """Note that a task is done, which is so much progress."""
        self._progress(size)

    @property
    def count(self) -> int:
        """How many workers there are; 1 while all are being replaced."""
        return max(len(self._client.nthreads()), 1)

    @property
    def usual(self) -> float:
        """Seconds that tasks of size 1 took lately, the median; 0 before the first."""
        return statistics.median(self._seconds)

    def patience(self, size: int) -> float:
        """Seconds without an answer to tasks of a size after which others are asked, too."""
        return max(PATIENCE, SLOW * self.usual * size)

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
        if futures:
            self._client.cancel(futures, force=True)


class Batch:
    """Tasks under way, by their numbers."""

    def __init__(self, workers: Workers, tasks: Sequence[tuple], sizes: Sequence[int]) -> None:
        """Send all tasks, each of a size."""
        self._workers, self._tasks, self._sizes = workers, tasks, sizes
        self._sent: dict[int, list[Future]] = {number: [] for number in range(len(tasks))}
        self._answers: dict[int, Any] = {}
        self._errors = dict.fromkeys(self._sent, 0)
        self._deaths = dict.fromkeys(self._sent, 0)
        self._told: set[int] = set()  # tasks whose progress is noted
        self._heard = 0.0  # when somebody answered last
        self._send(list(self._sent))

    def finish(self) -> list[Any]:
        """Wait for all answers and give them in order.

        Raises:
            InputError: no worker has the versions of the search, or a task keeps killing workers.
            Exception: whatever a task raises each time it is tried.
        """
        import distributed

        self._heard = time.monotonic()  # until now nobody listened
        largest = max(self._sizes, default=1)
        while self._sent:
            futures = [future for sent in self._sent.values() for future in sent]
            # The first answer to a task that is out twice will do.
            until = "ALL_COMPLETED" if len(futures) == len(self._sent) else "FIRST_COMPLETED"
            left = self._heard + self._workers.patience(largest) - time.monotonic()
            try:
                distributed.wait(futures, max(left, 0.01), until)
            except TimeoutError:
                if time.monotonic() >= self._heard + self._workers.patience(largest):
                    self._ask_others()
            self._collect()
        return [self._answers[number] for number in sorted(self._answers)]

    def _send(self, numbers: Sequence[int], among: Sequence[str] = ()) -> None:
        tasks = [self._tasks[number] for number in numbers]
        for number, future in zip(numbers, self._workers.submit(tasks, among), strict=True):
            future.add_done_callback(lambda _, number=number: self._hear(number))
            self._sent[number].append(future)

    def _hear(self, number: int) -> None:
        """Note that a task came back; in a thread of the cluster's client."""
        self._heard = time.monotonic()
        if number not in self._told:
            self._told.add(number)
            self._workers.advance(self._sizes[number])

    def _ask_others(self) -> None:
        """Send what is still out once more: its worker may hang. The first answer counts."""
        out = [future for sent in self._sent.values() for future in sent if not future.done()]
        late = [number for number, sent in self._sent.items() if not any(f.done() for f in sent)]
        LOG.warning("%d tasks are overdue and sent to others, too", len(late))
        self._send(late, self._workers.without(out))
        self._heard = time.monotonic()

    def _collect(self) -> None:
        """Take all answers that are there, and send again what failed."""
        there = {
            number: future
            for number, sent in self._sent.items()
            for future in sent
            if future.status == "finished"
        }
        answers = self._workers.answers(there, self._sizes) if there else {}
        self._answers |= answers
        self._workers.forget([future for number in answers for future in self._sent.pop(number)])
        for number, sent in self._sent.items():
            for future in [one for one in sent if one.done() and one.status != "finished"]:
                sent.remove(future)
                self._excuse(number, future)
        self._send([number for number, sent in self._sent.items() if not sent])

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
