"""CMA-MAE as an emitter of qdax, https://github.com/adaptive-intelligent-robotics/QDax."""

from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp
from qdax.core.emitters.emitter import Emitter, EmitterState

from qdenv.search.archive import GridArchive
from qdenv.search.base import check_batch, plain_key, start_solution
from qdenv.search.cma_mae import make_emitters
from qdenv.search.settings import CmaMaeConfig
from qdenv.types import Array, Extras, Measure, Score


class CmaMaeEmitterState(EmitterState):
    """State of `CmaMaeEmitter`; the driver's repertoire is the result archive."""

    key: jax.Array  # uint32 [2]
    emitters: Any  # of the evolution strategies
    learning: GridArchive  # the soft archive that ranks solutions


class CmaMaeEmitter(Emitter):
    """Emit the solutions of E evolution strategies steered by a soft archive.

    The driver's fitness is the objective of both archives. To steer by another one, let the
    scoring function return it as the extra score ``learning_fitness``, float [B]. Solutions
    whose fitness is not finite count as failed, but for those of `init`.

    CMA-MAE needs no first population. Begin with an empty one, ``driver.init(jnp.zeros((0, P)),
    None, key)`` with `GridArchive.init` as the driver's repertoire: then the loop is that of
    `cma_mae` for the key that the driver passes on. Keys that it passes later are not used.
    """

    def __init__(
        self,
        config: CmaMaeConfig,
        solution_dim: int,
        measures: Sequence[Measure],
        x0: Array | None = None,
    ) -> None:
        """Set the emitter up; all strategies start at `x0` (float [P]; zeros where None)."""
        self._config = config
        self._measures = measures
        self._start = start_solution(x0, solution_dim)
        self._emitters = make_emitters(config, self._start)

    @property
    def batch_size(self) -> int:
        """Return the number of solutions per iteration."""
        return self._config.emitters * self._config.batch

    def init(
        self,
        key: jax.Array,
        repertoire: Any,
        genotypes: Array,
        fitnesses: Array,
        descriptors: Array,
        extra_scores: Extras,
    ) -> CmaMaeEmitterState:
        """Start all strategies at x0; the first population enters the learning archive."""
        key, emitters_key = jax.random.split(plain_key(key))
        thresholds = self._config.learning_rate, self._config.threshold_min
        learning = GridArchive.empty(self._start, self._measures, None, *thresholds)
        objective = jnp.reshape(extra_scores.get("learning_fitness", fitnesses), -1)
        learning, _ = learning.insert(genotypes, objective, descriptors)
        return CmaMaeEmitterState(key, self._emitters.init(emitters_key), learning)

    def emit(
        self, repertoire: Any, emitter_state: CmaMaeEmitterState, key: jax.Array
    ) -> tuple[jax.Array, dict[str, Any]]:
        """Sample a batch, float [B, P]."""
        # An emitter of qdax cannot change its state here: the changed one travels with the batch
        # as extra information and comes back in `state_update`.
        key, ask_key = jax.random.split(emitter_state.key)
        solutions, emitters = self._emitters.ask(emitter_state.emitters, ask_key)
        return solutions, {"emitters": emitters, "key": key}

    def state_update(
        self,
        emitter_state: CmaMaeEmitterState,
        repertoire: Any = None,
        genotypes: Any = None,
        fitnesses: Any = None,
        descriptors: Any = None,
        extra_scores: Any = None,
    ) -> CmaMaeEmitterState:
        """Rank the batch by the learning archive, adapt and restart."""
        key, tell_key = jax.random.split(extra_scores["key"])
        fitness = jnp.reshape(fitnesses, -1)
        objective = jnp.reshape(extra_scores.get("learning_fitness", fitness), -1)
        success = jnp.ones_like(fitness, bool)
        solutions, score = check_batch(genotypes, Score(objective, fitness, descriptors, success))
        learning, insertion = emitter_state.learning.insert(
            solutions, score.objective, score.measures, None, score.success
        )
        rows = solutions, score, insertion
        emitters = self._emitters.tell(extra_scores["emitters"], tell_key, rows, learning)
        return CmaMaeEmitterState(key, emitters, learning)
