"""CMA-MAE as a qdax emitter, for users of qdax' `MAPElites` driver.

qdax (https://github.com/adaptive-intelligent-robotics/QDax) is not type-checked here: what its
driver hands over is `Any`.
"""

from collections.abc import Mapping, Sequence
from typing import Any

import jax
import jax.numpy as jnp
from qdax.core.emitters.emitter import Emitter, EmitterState

from qdenv.search.base import plain_key, received, start_solution
from qdenv.search.cma_mae import CmaMaeConfig, make_team, new_learning_archive
from qdenv.search.emitters import EmittersState
from qdenv.search.threshold_archive import ThresholdArchive
from qdenv.search.turns import TurnsState
from qdenv.types import Array, Measure, Score


class CmaMaeEmitterState(EmitterState):
    """What `CmaMaeEmitter` remembers; the driver's repertoire is the result archive."""

    key: jax.Array  # uint32 [2], for restarts
    emitters: EmittersState | TurnsState  # the evolution strategies
    learning: ThresholdArchive  # the soft archive that ranks solutions


class CmaMaeEmitter(Emitter):
    """Emit the solutions of E evolution strategies steered by a soft archive.

    The driver's fitness is the objective of both archives. To steer by another one, let the
    scoring function return it as the extra score ``learning_fitness``, float [B]. Solutions whose
    fitness is not finite count as failed.
    """

    def __init__(
        self,
        config: CmaMaeConfig,
        solution_dim: int,
        measures: Sequence[Measure],
        x0: Array | None = None,
    ) -> None:
        """Set the emitter up; the arguments are those of `qdenv.search.cma_mae.cma_mae`."""
        self._config = config
        self._measures = measures
        self._start = start_solution(x0, solution_dim)
        self._team = make_team(config, self._start)

    @property
    def batch_size(self) -> int:
        """Give the number of solutions per iteration."""
        return self._config.emitters * self._config.batch

    def init(
        self,
        key: jax.Array,
        repertoire: Any,
        genotypes: Array,
        fitnesses: Array,
        descriptors: Array,
        extra_scores: Mapping[str, Array],
    ) -> CmaMaeEmitterState:
        """Start all strategies at x0; the first population enters the learning archive."""
        key, team_key = jax.random.split(plain_key(key))
        learning = new_learning_archive(self._config, self._start, self._measures)
        objective = _objective(fitnesses, extra_scores)
        learning, _ = learning.insert(genotypes, objective, descriptors)
        return CmaMaeEmitterState(key=key, emitters=self._team.init(team_key), learning=learning)

    def emit(
        self, repertoire: Any, emitter_state: CmaMaeEmitterState, key: jax.Array
    ) -> tuple[jax.Array, dict[str, Any]]:
        """Sample a batch, float [B, P]; consumes `key`.

        qdax gives an emitter no way to keep what it drew, so the sampled state travels with the
        batch as extra information and comes back in `state_update`.
        """
        solutions, emitters = self._team.ask(emitter_state.emitters, key)
        return solutions, {"emitters": emitters}

    def state_update(
        self,
        emitter_state: CmaMaeEmitterState,
        repertoire: Any = None,
        genotypes: Any = None,
        fitnesses: Any = None,
        descriptors: Any = None,
        extra_scores: Any = None,
    ) -> CmaMaeEmitterState:
        """Judge the batch by the learning archive, adapt and restart."""
        key, tell_key = jax.random.split(emitter_state.key)
        objective = _objective(fitnesses, extra_scores)
        everyone = jnp.ones_like(objective, bool)
        solutions, score = received(genotypes, Score(objective, objective, descriptors, everyone))
        learning, insertion = emitter_state.learning.insert(
            solutions, objective, score.measures, success=score.success
        )
        told = solutions, insertion, objective, score.success
        emitters = self._team.tell(extra_scores["emitters"], tell_key, *told, learning)
        return CmaMaeEmitterState(key=key, emitters=emitters, learning=learning)


def _objective(fitnesses: Array, extra_scores: Mapping[str, Array]) -> jax.Array:
    return jnp.reshape(extra_scores.get("learning_fitness", fitnesses), -1)
