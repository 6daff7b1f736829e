"""Repair and simulate the layouts of a population: in threads of this process, or on a cluster."""

from __future__ import annotations

import contextlib
import json
import math
import statistics
from collections import deque
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

import jax
import numpy as np

from qdenv import devices
from qdenv.mesh import turn
from qdenv.pipeline import Outcomes, Pipeline, joined, make_pipeline
from qdenv.run.config import RunConfig, config_from_json, config_to_json
from qdenv.run.executors.dask import REMEMBERED, ClusterExecutor, Task
from qdenv.types import Array, Repair, RepairStatus

if TYPE_CHECKING:
    from distributed import Client

_LONGEST = 1.0  # seconds of a task of several layouts: the scheduler spends milliseconds on each


class Threads:
    """Repair and simulate in threads of this process.

    Chunks of layouts are simulated (a compiled call releases the GIL) as soon as their repairs
    are ready: on a CPU one layout per chunk and one thread per core, on an accelerator one thread
    that feeds larger chunks, for all of them where there are several. `progress` is called with
    the number of layouts that were completed, by any thread.
    """

    def __init__(
        self,
        pipeline: Pipeline,
        chunk: int | None = None,
        progress: Callable[[int], None] = lambda layouts: None,
    ) -> None:
        """Compile nothing yet; `chunk` is the number of layouts that one call simulates at most."""
        self._pipeline, self._progress = pipeline, progress
        sharing = pipeline.domain.simulator.num_devices
        self._chunk = chunk or sharing * devices.lanes(devices.ACCELERATOR_CHUNK)
        self._simulate = jax.jit(pipeline.simulate)
        # Devices that share one call must get their calls in one order, or they wait for ever.
        self._turn = turn if sharing > 1 else contextlib.nullcontext()
        self._threads = ThreadPoolExecutor(devices.threads())

    def __call__(self, unrepaired: np.ndarray, key: Array) -> list[Future[Outcomes]]:
        """Begin to repair and simulate int8 [B, H, W]; return the parts of the population."""
        count = len(unrepaired)
        chunks = np.arange(count, dtype=np.int32).reshape(-1, chunk_size(count, self._chunk))
        # All repairs are submitted first, so that none waits for a simulation.
        repairs = [[_repair(self._pipeline, unrepaired[one]) for one in chunk] for chunk in chunks]
        return [
            self._threads.submit(self._finish, chunk, repair, key)
            for chunk, repair in zip(chunks, repairs, strict=True)
        ]

    def _finish(self, chunk: np.ndarray, repairs: list[Future[Repair]], key: Array) -> Outcomes:
        """Simulate the layouts of a chunk when they are repaired."""
        done = [future.result() for future in repairs]
        layouts = np.stack([repair.layout for repair in done])
        status = np.array([repair.status for repair in done], np.int32)
        with self._turn:
            runs = jax.tree.map(np.asarray, self._simulate(layouts, chunk, key))
        self._progress(len(chunk))
        return Outcomes(layouts, status, runs)


def _repair(pipeline: Pipeline, layout: np.ndarray) -> Future[Repair]:
    """Begin to repair a layout, where its domain has rules."""
    if pipeline.pool is not None:
        return pipeline.pool.submit(layout, pipeline.repair_seed)
    untouched: Future[Repair] = Future()
    status, nothing = np.int32(RepairStatus.OPTIMAL), np.float32(0)
    untouched.set_result(Repair(layout, status, nothing, nothing, nothing))
    return untouched


def chunk_size(size: int, most: int) -> int:
    """Return the greatest divisor of `size` up to `most`: equal chunks compile once."""
    return max(part for part in range(1, min(size, most) + 1) if size % part == 0)


class Cluster:
    """Repair and simulate the layouts of a search on the workers of a cluster.

    A task is one layout, or a few that take no time. The results depend on the layout, its index
    in the population and the key alone, not on the worker. `progress` is called with the number of
    layouts that were completed.
    """

    def __init__(
        self,
        client: Client,
        config: RunConfig,
        progress: Callable[[int], None] = lambda layouts: None,
    ) -> None:
        """Send nothing yet."""
        self.executor = ClusterExecutor(client, self._note)
        self._progress = progress
        self._seconds: deque[float] = deque(maxlen=REMEMBERED)  # of recent layouts
        evaluation = config.evaluation
        alone = replace(evaluation, repair=replace(evaluation.repair, workers=1))
        self._settings = json.dumps(config_to_json(replace(config, evaluation=alone)))

    def __call__(self, unrepaired: np.ndarray, key: Array) -> list[Task]:
        """Begin to repair and simulate int8 [B, H, W]; return the parts of the population.

        Tasks get ever smaller, so that all workers end together: guided self-scheduling
        (Polychronopoulos and Kuck 1987). Each is what is left, divided by the workers, but no
        longer than `_LONGEST`; while the duration of a layout is unknown, each is a task.
        """
        usual = statistics.median(self._seconds) if self._seconds else math.inf
        most = max(round(_LONGEST / usual), 1) if usual else 1
        workers = max(self.executor.workers, 2)
        firsts = [0]
        while (left := len(unrepaired) - firsts[-1]) > 1:
            firsts.append(firsts[-1] + min(math.ceil(left / workers), most))
        parts = zip(np.split(unrepaired, firsts[1:]), firsts, strict=True)
        bits = np.asarray(jax.random.key_data(key))
        submit, settings = self.executor.submit, self._settings
        return [submit(_evaluate_layouts, settings, *part, bits) for part in parts]

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


def _evaluate_layouts(settings: str, layouts: np.ndarray, first: int, key: np.ndarray) -> Outcomes:
    """Repair and simulate layouts (int8 [n, H, W]), one by one; what a worker does.

    `settings` is a whole `RunConfig` as JSON, `first` the index of the first layout in its
    population, `key` (uint32) the data of the population's key.
    """
    pipeline, simulate = _chain(settings)
    whole = jax.random.wrap_key_data(jax.numpy.asarray(key))
    parts = []
    for index, layout in enumerate(layouts, first):
        repair = _repair(pipeline, layout).result()
        repaired = np.asarray(repair.layout)[None]
        runs: Any = simulate(repaired, np.array([index], np.int32), whole)
        status = np.array([repair.status], np.int32)
        parts.append(Outcomes(repaired, status, jax.tree.map(np.asarray, runs)))
    return joined(parts)
