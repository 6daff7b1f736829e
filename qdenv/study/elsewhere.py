"""Simulations on a Dask cluster: independent runs, each a task of its own."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Any

from qdenv.domains.base import make_domain
from qdenv.run.executors.dask import check_versions, versions
from qdenv.study.ledger import Case, Run, SimulateAll, simulate

if TYPE_CHECKING:
    from distributed import Client

PORTION = 4  # runs of each worker from one answer to the next


def handed_to(client: Client) -> SimulateAll:
    """Let the workers of a cluster simulate what `ledger.complete` asks for.

    Args:
        client: of a cluster with a worker at least.
    """

    def simulate_all(todo: Sequence[tuple[Case, int]]) -> Iterator[Run]:
        from qdenv.run.executors.dask import Workers

        workers, wanted = Workers(client, simulate_elsewhere), versions()
        portion = PORTION * len(client.scheduler_info()["workers"])
        # Functions do not travel, settings do.
        tasks = [(case._replace(domain=case.domain.config), seed, wanted) for case, seed in todo]
        for first in range(0, len(tasks), portion):
            yield from workers.begin(tasks[first : first + portion]).finish()

    return simulate_all


def simulate_elsewhere(case: Any, seed: int, wanted: str) -> Run:
    """Simulate one run on a worker of a cluster.

    Args:
        case: a `Case` that holds the settings of its domain in place of the domain.
        seed: of the run.
        wanted: `versions` of who asks.

    Raises:
        WrongWorkerError: this worker has other versions.
    """
    check_versions(wanted)
    return simulate(case._replace(domain=make_domain(case.domain)), seed)
