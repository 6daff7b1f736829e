"""What a worker of a cluster does: repair and simulate layouts, as the search itself would."""

from __future__ import annotations

import hashlib
import json
import logging
import math
import platform
import statistics
import time
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import lru_cache
from importlib import metadata
from pathlib import Path
from typing import TYPE_CHECKING, Any

import jax
import numpy as np

from qdenv.pipeline import Outcomes, Pipeline, joined
from qdenv.run.config import RunConfig, config_to_json
from qdenv.types import Array, InputError

if TYPE_CHECKING:
    from distributed import Client, Future

# Packages whose version decides a result.
PACKAGES = ("jax", "jaxlib", "numpy", "numba", "highspy", "flax")


class WrongWorkerError(RuntimeError):
    """A worker has other versions than the search: nothing it finds may enter the archive."""


@lru_cache(maxsize=1)
def versions() -> str:
    """Name what decides a result: versions of packages, and this one's very code and agent."""
    code = hashlib.blake2b(digest_size=8)
    home = Path(__file__).parents[2]
    files = (path for path in home.rglob("*") if path.suffix in (".py", ".npz"))  # and the agent
    for path in sorted(files):
        code.update(path.relative_to(home).as_posix().encode() + path.read_bytes())
    known = [f"{name} {metadata.version(name)}" for name in PACKAGES]
    python = ".".join(platform.python_version_tuple()[:2])
    return ", ".join([f"python {python}", *known, f"qdenv {code.hexdigest()}"])


def check_versions(wanted: str) -> None:
    """Refuse work for a search of other versions, which is a `WrongWorkerError`."""
    if versions() != wanted:
        raise WrongWorkerError(versions())


def timed(work: Callable[..., Any], *given: Any) -> tuple[float, Any]:
    """Do something and say how many seconds it took."""
    begun = time.perf_counter()
    answer = work(*given)
    return time.perf_counter() - begun, answer


@lru_cache(maxsize=2)
def _chain(settings: str) -> Any:
    """Build a run's chain once per worker: (pipeline, compiled simulator)."""
    import jax

    from qdenv.pipeline import make_pipeline
    from qdenv.run.config import config_from_json

    config = config_from_json(json.loads(settings), Path("the search"))
    pipeline = make_pipeline(config.evaluation, repair_seed=config.seed)
    return pipeline, jax.jit(pipeline.simulate)


Answer = tuple[np.ndarray, int, list[np.ndarray]]


def evaluate_layouts(
    settings: str, wanted: str, layouts: np.ndarray, first: int, key: np.ndarray
) -> list[Answer]:
    """Repair and simulate layouts, one by one.

    Args:
        settings: a whole `RunConfig` as JSON.
        wanted: `versions` of the search.
        layouts: int8 [n, H, W], unrepaired.
        first: index of the first of them in its population.
        key: uint32, the data of the population's key.

    Returns:
        for each the repaired layout int8 [H, W], its status, and the leaves of its runs, each with
        a leading axis 1.

    Raises:
        WrongWorkerError: this worker has other versions.
    """
    check_versions(wanted)
    return [_evaluate(settings, one, first + place, key) for place, one in enumerate(layouts)]


def _evaluate(settings: str, layout: np.ndarray, index: int, key: np.ndarray) -> Answer:
    import jax

    from qdenv.pipeline import unrepaired_as_is

    pipeline, simulate = _chain(settings)
    if pipeline.pool is None:
        repair = unrepaired_as_is(layout)
    else:
        repair = pipeline.pool.submit(layout, pipeline.repair_seed).result()
    repaired, whole = np.asarray(repair.layout), jax.random.wrap_key_data(jax.numpy.asarray(key))
    runs = simulate(repaired[None], np.array([index], np.int32), whole)
    return repaired, int(repair.status), [np.asarray(leaf) for leaf in jax.tree.leaves(runs)]


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


LONGEST = 1.0  # seconds of a task of several layouts: the scheduler spends milliseconds on each


class Cluster:
    """Repair and simulate the layouts of a search on the workers of a cluster."""

    def __init__(
        self,
        client: Client,
        config: RunConfig,
        pipeline: Pipeline,
        progress: Callable[[int], None] = lambda layouts: None,
    ) -> None:
        """Send nothing yet.

        Args:
            client: of the cluster.
            config: of the run.
            pipeline: its chain, to know the form of what comes back.
            progress: told how many layouts more are done.
        """
        self._workers = Workers(client, evaluate_layouts, progress)
        evaluation = config.evaluation
        alone = replace(evaluation, repair=replace(evaluation.repair, workers=1))
        self._settings = json.dumps(config_to_json(replace(config, evaluation=alone)))
        layouts = jax.ShapeDtypeStruct((1, *pipeline.domain.shape), np.int8)
        index, key = jax.ShapeDtypeStruct((1,), np.int32), jax.random.key(0)
        self._runs = jax.tree.structure(jax.eval_shape(pipeline.simulate, layouts, index, key))

    def __call__(self, unrepaired: np.ndarray, key: Array) -> Callable[[], Outcomes]:
        """Begin to repair and simulate int8 [B, H, W]; what it returns waits for them."""
        drawn = np.asarray(jax.random.key_data(key))
        known = self._settings, versions()
        firsts = self._divide(len(unrepaired))
        parts = np.split(unrepaired, firsts[1:])
        tasks = [(*known, *task, drawn) for task in zip(parts, firsts, strict=True)]
        batch = self._workers.begin(tasks, [len(part) for part in parts])
        return lambda: joined(
            [self._outcome(*answer) for answers in batch.finish() for answer in answers]
        )

    def _divide(self, layouts: int) -> list[int]:
        """Divide a population into tasks, ever smaller ones, so that all workers end together.

        Guided self-scheduling (Polychronopoulos and Kuck 1987): each is what is left, divided by
        the workers, but no longer than `LONGEST`.
        """
        usual = self._workers.usual  # 0 if how long a layout takes is not known yet
        most = max(round(LONGEST / usual), 1) if usual else 1
        firsts = [0]
        while (left := layouts - firsts[-1]) > 1:
            firsts.append(firsts[-1] + min(math.ceil(left / max(self._workers.count, 2)), most))
        return firsts

    def _outcome(self, layout: np.ndarray, status: int, leaves: list[np.ndarray]) -> Outcomes:
        """Give one answer of a worker the form of a population of one."""
        runs = jax.tree.unflatten(self._runs, leaves)
        return Outcomes(layout[None], np.array([status], np.int32), runs)
