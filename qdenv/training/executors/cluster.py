"""A Dask cluster that repairs and simulates: a task is one layout, no worker is trusted to live.

Killed workers, slow ones and those of other versions cost time; what is found depends on the
layout, its number and the key alone. https://distributed.dask.org
"""

from __future__ import annotations

import json
import logging
import time
from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import jax
import numpy as np

from qdenv.pipeline import Outcomes, Pipeline, joined
from qdenv.training.config import RunConfig, config_to_json
from qdenv.training.executors.task import WrongWorkerError, evaluate_layout, versions
from qdenv.types import Array, InputError

if TYPE_CHECKING:
    from distributed import Client, Future

LOG = logging.getLogger(__name__)
TRIES = 3  # of a layout whose evaluation raises an error
DEATHS = 10  # times that all workers may die on one layout before it is to blame
PATIENCE = 30.0  # seconds without any answer, or SLOW times the slowest one, until others are asked
SLOW = 5.0


class Cluster:
    """Repair and simulate the layouts of a search on the workers of a cluster."""

    def __init__(
        self,
        client: Client,
        config: RunConfig,
        pipeline: Pipeline,
        progress: Callable[[int], None] = lambda layouts: None,
    ) -> None:
        """Send nothing yet.

        Args:
            client: of the cluster.
            config: of the run.
            pipeline: its chain, to know the form of what comes back.
            progress: told how many layouts more are done.
        """
        self._client, self._progress = client, progress
        evaluation = config.evaluation
        alone = replace(evaluation, repair=replace(evaluation.repair, workers=1))
        self._settings = json.dumps(config_to_json(replace(config, evaluation=alone)))
        layouts = jax.ShapeDtypeStruct((1, *pipeline.domain.shape), np.int8)
        index, key = jax.ShapeDtypeStruct((1,), np.int32), jax.random.key(0)
        self._runs = jax.tree.structure(jax.eval_shape(pipeline.simulate, layouts, index, key))
        self._slowest = 0.0

    def __call__(self, unrepaired: np.ndarray, key: Array) -> Outcomes:
        """Repair and simulate int8 [B, H, W]."""
        batch = Batch(self, unrepaired, np.asarray(jax.random.key_data(key)))
        answers = batch.finish()
        parts = [
            Outcomes(
                layout[None], np.array([status], np.int32), jax.tree.unflatten(self._runs, leaves)
            )
            for layout, status, leaves in answers
        ]
        return joined(parts)

    def submit(self, layout: np.ndarray, number: int, key: np.ndarray) -> Future:
        """Send one layout to whoever is free."""
        given = self._settings, versions(), layout, number, key
        return self._client.submit(evaluate_layout, *given, pure=False)

    def answered(self, seconds: float) -> None:
        """Note that a layout is done, so long after it was sent."""
        self._slowest = max(self._slowest, seconds)
        self._progress(1)

    @property
    def patience(self) -> float:
        """Seconds without any answer after which others are asked, too."""
        return max(PATIENCE, SLOW * self._slowest)

    def dismiss(self) -> int:
        """Send away the workers of other versions; say how many there were."""
        said = self._client.run(versions, on_error="return")
        wrong = {address: one for address, one in said.items() if one != versions()}
        for address, one in wrong.items():
            LOG.warning(
                "worker %s is sent away, it has %s; the search has %s", address, one, versions()
            )
        if wrong:
            self._client.retire_workers(list(wrong))
        if wrong and len(wrong) == len(said):
            raise InputError(
                "every worker has other versions than the search: install the same qdenv and "
                f"packages there ({versions()})"
            )
        return len(wrong)

    def forget(self, futures: list[Future]) -> None:
        """Take back what nobody waits for any more."""
        self._client.cancel(futures, force=True)


class Batch:
    """The layouts of one population under way."""

    def __init__(self, cluster: Cluster, layouts: np.ndarray, key: np.ndarray) -> None:
        """Send all layouts."""
        self._cluster, self._layouts, self._key = cluster, layouts, key
        self._sent: dict[int, list[Future]] = {number: [] for number in range(len(layouts))}
        self._answers: dict[int, Any] = {}
        self._errors = dict.fromkeys(self._sent, 0)
        self._deaths = dict.fromkeys(self._sent, 0)
        for number in self._sent:
            self._send(number)
        self._began = self._heard = time.monotonic()

    def finish(self) -> list[Any]:
        """Wait for all answers and give them in order."""
        import distributed

        while self._sent:
            futures = [future for sent in self._sent.values() for future in sent]
            left = self._heard + self._cluster.patience - time.monotonic()
            try:
                distributed.wait(futures, max(left, 0.01), "FIRST_COMPLETED")
            except TimeoutError:
                self._ask_others()
                continue
            for number in list(self._sent):
                self._look(number)
        return [self._answers[number] for number in sorted(self._answers)]

    def _send(self, number: int) -> None:
        self._sent[number].append(self._cluster.submit(self._layouts[number], number, self._key))

    def _ask_others(self) -> None:
        """Send what is still out once more: its worker may hang. The first answer counts."""
        LOG.warning("%d layouts are overdue and sent to others, too", len(self._sent))
        for number in self._sent:
            self._send(number)
        self._heard = time.monotonic()

    def _look(self, number: int) -> None:
        """Take the answer of a layout, or send it again if its worker failed."""
        for future in [one for one in self._sent[number] if one.done()]:
            if future.status == "finished":
                self._answers[number] = future.result()
                self._cluster.forget(self._sent.pop(number))
                self._heard = time.monotonic()
                self._cluster.answered(self._heard - self._began)
                return
            self._sent[number].remove(future)
            self._excuse(number, future)
        if not self._sent[number]:
            self._send(number)

    def _excuse(self, number: int, future: Future) -> None:
        """Decide whether what went wrong is worth another try."""
        from distributed import KilledWorker

        error = future.exception() if future.status == "error" else None
        if error is None:  # lost with its worker
            return
        if isinstance(error, KilledWorker):
            self._deaths[number] += 1
            if self._deaths[number] >= DEATHS:
                raise InputError(f"workers keep dying ({error}): give them more memory")
            return
        foreign = isinstance(error, WrongWorkerError | ImportError | AttributeError)
        if foreign and self._cluster.dismiss():
            return
        self._errors[number] += 1
        if self._errors[number] >= TRIES:
            raise error
