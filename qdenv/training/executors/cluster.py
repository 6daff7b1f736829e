"""A Dask cluster that repairs and simulates: a task is one layout, or a few that take no time.

What is found depends on the layout, its number and the key alone, not on who works.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING

import jax
import numpy as np

from qdenv.pipeline import Outcomes, Pipeline, joined
from qdenv.training.config import RunConfig, config_to_json
from qdenv.training.executors.task import evaluate_layouts, versions
from qdenv.training.executors.workers import Workers
from qdenv.types import Array

if TYPE_CHECKING:
    from distributed import Client

SHORTEST = 0.15  # seconds of a task
TASKS = 4  # of each worker in a population, so that none waits long for the last


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
        self._workers = Workers(client, evaluate_layouts, progress)
        evaluation = config.evaluation
        alone = replace(evaluation, repair=replace(evaluation.repair, workers=1))
        self._settings = json.dumps(config_to_json(replace(config, evaluation=alone)))
        layouts = jax.ShapeDtypeStruct((1, *pipeline.domain.shape), np.int8)
        index, key = jax.ShapeDtypeStruct((1,), np.int32), jax.random.key(0)
        self._runs = jax.tree.structure(jax.eval_shape(pipeline.simulate, layouts, index, key))

    def __call__(self, unrepaired: np.ndarray, key: Array) -> Callable[[], Outcomes]:
        """Begin to repair and simulate int8 [B, H, W]; what it returns waits for them."""
        drawn = np.asarray(jax.random.key_data(key))
        known = self._settings, versions()
        portion = self._choose_portion(len(unrepaired))
        firsts = range(0, len(unrepaired), portion)
        parts = [unrepaired[first : first + portion] for first in firsts]
        tasks = [(*known, *task, drawn) for task in zip(parts, firsts, strict=True)]
        batch = self._workers.begin(tasks, [len(part) for part in parts])
        return lambda: joined(
            [self._outcome(*answer) for answers in batch.finish() for answer in answers]
        )

    def _choose_portion(self, layouts: int) -> int:
        """Choose how many layouts are a task: the scheduler spends milliseconds on each."""
        if self._workers.usual == 0:  # how long they take is not known yet
            return 1
        most = layouts // (TASKS * self._workers.count)
        return max(min(round(SHORTEST / self._workers.usual), most), 1)

    def _outcome(self, layout: np.ndarray, status: int, leaves: list[np.ndarray]) -> Outcomes:
        """Give one answer of a worker the form of a population of one."""
        runs = jax.tree.unflatten(self._runs, leaves)
        return Outcomes(layout[None], np.array([status], np.int32), runs)
