"""Batches of repairs: a pool of threads, a memo by content, and the host callback for jit.

Threads suffice: the annealer and HiGHS both work outside the interpreter lock. Nothing forks.
"""

import hashlib
import os
import threading
from concurrent.futures import Future, ThreadPoolExecutor

import jax
import numpy as np

from qdenv.repair.solver import RepairConfig, repair
from qdenv.types import Array, Repair, RepairStatus, Rules


class RepairPool:
    """Repair layouts of one canvas on all cores; equal layouts are repaired once.

    Use it as a context manager, or call `close`.
    """

    def __init__(self, rules: Rules, config: RepairConfig | None = None, remember: int = 4096):
        """Start the threads.

        Args:
            rules: the constraints of the canvas.
            config: limits and number of workers.
            remember: how many finished repairs to keep.
        """
        self.rules, self.config = rules, config or RepairConfig()
        self.workers = self.config.workers or len(os.sched_getaffinity(0))
        self._threads = ThreadPoolExecutor(self.workers, thread_name_prefix="repair")
        self._slots = threading.BoundedSemaphore(64 * self.workers)
        self._lock = threading.Lock()
        self._memo: dict[bytes, Future] = {}
        self._remember = remember

    def submit(self, layout: np.ndarray, seed: int = 0) -> "Future[Repair]":
        """Queue one layout (int8 [H, W]); waits while the queue is full.

        A worker that fails gives status `FAILED` and the layout as it came, and is not remembered.
        """
        layout = np.array(layout, np.int8)
        digest = hashlib.blake2b(layout.tobytes(), digest_size=16)
        digest.update(repr((layout.shape, int(seed))).encode())
        key = digest.digest()
        with self._lock:
            known = self._memo.get(key)
            if known is not None and not known.cancelled():
                return known
        self._slots.acquire()
        future = self._threads.submit(self._work, layout, int(seed))
        future.add_done_callback(lambda done: self._finish(key, done))
        with self._lock:
            self._memo[key] = future
        return future

    def _work(self, layout: np.ndarray, seed: int) -> Repair:
        """Repair one layout; whatever happens, answer with a record."""
        try:
            return repair(layout, self.rules, seed, self.config)
        except Exception:
            inf = np.float32(np.inf)
            return Repair(layout, np.int32(RepairStatus.FAILED), inf, np.float32(0), np.float32(0))

    def _finish(self, key: bytes, done: Future) -> None:
        """Free the slot and keep the memo within its size."""
        self._slots.release()

    def repair(self, layouts: np.ndarray, seed: int = 0) -> Repair:
        """Repair a batch (int8 [B, H, W]) and wait for it; every field gets a leading axis B."""
        waiting = [self.submit(layout, seed) for layout in np.asarray(layouts)]
        records = [future.result() for future in waiting]
        return Repair(*(np.stack(field) for field in zip(*records, strict=True)))

    def close(self) -> None:
        """Cancel what waits and stop the threads."""
        self._threads.shutdown(wait=True, cancel_futures=True)

    def __enter__(self) -> "RepairPool":
        """Return the pool itself."""
        return self

    def __exit__(self, *exception: object) -> None:
        """Close the pool."""
        self.close()


def repair_in_jit(pool: RepairPool, layouts: Array, seed: Array) -> Repair:
    """Repair a batch from inside jit or scan: one host callback for the whole population.

    Args:
        pool: where to repair.
        layouts: int8 [B, H, W].
        seed: int32 or uint32 scalar, the base seed.
    """
    batch = layouts.shape[:1]

    def on_host(layouts: Array, seed: Array) -> Repair:
        # Only numpy here: a jax call inside a callback can wait for the very device it blocks.
        return pool.repair(np.asarray(layouts), int(np.asarray(seed)))

    shapes = Repair(
        layout=jax.ShapeDtypeStruct(layouts.shape, np.int8),
        status=jax.ShapeDtypeStruct(batch, np.int32),
        hamming=jax.ShapeDtypeStruct(batch, np.float32),
        lower_bound=jax.ShapeDtypeStruct(batch, np.float32),
        seconds=jax.ShapeDtypeStruct(batch, np.float32),
    )
    return jax.pure_callback(on_host, shapes, layouts, seed, vmap_method="sequential")
