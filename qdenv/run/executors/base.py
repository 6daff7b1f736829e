"""Where the layouts of a search are evaluated: a small record, and how it becomes an executor."""

from __future__ import annotations

import contextlib
import logging
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

from qdenv.ranges import PositiveInt, Ranged
from qdenv.types import InputError

if TYPE_CHECKING:
    from distributed import Client

    from qdenv.pipeline import Executor, Pipeline
    from qdenv.run.config import RunConfig

ExecutorName = Literal["threads", "dask"]
ANSWER = 20  # seconds that a scheduler may take to answer
ARRIVAL = 120  # seconds that the first worker may take to come


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
def opened(
    execution: Execution, config: RunConfig, pipeline: Pipeline, progress: Callable[[int], None]
) -> Iterator[Executor]:
    """Make the executor and what it needs; both end with the context.

    Args:
        execution: which one.
        config: of the run.
        pipeline: its chain.
        progress: told how many layouts more are done.

    Raises:
        InputError: nobody answers at the scheduler's address, or no worker comes.
    """
    from qdenv.run.executors.local import Threads

    if execution.executor == "threads":
        yield Threads(pipeline, progress=progress)
        return
    from qdenv.run.executors.dask import Cluster

    with connected(execution) as client:
        yield Cluster(client, config, pipeline, progress)


@contextlib.contextmanager
def connected(execution: Execution) -> Iterator[Client]:
    """Connect to a cluster that has a worker; one on this machine ends with the context.

    Raises:
        InputError: nobody answers at the scheduler's address, or no worker comes.
    """
    import dask
    from distributed import Client, LocalCluster

    from qdenv.repair.pool import count_cores

    with contextlib.ExitStack() as stack:
        # Workers look a hundred times a second what they are doing, for a dashboard nobody sees.
        stack.enter_context(dask.config.set({"distributed.worker.profile.enabled": False}))
        place = execution.scheduler
        if place is None:
            local = LocalCluster(
                n_workers=execution.workers or count_cores(),
                threads_per_worker=1,
                memory_limit=0,  # a worker is not ended for what a layout needs
                dashboard_address=None,
                silence_logs=logging.CRITICAL,
            )
            place = stack.enter_context(local).scheduler_address
        try:
            client = stack.enter_context(Client(place, timeout=ANSWER))
            client.wait_for_workers(1, timeout=ARRIVAL)
        except (OSError, ValueError, TimeoutError) as error:
            hint = f"start `dask scheduler` and `dask worker {place}` first"
            raise InputError(f"{place}: no worker answers ({error}): {hint}") from error
        yield client
