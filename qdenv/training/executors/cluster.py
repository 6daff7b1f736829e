"""A Dask cluster that repairs and simulates: a task is one layout, or a few that take no time.

What is found depends on the layout, its number and the key alone, not on who works.
"""

from __future__ import annotations

import json
import math
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

LONGEST = 1.0  # seconds of a task of several layouts: the scheduler spends milliseconds on each


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
        firsts = self._divide(len(unrepaired))
        parts = np.split(unrepaired, firsts[1:])
        tasks = [(*known, *task, drawn) for task in zip(parts, firsts, strict=True)]
        batch = self._workers.begin(tasks, [len(part) for part in parts])
        return lambda: joined(
            [self._outcome(*answer) for answers in batch.finish() for answer in answers]
        )

    def _divide(self, layouts: int) -> list[int]:
        """Divide a population into tasks, ever smaller ones, so that all workers end together.

        Guided self-scheduling (Polychronopoulos and Kuck 1987): each is what is left, divided by
        the workers, but no longer than `LONGEST`.
        """
        usual = self._workers.usual  # 0 if how long a layout takes is not known yet
        most = max(round(LONGEST / usual), 1) if usual else 1
        firsts = [0]
        while (left := layouts - firsts[-1]) > 1:
            firsts.append(firsts[-1] + min(math.ceil(left / max(self._workers.count, 2)), most))
        return firsts

    def _outcome(self, layout: np.ndarray, status: int, leaves: list[np.ndarray]) -> Outcomes:
        """Give one answer of a worker the form of a population of one."""
        runs = jax.tree.unflatten(self._runs, leaves)
        return Outcomes(layout[None], np.array([status], np.int32), runs)
