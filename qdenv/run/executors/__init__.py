"""Where the layouts of a search are repaired and simulated: in this process, or on a cluster."""

from __future__ import annotations

import contextlib
import logging
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

from qdenv import devices
from qdenv.ranges import PositiveInt, Ranged
from qdenv.types import InputError

if TYPE_CHECKING:
    from distributed import Client

    from qdenv.pipeline import LayoutEvaluator, Pipeline
    from qdenv.run.config import RunConfig

ExecutorName = Literal["threads", "dask"]
_ANSWER = 20  # seconds that a scheduler may take to answer
_ARRIVAL = 120  # seconds that the first worker may take to join


@dataclass(frozen=True)
class Execution(Ranged):
    """Where layouts are repaired and simulated; decides how long a run takes, not what it finds."""

    executor: ExecutorName = "threads"  # threads of this process, or a Dask cluster
    # address of the cluster's scheduler; a cluster on this machine unless given
    scheduler: str | None = None
    # threads that repair, or processes of a cluster on this machine; one per core unless given
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
        try:
            import distributed  # noqa: F401
        except ImportError as error:
            raise InputError("--executor dask needs dask: pip install 'qdenv[dask]'") from error

    @contextlib.contextmanager
    def open(
        self, config: RunConfig, pipeline: Pipeline, progress: Callable[[int], None]
    ) -> Iterator[LayoutEvaluator]:
        """Yield what repairs and simulates the layouts of a run; it ends with the context.

        `progress` is called with the number of layouts that were completed. Raises InputError if
        nothing answers at the scheduler's address, or no worker joins.
        """
        from qdenv.run.executors.layouts import Cluster, Threads  # imports both compilers

        if self.executor == "threads":
            yield Threads(pipeline, progress=progress)
            return
        with self.connect() as client:
            cluster = Cluster(client, config, progress)
            try:
                yield cluster
            finally:
                cluster.executor.shutdown(cancel_futures=True)

    @contextlib.contextmanager
    def connect(self) -> Iterator[Client]:
        """Connect to a cluster that has a worker; one on this machine ends with the context."""
        import dask
        from distributed import Client, LocalCluster

        with contextlib.ExitStack() as stack:
            # Workers would sample a hundred times a second what they do, for a dashboard that
            # nobody sees.
            stack.enter_context(dask.config.set({"distributed.worker.profile.enabled": False}))
            place = self.scheduler
            if place is None:
                local = LocalCluster(
                    n_workers=self.workers or devices.count_cores(),
                    threads_per_worker=1,
                    memory_limit=0,  # a worker is not ended for what a layout needs
                    dashboard_address=None,
                    silence_logs=logging.CRITICAL,
                )
                place = stack.enter_context(local).scheduler_address
            try:
                client = stack.enter_context(Client(place, timeout=_ANSWER))
                client.wait_for_workers(1, timeout=_ARRIVAL)
            except (OSError, ValueError, TimeoutError) as error:
                hint = f"start `dask scheduler` and `dask worker {place}` first"
                raise InputError(f"{place}: no worker answers ({error}): {hint}") from error
            yield client
