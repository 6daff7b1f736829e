"""Threads of this process that repair and simulate."""

import math
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor

import jax
import numpy as np

from qdenv import devices
from qdenv.pipeline import Outcomes, Pipeline, joined, unrepaired_as_is
from qdenv.types import Array


class Threads:
    """Repair and simulate in threads of this process.

    Chunks of layouts are simulated (a compiled call releases the GIL) as soon as their repairs
    are ready: on a CPU one layout per chunk and one thread per core, on an accelerator one thread
    that feeds larger chunks.
    """

    def __init__(
        self,
        pipeline: Pipeline,
        chunk: int | None = None,
        progress: Callable[[int], None] = lambda layouts: None,
    ) -> None:
        """Compile nothing yet.

        Args:
            pipeline: the chain.
            chunk: layouts, or a divisor of it, that are simulated per call.
            progress: told how many layouts more are done; by any thread.
        """
        self._pipeline, self._progress = pipeline, progress
        self._chunk = chunk or devices.lanes(devices.ACCELERATOR_CHUNK)
        self._simulate = jax.jit(pipeline.simulate)
        self._threads = ThreadPoolExecutor(devices.threads())

    def __call__(self, unrepaired: np.ndarray, key: Array) -> Callable[[], Outcomes]:
        """Begin to repair and simulate int8 [B, H, W]; what it returns waits for them."""
        size = math.gcd(len(unrepaired), self._chunk)  # equal chunks compile once
        chunks = np.arange(len(unrepaired), dtype=np.int32).reshape(-1, size)
        repairs = [[self._submit(unrepaired[index]) for index in chunk] for chunk in chunks]
        pending = [
            self._threads.submit(self._finish, chunk, repair, key)
            for chunk, repair in zip(chunks, repairs, strict=True)
        ]
        return lambda: joined([future.result() for future in pending])

    def _submit(self, layout: np.ndarray) -> Future:
        if self._pipeline.pool is not None:
            return self._pipeline.pool.submit(layout, self._pipeline.repair_seed)
        untouched: Future = Future()
        untouched.set_result(unrepaired_as_is(layout))
        return untouched

    def _finish(self, chunk: np.ndarray, repairs: list[Future], key: Array) -> Outcomes:
        done = [future.result() for future in repairs]
        layouts = np.stack([repair.layout for repair in done])
        status = np.array([repair.status for repair in done], np.int32)
        runs = jax.tree.map(np.asarray, self._simulate(layouts, chunk, key))
        self._progress(len(chunk))
        return Outcomes(layouts, status, runs)
