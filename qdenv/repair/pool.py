"""Batches of repairs: a pool of threads and a memo by content.

Threads suffice: the annealer and HiGHS both work outside the interpreter lock. Nothing forks.
"""

import hashlib
import logging
import threading
from collections import OrderedDict
from concurrent.futures import CancelledError, Future, ThreadPoolExecutor
from typing import Any

import jax
import numpy as np

from qdenv import devices
from qdenv.repair.recipe import repair_layout
from qdenv.repair.rules import Result
from qdenv.repair.settings import RepairConfig
from qdenv.types import Array, Repair, RepairStatus, Rules

_LOG = logging.getLogger(__name__)
_WAITING_PER_WORKER = 64  # layouts that may queue before `submit` waits


class RepairPool:
    """Repair layouts of one canvas on all cores; equal layouts are repaired once.

    Use it as a context manager, or call `close`. Results depend on the layout, the seed and the
    configuration only: not on batch size, order, number of workers or what was repaired before.
    """

    def __init__(self, rules: Rules, config: RepairConfig | None = None, remember: int = 4096):
        """Start the threads.

        Args:
            rules: the constraints of the canvas.
            config: limits and number of workers.
            remember: how many repairs to keep.
        """
        self.rules, self.config = rules, config or RepairConfig()
        self.workers = self.config.workers or devices.count_cores()
        self._threads = ThreadPoolExecutor(self.workers, thread_name_prefix="repair")
        self._slots = threading.BoundedSemaphore(_WAITING_PER_WORKER * self.workers)
        self._lock, self._alone = threading.Lock(), threading.Lock()
        self._memo: OrderedDict[bytes, Future[Repair]] = OrderedDict()
        self._remember = remember

    def submit(self, layout: np.ndarray, seed: int = 0) -> "Future[Repair]":
        """Queue one layout (int8 [H, W]); waits while the queue is full.

        A worker that fails answers with status `FAILED` and the layout as it came, and that answer
        is not remembered. A remembered repair has cost 0 seconds. `cancel` on the future takes back
        what has not begun.
        """
        layout = np.array(layout, np.int8)
        key = _content_key(layout, seed)
        self._slots.acquire()
        with self._lock:
            known = self._memo.get(key)
            if known is not None and not known.cancelled():
                self._memo.move_to_end(key)
                self._slots.release()
                return _for_free(known)
            future = self._threads.submit(self._work, key, layout, int(seed))
            self._memo[key] = future
            while len(self._memo) > self._remember:
                self._memo.popitem(last=False)
        future.add_done_callback(lambda done: self._slots.release())
        return future

    def _work(self, key: bytes, layout: np.ndarray, seed: int) -> Repair:
        """Repair one layout; whatever happens, answer with a record."""
        try:
            return self._repair(layout, seed)
        except Exception:
            _LOG.exception("a repair failed; its layout counts as not repairable")
            with self._lock:
                self._memo.pop(key, None)
            return Result(layout, np.inf, 0.0, RepairStatus.FAILED).record(0.0)

    def _repair(self, layout: np.ndarray, seed: int) -> Repair:
        """Repair one layout; where memory is short, once more when no other retries."""
        try:
            return repair_layout(layout, self.rules, seed, self.config)
        except MemoryError:
            _LOG.warning("a repair ran out of memory: it is tried again by itself")
        with self._alone:
            return repair_layout(layout, self.rules, seed, self.config)

    def repair(self, layouts: np.ndarray, seed: int = 0) -> Repair:
        """Repair a batch (int8 [B, H, W]) and wait for it; every field gets a leading axis B."""
        waiting = [self.submit(layout, seed) for layout in np.asarray(layouts)]
        records = [future.result() for future in waiting]
        return Repair(*(np.stack(field) for field in zip(*records, strict=True)))

    def close(self) -> None:
        """Cancel what waits, let what runs finish, stop the threads."""
        self._threads.shutdown(wait=True, cancel_futures=True)

    def __enter__(self) -> "RepairPool":
        """Return the pool itself."""
        return self

    def __exit__(self, *exception: object) -> None:
        """Close the pool."""
        self.close()


def _content_key(layout: np.ndarray, seed: int) -> bytes:
    """Name a repair by what decides it: the layout's content and shape, and the seed."""
    digest = hashlib.blake2b(layout.tobytes(), digest_size=16)
    digest.update(repr((layout.shape, int(seed))).encode())
    return digest.digest()


def _for_free(known: "Future[Repair]") -> "Future[Repair]":
    """Follow a repair that someone else pays for."""
    mine: Future[Repair] = Future()

    def hand_on(done: Future[Repair]) -> None:
        if not mine.set_running_or_notify_cancel():
            return
        if done.cancelled():
            mine.set_exception(CancelledError())
        else:
            nothing: Any = np.float32(0)
            mine.set_result(done.result()._replace(seconds=nothing))

    known.add_done_callback(hand_on)
    return mine


def repair_in_jit(pool: RepairPool, layouts: Array, seed: Array | int) -> Repair:
    """Repair a batch from inside jit or scan.

    Args:
        pool: where to repair.
        layouts: int8 [B, H, W].
        seed: int32 or uint32 scalar, the base seed.

    Returns:
        A `Repair` whose fields have a leading axis B.
    """
    batch = layouts.shape[:1]

    def on_host(layouts: Array, seed: Array) -> Repair:
        # Only numpy here: a jax call inside a callback can wait for the very device it blocks.
        return pool.repair(np.asarray(layouts), int(np.asarray(seed)))

    shapes: dict[str, Any] = {
        "layout": jax.ShapeDtypeStruct(layouts.shape, np.int8),
        "status": jax.ShapeDtypeStruct(batch, np.int32),
        "cost": jax.ShapeDtypeStruct(batch, np.float32),
        "lower_bound": jax.ShapeDtypeStruct(batch, np.float32),
        "seconds": jax.ShapeDtypeStruct(batch, np.float32),
    }
    promised = Repair(**shapes)
    repaired: Repair = jax.pure_callback(on_host, promised, layouts, seed, vmap_method="sequential")
    return repaired
