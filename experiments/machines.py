"""Who makes experiments: this process, or a Dask cluster to which independent runs are handed."""

import contextlib
from collections.abc import Iterator
from typing import NamedTuple

from qdenv.run.executors import Execution
from qdenv.study.ledger import SimulateAll, handed_to, one_by_one


class Machines(NamedTuple):
    """Who searches and simulates."""

    execution: Execution  # where a search evaluates its layouts
    simulate_all: SimulateAll  # simulates cases, each from its seed


HERE = Machines(Execution(), one_by_one)


@contextlib.contextmanager
def at_work(execution: Execution) -> Iterator[Machines]:
    """Connect to those who work; a cluster on this machine ends with the context.

    Raises:
        InputError: nobody answers at the scheduler's address, or no worker comes.
    """
    if execution.executor == "threads":
        yield HERE._replace(execution=execution)
        return
    with execution.connect() as client:
        address = client.scheduler_info()["address"]
        yield Machines(Execution("dask", scheduler=address), handed_to(client))
