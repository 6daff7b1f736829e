"""Threads of this process that repair and simulate."""

import contextlib
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor

import jax
import numpy as np

from qdenv import devices
from qdenv.mesh import turn
from qdenv.pipeline import Outcomes, Pipeline, devices_for, joined, unrepaired_as_is
from qdenv.types import Array


class Threads:
    """Repair and simulate in threads of this process.

    Chunks of layouts are simulated (a compiled call releases the GIL) as soon as their repairs
    are ready: on a CPU one layout per chunk and one thread per core, on an accelerator one thread
    that feeds larger chunks, for all of them where there are several.
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
            chunk: most layouts that are simulated per call.
            progress: told how many layouts more are done; by any thread.
        """
        self._pipeline, self._progress = pipeline, progress
        sharing = devices_for(pipeline.domain.simulator)
        self._chunk = chunk or sharing * devices.lanes(devices.ACCELERATOR_CHUNK)
        self._simulate = jax.jit(pipeline.simulate)
        self._turn = turn if sharing > 1 else contextlib.nullcontext()
        self._threads = ThreadPoolExecutor(devices.threads())

    def __call__(self, unrepaired: np.ndarray, key: Array) -> Callable[[], Outcomes]:
        """Begin to repair and simulate int8 [B, H, W]; what it returns waits for them."""
        size = chunk_size(len(unrepaired), self._chunk)
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
        with self._turn:
            runs = jax.tree.map(np.asarray, self._simulate(layouts, chunk, key))
        self._progress(len(chunk))
        return Outcomes(layouts, status, runs)


def chunk_size(size: int, most: int) -> int:
    """Find the greatest divisor of `size` up to `most`: equal chunks compile once."""
    return max(part for part in range(1, min(size, most) + 1) if size % part == 0)
