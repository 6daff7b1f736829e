"""Evaluate populations: in threads or on a cluster, several in flight at once.

`Threads` and `Cluster` repair and simulate layouts (`pipeline.LayoutEvaluator`), `AsyncEvaluation`
collects populations in the order of their submission.
"""

from __future__ import annotations

import contextlib
import json
import math
import statistics
from collections import deque
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, Self

import jax
import numpy as np

from qdenv import devices
from qdenv.mesh import turn
from qdenv.pipeline import (
    LayoutEvaluator,
    Outcomes,
    Pipeline,
    PipelinedEvaluator,
    joined,
    make_pipeline,
)
from qdenv.run.config import RunConfig, config_from_json, config_to_json, override
from qdenv.run.executors import REMEMBERED, ClusterExecutor, Execution, Task
from qdenv.run.experiment import observed
from qdenv.search.base import Algorithm
from qdenv.types import Array, Evaluation, Repair, RepairStatus

if TYPE_CHECKING:
    from distributed import Client

_LONGEST = 1.0  # seconds of a task of several layouts: the scheduler spends milliseconds on each


class Threads:
    """Repair and simulate in threads of this process.

    Chunks of layouts are simulated (a compiled call releases the GIL) as soon as their repairs
    are ready: on the host's cores one layout per chunk and one thread per core, on an accelerator
    one thread that feeds larger chunks, for all of them where there are several. `progress` is
    called with the number of layouts that were completed, by any thread.
    """

    def __init__(
        self, pipeline: Pipeline, progress: Callable[[int], None] = lambda layouts: None
    ) -> None:
        """Compile nothing yet."""
        self._pipeline, self._progress = pipeline, progress
        sharing = pipeline.domain.simulator.num_devices
        self._on_host = pipeline.domain.simulator.on_host()
        # The number of layouts that one call simulates at most.
        self._chunk = 1 if self._on_host else sharing * devices.lanes(devices.ACCELERATOR_CHUNK)
        self._simulate = jax.jit(pipeline.simulate)
        # Devices that share one call must get their calls in one order, or they wait for ever.
        self._turn = turn if sharing > 1 else contextlib.nullcontext()
        self._threads = ThreadPoolExecutor(devices.threads(self._on_host))

    def __call__(
        self, unrepaired: np.ndarray, key: Array, solutions: np.ndarray | None = None
    ) -> list[Future[Outcomes]]:
        """Begin to repair and simulate int8 [B, H, W]; return the parts of the population."""
        count = len(unrepaired)
        # The greatest divisor of the number of layouts: equal chunks compile once.
        most = range(1, min(count, self._chunk) + 1)
        size = max(part for part in most if count % part == 0)
        chunks = np.arange(count, dtype=np.int32).reshape(-1, size)
        # All repairs are submitted first, so that none waits for a simulation.
        repairs = [[_repair(self._pipeline, unrepaired[one]) for one in chunk] for chunk in chunks]
        return [
            self._threads.submit(
                self._finish, chunk, repair, key, None if solutions is None else solutions[chunk]
            )
            for chunk, repair in zip(chunks, repairs, strict=True)
        ]

    def _finish(
        self, chunk: np.ndarray, repairs: list[Future[Repair]], key: Array, solutions: Any
    ) -> Outcomes:
        """Simulate the layouts of a chunk when they are repaired."""
        done = [future.result() for future in repairs]
        layouts = np.stack([repair.layout for repair in done])
        status = np.array([repair.status for repair in done], np.int32)
        with self._turn, devices.placed(self._on_host):
            runs = jax.tree.map(np.asarray, self._simulate(layouts, chunk, key, solutions))
        self._progress(len(chunk))
        return layouts, status, runs


def _repair(pipeline: Pipeline, layout: np.ndarray) -> Future[Repair]:
    """Begin to repair a layout, where its domain has rules."""
    if pipeline.pool is not None:
        return pipeline.pool.submit(layout, pipeline.repair_seed)
    untouched: Future[Repair] = Future()
    status, nothing = np.int32(RepairStatus.OPTIMAL), np.float32(0)
    untouched.set_result(Repair(layout, status, nothing, nothing, nothing))
    return untouched


class Cluster:
    """Repair and simulate the layouts of a search on the workers of a cluster.

    A task is one layout, or a few that take no time. The results depend on the layout, its index
    in the population and the key alone, not on the worker. `progress` is called with the number of
    layouts that were completed.
    """

    def __init__(self, client: Client, config: RunConfig, progress: Callable[[int], None]) -> None:
        """Send nothing yet."""
        self._client, self._progress = client, progress
        self.executor = ClusterExecutor(client, self._note)
        self._seconds: deque[float] = deque(maxlen=REMEMBERED)  # of recent layouts
        alone = override(config, {"evaluation__repair__workers": 1})
        self._settings = json.dumps(config_to_json(alone))

    def __call__(
        self, unrepaired: np.ndarray, key: Array, solutions: np.ndarray | None = None
    ) -> list[Task]:
        """Begin to repair and simulate int8 [B, H, W]; return the parts of the population.

        Tasks get ever smaller, so that all workers end together: guided self-scheduling
        (Polychronopoulos and Kuck 1987). Each is what is left, divided by the workers, but no
        longer than `_LONGEST`; while the duration of a layout is unknown, each is a task.
        """
        usual = statistics.median(self._seconds) if self._seconds else math.inf
        most = max(round(_LONGEST / usual), 1) if usual else 1
        workers = max(len(self._client.nthreads()), 2)  # none while all are being replaced
        firsts = [0]
        while (left := len(unrepaired) - firsts[-1]) > 1:
            firsts.append(firsts[-1] + min(math.ceil(left / workers), most))
        parts = np.split(unrepaired, firsts[1:])
        nothing = [None] * len(parts)
        drawn = nothing if solutions is None else np.split(solutions, firsts[1:])
        bits = np.asarray(jax.random.key_data(key))
        return [
            self.executor.submit(_evaluate_layouts, self._settings, part, first, bits, own)
            for part, first, own in zip(parts, firsts, drawn, strict=True)
        ]

    def _note(self, task: Task) -> None:
        """Count a completed task, and learn how long a layout takes."""
        size = len(task.arguments[1])
        self._seconds.append(task.seconds / size)
        self._progress(size)


@lru_cache(maxsize=2)
def _chain(settings: str) -> tuple[Pipeline, Callable]:
    """Build a run's chain once per worker: (pipeline, compiled simulator)."""
    config = config_from_json(json.loads(settings), Path("the search"))
    pipeline = make_pipeline(config.evaluation, repair_seed=config.seed)
    return pipeline, jax.jit(pipeline.simulate)


def _evaluate_layouts(
    settings: str, layouts: np.ndarray, first: int, key: np.ndarray, solutions: Any
) -> Outcomes:
    """Repair and simulate layouts (int8 [n, H, W]), one by one; what a worker does.

    `settings` is a whole `RunConfig` as JSON, `first` the index of the first layout in its
    population, `key` (uint32) the data of the population's key, `solutions` float32 [n, P] where
    the pipeline is guided.
    """
    pipeline, simulate = _chain(settings)
    whole = jax.random.wrap_key_data(jax.numpy.asarray(key))
    parts = []
    for index, layout in enumerate(layouts, first):
        repair = _repair(pipeline, layout).result()
        repaired = np.asarray(repair.layout)[None]
        own = None if solutions is None else solutions[index - first][None]
        runs: Any = simulate(repaired, np.array([index], np.int32), whole, own)
        status = np.array([repair.status], np.int32)
        parts.append((repaired, status, jax.tree.map(np.asarray, runs)))
    return joined(parts)


@contextlib.contextmanager
def open_evaluator(
    execution: Execution, config: RunConfig, pipeline: Pipeline, progress: Callable[[int], None]
) -> Iterator[LayoutEvaluator]:
    """Yield what repairs and simulates the layouts of a run; a cluster's ends with the context.

    `progress` is called with the number of layouts that were completed. Raises InputError if
    nothing answers at the scheduler's address, or no worker joins.
    """
    if execution.executor == "threads":
        yield Threads(pipeline, progress)
        return
    with execution.connect() as client:
        cluster = Cluster(client, config, progress)
        try:
            yield cluster
        finally:
            cluster.executor.shutdown(cancel_futures=True)


class Search(NamedTuple):
    """A search between two iterations; one pytree, which checkpoints hold."""

    state: Any  # of the algorithm
    # float [B, P] each, the populations in flight, the oldest first: `Algorithm.ahead` of them
    in_flight: tuple[Array, ...]

    @classmethod
    def begin(cls, algorithm: Algorithm, key: jax.Array) -> Self:
        """Start a search with as many populations in flight as `algorithm.ahead` states."""
        state, in_flight = algorithm.init(key), []
        for _ in range(algorithm.ahead):
            solutions, state = algorithm.ask(state)
            in_flight.append(solutions)
        return cls(state, tuple(in_flight))


class AsyncEvaluation:
    """The populations of a run that are in flight.

    Population i comes from the search that has seen the results of all up to i - 1 - ahead, however
    fast the others were evaluated: the results do not depend on the speed of workers.
    """

    def __init__(
        self,
        algorithm: Algorithm,
        evaluator: PipelinedEvaluator,
        key: jax.Array,
        total: int,
        done: int,
        search: Search,
    ) -> None:
        """Submit the populations that the search already holds.

        Iteration ``i`` is evaluated with ``fold_in(key, i)``, so a resumed run draws the same.
        `total` is the number of iterations of the run: later populations are drawn but not
        evaluated. `done` is the number of those that `search` has seen.
        """
        self.done, self.search = done, search
        self._algorithm, self._evaluator, self._key, self._total = algorithm, evaluator, key, total
        self._in_flight: deque[Array] = deque()
        self._evaluations: deque[Callable[[], Evaluation]] = deque()
        # One population further than `search`, between `submit` and `collect`.
        self._state = search.state
        for solutions in search.in_flight:
            self._begin(solutions)

    def submit(self) -> None:
        """Draw one more population and begin to evaluate it."""
        solutions, self._state = jax.block_until_ready(self._algorithm.ask(self._state))
        self._begin(solutions)

    def wait(self) -> Evaluation:
        """Wait for the evaluation of the oldest population."""
        return self._evaluations[0]()

    def collect(self, evaluation: Evaluation) -> None:
        """Give the search the evaluation of the oldest population, which `wait` returned."""
        solutions = self._in_flight.popleft()
        self._evaluations.popleft()
        scores = evaluation.score, observed(evaluation)
        self._state = self._algorithm.tell(self._state, solutions, *scores)
        self.search = Search(self._state, tuple(self._in_flight))
        self.done += 1

    def _begin(self, solutions: Array) -> None:
        # Iterations count from 1. Populations beyond the total are drawn, as the state of the
        # search would differ otherwise, but their results would never be collected.
        number = self.done + len(self._in_flight) + 1
        self._in_flight.append(solutions)
        if number <= self._total:
            key = jax.random.fold_in(self._key, number)
            self._evaluations.append(self._evaluator.begin(solutions, key))
