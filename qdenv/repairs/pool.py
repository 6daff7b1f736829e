"""Batches of repairs: a pool of threads and a memo by content.

Threads suffice: the annealer and HiGHS both work outside the interpreter lock. Nothing forks.
"""

import logging
import threading
from collections import OrderedDict
from concurrent.futures import CancelledError, Future, ThreadPoolExecutor
from contextlib import ExitStack
from typing import Any

import jax
import numpy as np

from qdenv import devices
from qdenv.repairs.recipe import hash_content, repair_layout
from qdenv.repairs.settings import RepairConfig
from qdenv.types import Array, Repair, RepairStatus, Rules

_LOG = logging.getLogger(__name__)
_WAITING_PER_WORKER = 64  # layouts that may queue before `submit` waits
_REMEMBERED = 4096  # the last repairs


class RepairPool(ExitStack):
    """Repair layouts of one canvas on all cores; equal layouts are repaired once.

    A context manager: its end, or `close`, cancels what waits and lets what runs finish. Results
    depend on the layout, the seed and the configuration only: not on batch size, order, number of
    workers or what was repaired before.
    """

    def __init__(self, rules: Rules, config: RepairConfig | None = None):
        """Start the threads."""
        super().__init__()
        self.rules, self.config = rules, config or RepairConfig()
        self.workers = self.config.workers or devices.count_cores()
        self._threads = ThreadPoolExecutor(self.workers, thread_name_prefix="repair")
        self.callback(self._threads.shutdown, cancel_futures=True)
        self._slots = threading.BoundedSemaphore(_WAITING_PER_WORKER * self.workers)
        self._lock, self._alone = threading.Lock(), threading.Lock()
        self._memo: OrderedDict[bytes, Future[Repair]] = OrderedDict()

    def submit(self, layout: np.ndarray, seed: int = 0) -> "Future[Repair]":
        """Queue one layout (int8 [H, W]); waits while the queue is full.

        A worker that fails answers with status `FAILED` and the layout as it came, and that answer
        is not remembered. A remembered repair has cost 0 seconds. `cancel` on the future takes back
        what has not begun.
        """
        layout = np.array(layout, np.int8)
        key = hash_content(layout, seed, 16)
        self._slots.acquire()
        with self._lock:
            known = self._memo.get(key)
            if known is not None and not known.cancelled():
                self._memo.move_to_end(key)
                self._slots.release()
                return _share(known)
            future = self._threads.submit(self._work, key, layout, int(seed))
            self._memo[key] = future
            while len(self._memo) > _REMEMBERED:
                self._memo.popitem(last=False)
        future.add_done_callback(lambda done: self._slots.release())
        return future

    def _work(self, key: bytes, layout: np.ndarray, seed: int) -> Repair:
        """Repair one layout; whatever happens, answer with a record."""
        try:
            try:
                return repair_layout(layout, self.rules, seed, self.config)
            except MemoryError:
                _LOG.warning("a repair ran out of memory: it is tried again by itself")
            with self._alone:  # one retry at a time: the others may have taken the memory
                return repair_layout(layout, self.rules, seed, self.config)
        except Exception:
            _LOG.exception("a repair failed; its layout counts as not repairable")
            with self._lock:
                self._memo.pop(key, None)
            failed, nothing = np.int32(RepairStatus.FAILED), np.float32(0)
            return Repair(layout, failed, np.float32(np.inf), nothing, nothing)

    def repair(self, layouts: np.ndarray, seed: int = 0) -> Repair:
        """Repair a batch (int8 [B, H, W]) and wait for it; every field gets a leading axis B."""
        waiting = [self.submit(layout, seed) for layout in np.asarray(layouts)]
        records = [future.result() for future in waiting]
        return Repair(*(np.stack(field) for field in zip(*records, strict=True)))


def _share(known: "Future[Repair]") -> "Future[Repair]":
    """Follow a repair that another future pays for: cancelling the copy leaves that one alone."""
    mine: Future[Repair] = Future()

    def copy_result(done: Future[Repair]) -> None:
        if not mine.set_running_or_notify_cancel():
            return
        if done.cancelled():
            mine.set_exception(CancelledError())
        else:
            mine.set_result(done.result()._replace(seconds=np.float32(0)))

    known.add_done_callback(copy_result)
    return mine


def repair_in_jit(pool: RepairPool, layouts: Array, seed: Array | int) -> Repair:
    """Repair a batch (int8 [B, H, W]) from inside jit or scan; see `RepairPool.repair`."""
    batch = layouts.shape[:1]
    shapes = layouts.shape, batch, batch, batch, batch
    dtypes = np.int8, np.int32, np.float32, np.float32, np.float32
    fields: Any = map(jax.ShapeDtypeStruct, shapes, dtypes)
    return jax.pure_callback(
        # Only numpy here: a jax call inside a callback can wait for the very device it blocks.
        lambda layouts, seed: pool.repair(np.asarray(layouts), int(np.asarray(seed))),
        Repair(*fields),
        layouts,
        seed,
        vmap_method="sequential",
    )
