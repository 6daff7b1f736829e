"""Where the layouts of a search are repaired and simulated: in this process, or on a cluster.

A Dask cluster (https://distributed.dask.org) is a `concurrent.futures.Executor` here. Workers that
are killed, that hang or that have other versions cost time, never a result: a task's result depends
on the task alone, so any copy of it will do. Dask's own `Client.get_executor` gives up on a task
whose worker hangs, and would accept results of other versions.
"""

from __future__ import annotations

import contextlib
import hashlib
import logging
import platform
import queue
import statistics
import threading
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from concurrent import futures
from concurrent.futures import Executor, Future, InvalidStateError
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from time import monotonic, perf_counter
from typing import TYPE_CHECKING, Any, Literal

from qdenv import devices, interrupt
from qdenv.ranges import PositiveInt, Ranged
from qdenv.run.directory import package_versions
from qdenv.types import InputError, require_package

if TYPE_CHECKING:
    import distributed

ExecutorName = Literal["threads", "dask"]
_ANSWER = 20  # seconds that a scheduler may take to answer
_ARRIVAL = 120  # seconds that the first worker may take to join
_LOG = logging.getLogger(__name__)
# Packages whose version decides a result.
_PACKAGES = ("jax", "jaxlib", "numpy", "numba", "highspy", "flax")
# A task's own errors repeat; one that a full disk or a broken network caused passes within three.
_MAX_ERRORS = 3
# Clusters kill workers for reasons of their own, so only many deaths are blamed on the task.
_MAX_DEATHS = 10
# Seconds without any answer, or _SLOW times what a task takes, until copies are sent to others.
PATIENCE = 30.0
_SLOW = 5.0
SETTINGS = {
    # Workers would sample their work a hundred times a second, for a dashboard without a reader.
    "distributed.worker.profile.enabled": False,
    # A local cluster gives up for ever on a worker that is not back this long after its death. On
    # a busy machine the nanny takes longer to start another: the search would never end.
    "distributed.deploy.lost-worker-timeout": "1 day",
}
REMEMBERED = 100  # tasks whose duration is remembered
_TICK = 0.5  # seconds between two looks for overdue tasks


@dataclass(frozen=True)
class Execution(Ranged):
    """Where layouts are repaired and simulated; decides how long a run takes, not what it finds."""

    executor: ExecutorName = "threads"  # threads of this process, or a Dask cluster
    # address of the cluster's scheduler; by default a cluster on this machine
    scheduler: str | None = None
    # threads that repair, or processes of a cluster on this machine; by default one per core
    workers: PositiveInt | None = None

    def __post_init__(self) -> None:
        """Refuse what contradicts itself, and a cluster without Dask."""
        super().__post_init__()
        if self.executor == "threads":
            if self.scheduler:
                raise InputError("--scheduler is for a cluster: add --executor dask")
            return
        if self.scheduler and self.workers:
            raise InputError("--workers is for a cluster on this machine: leave --scheduler out")
        for package in ("distributed", "cryptography"):  # that makes a local cluster's certificates
            require_package("clusters", package, "dask")

    @contextlib.contextmanager
    def connect(self) -> Iterator[distributed.Client]:
        """Connect to a cluster that has a worker; one on this machine ends with the context."""
        import dask
        from distributed import Client, LocalCluster

        with contextlib.ExitStack() as stack:
            stack.enter_context(dask.config.set(SETTINGS))
            # A client logs that it loses its scheduler; the line that ends the search says so.
            logging.getLogger("distributed.client").setLevel(logging.CRITICAL)
            place = cluster = self.scheduler
            if place is None:
                local = LocalCluster(
                    # Else every user of this machine could run code as this one.
                    security=True,
                    n_workers=self.workers or devices.count_cores(),
                    threads_per_worker=1,
                    memory_limit=0,  # a worker is not ended for what a layout needs
                    dashboard_address="127.0.0.1:0",  # any port: several searches may run
                    silence_logs=logging.CRITICAL,
                )
                cluster = stack.enter_context(local)
                place = local.scheduler_address
            try:
                client = stack.enter_context(Client(cluster, timeout=_ANSWER))
                client.wait_for_workers(1, timeout=_ARRIVAL)
            except (OSError, ValueError, TimeoutError) as error:
                hint = f"start `dask scheduler` and `dask worker {place}` first"
                raise InputError(f"{place}: no worker answers ({error}): {hint}") from error
            yield client


class WrongWorkerError(RuntimeError):
    """A worker has other versions than this process: none of its results may be used."""


@lru_cache(maxsize=1)
def versions() -> str:
    """Return what decides a result: versions of packages, a hash of this one's code and agent."""
    code = hashlib.blake2b(digest_size=8)
    home = Path(__file__).parents[1]
    files = (path for path in home.rglob("*") if path.suffix in (".py", ".npz"))  # and the agent
    for path in sorted(files):
        code.update(path.relative_to(home).as_posix().encode() + path.read_bytes())
    packages = [f"{name} {number}" for name, number in package_versions(_PACKAGES).items()]
    python = ".".join(platform.python_version_tuple()[:2])
    return ", ".join([f"python {python}", *packages, f"qdenv {code.hexdigest()}"])


def perform(required: str, work: Callable[..., Any], arguments: tuple) -> tuple[float, Any]:
    """Perform a task on a worker; return its duration in seconds and its result.

    Raises WrongWorkerError if this worker's `versions` are not those required.
    """
    if versions() != required:
        raise WrongWorkerError(versions())
    start = perf_counter()
    result = work(*arguments)
    return perf_counter() - start, result


class Task(Future):
    """The future of a task's result, with what the executor knows of the task."""

    def __init__(self, work: Callable[..., Any], arguments: tuple) -> None:
        """Describe a task of which no copy was sent yet."""
        super().__init__()
        self.work, self.arguments = work, arguments
        self.copies: list[distributed.Future] = []  # that are in the cluster
        self.errors = self.deaths = 0  # of its copies, and of workers that had one
        self.seconds = 0.0  # that it took on the worker


class ClusterExecutor(Executor):
    """Perform tasks on the workers of a cluster.

    One thread of this process owns all tasks. It sends them, collects results, sends again what
    failed or is overdue. It learns of a change (a new task, a copy that returned) by the task in
    its queue.
    """

    def __init__(
        self, client: distributed.Client, on_done: Callable[[Task], None] = lambda task: None
    ) -> None:
        """Send nothing yet; the executor's thread calls `on_done` before a result is set."""
        self._client, self._on_done = client, on_done
        self._events: queue.SimpleQueue[Task | None] = queue.SimpleQueue()
        self._pending: dict[Task, None] = {}  # in the order in which they were submitted
        self._seconds: deque[float] = deque([0.0], REMEMBERED)
        self._error: BaseException | None = None
        self._thread = threading.Thread(target=self._supervise, daemon=True)
        self._thread.start()

    def submit(self, work: Callable[..., Any], /, *arguments: Any, **options: Any) -> Task:
        """Send a task: a function of the package, or what cloudpickle can send."""
        if options:
            raise TypeError("keyword arguments are not sent: bind them by functools.partial")
        if self._error is not None:
            raise RuntimeError("the executor has ended") from self._error
        task = Task(work, arguments)
        self._pending[task] = None
        self._events.put(task)
        return task

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        """End the executor; the client stays open."""
        if wait and not cancel_futures:
            futures.wait(list(self._pending))
        self._events.put(None)
        if wait:
            self._thread.join()

    def _supervise(self) -> None:
        """Manage all tasks until the executor ends, in a thread of its own."""
        changed_at = monotonic()  # when something changed last
        try:
            while (changed := self._changes()) is not None:
                usual = statistics.median(self._seconds)
                if changed:
                    self._collect(changed)
                    changed_at = monotonic()
                elif self._pending and monotonic() - changed_at >= max(PATIENCE, _SLOW * usual):
                    self._send_copies()
                    changed_at = monotonic()
        except BaseException as error:  # no result will come
            if self._client.status == "running":
                self._error = error
            else:
                self._error = InputError(f"the cluster's scheduler is gone; {interrupt.advice()}")
            for task in list(self._pending):
                self._settle(task, error=self._error)
        self._error = self._error or RuntimeError("it was shut down")
        with contextlib.suppress(Exception):  # the client may be closed
            self._client.cancel([one for task in list(self._pending) for one in task.copies])
        for task in list(self._pending):
            task.cancel()

    def _changes(self) -> list[Task] | None:
        """Wait a moment for tasks that changed; None means that the executor ends."""
        events: list[Task | None] = []
        with contextlib.suppress(queue.Empty):
            events.append(self._events.get(timeout=_TICK))
            while True:
                events.append(self._events.get_nowait())
        return None if None in events else [one for one in dict.fromkeys(events) if one]

    def _collect(self, changed: Sequence[Task]) -> None:
        """Take all results that are there, and send again what failed."""
        changed = [task for task in changed if task in self._pending]
        finished = {
            number: copy
            for number, task in enumerate(changed)
            for copy in task.copies
            if copy.status == "finished"
        }
        # One request for all; a result that was lost with its worker meanwhile is left out.
        answers = self._client.gather(finished, errors="skip") if finished else {}
        for number, answer in answers.items():
            if answer is not None:
                task = changed[number]
                task.seconds, result = answer
                self._seconds.append(task.seconds)
                self._settle(task, result)
        for task in changed:
            for copy in [one for one in task.copies if one.done() and not task.done()]:
                task.copies.remove(copy)
                self._examine(task, copy)
        self._send([task for task in changed if not task.done() and not task.copies])

    def _settle(self, task: Task, result: Any = None, error: BaseException | None = None) -> None:
        """End a task by its result or an error, and cancel its other copies."""
        del self._pending[task]
        copies, task.copies = task.copies, []
        if error is None and len(copies) > 1:
            self._client.cancel(copies, force=True)
        with contextlib.suppress(InvalidStateError):  # the caller has cancelled it
            if error is None:
                self._on_done(task)
                task.set_result(result)
            else:
                task.set_exception(error)

    def _examine(self, task: Task, copy: distributed.Future) -> None:
        """Decide whether a failed copy is worth another try, or ends the task."""
        from distributed import KilledWorker

        error = copy.exception() if copy.status == "error" else None
        if error is None:  # lost with its worker
            return
        if isinstance(error, KilledWorker):
            task.deaths += 1
            if task.deaths >= _MAX_DEATHS:
                text = f"workers keep dying ({error}): give them more memory"
                self._settle(task, error=InputError(text))
            return
        # Other versions may also lack the function, or fail to read what was sent.
        if isinstance(error, WrongWorkerError | ImportError | AttributeError):
            try:
                if self._dismiss():
                    return
            except InputError as refusal:
                self._settle(task, error=refusal)
                return
        task.errors += 1
        if task.errors >= _MAX_ERRORS:
            self._settle(task, error=error)

    def _send(self, tasks: Sequence[Task], workers: Sequence[str] = ()) -> None:
        """Send a copy of each task to any worker, or if possible to one of these."""
        tasks = [task for task in tasks if not task.cancelled()]
        if not tasks:
            return
        options = {"workers": list(workers), "allow_other_workers": True} if workers else {}
        columns = [task.work for task in tasks], [task.arguments for task in tasks]
        required = [versions()] * len(tasks)
        copies = self._client.map(perform, required, *columns, pure=False, **options)
        for task, copy in zip(tasks, copies, strict=True):
            task.copies.append(copy)
            copy.add_done_callback(lambda _, task=task: self._events.put(task))

    def _send_copies(self) -> None:
        """Send another copy of each pending task: its worker may hang. The first result counts."""
        _LOG.warning("%d tasks are overdue and sent to others, too", len(self._pending))
        keys = {copy.key for task in list(self._pending) for copy in task.copies}
        free = [worker for worker, has in self._client.processing().items() if not keys & {*has}]
        self._send(list(self._pending), free)

    def _dismiss(self) -> int:
        """Retire the workers of other versions; return their number.

        Raises InputError if no other worker is left.
        """
        answers = self._client.run(versions, on_error="return")
        wrong = {worker: one for worker, one in answers.items() if one != versions()}
        for worker, one in wrong.items():
            _LOG.warning("worker %s is retired: it has %s, not %s", worker, one, versions())
        if wrong:
            self._client.retire_workers(list(wrong))
        if wrong and len(wrong) == len(answers):
            cure = f"install the same qdenv and packages there ({versions()})"
            raise InputError(f"every worker has other versions than the search: {cure}")
        return len(wrong)
