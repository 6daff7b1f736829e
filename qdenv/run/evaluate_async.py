"""Asynchronous evaluation: several populations in flight, collected in the order of submission."""

from collections import deque
from collections.abc import Callable
from typing import Any, NamedTuple, Self

import jax

from qdenv.pipeline import PipelinedEvaluator
from qdenv.run.experiment import observed
from qdenv.search.base import Algorithm
from qdenv.types import Array, Evaluation


class Search(NamedTuple):
    """A search between two iterations; one pytree, which checkpoints hold."""

    state: Any  # of the algorithm
    # float [B, P] each, the populations in flight, the oldest first: `Algorithm.ahead` of them
    in_flight: tuple[Array, ...]

    @classmethod
    def begin(cls, algorithm: Algorithm, key: jax.Array) -> Self:
        """Start a search with as many populations in flight as `algorithm.ahead` states."""
        state, in_flight = algorithm.init(key), []
        for _ in range(algorithm.ahead):
            solutions, state = algorithm.ask(state)
            in_flight.append(solutions)
        return cls(state, tuple(in_flight))


class AsyncEvaluation:
    """The populations of a run that are in flight.

    Population i comes from the search that has seen the results of all up to i - 1 - ahead, however
    fast the others were evaluated: the results do not depend on the speed of workers.
    """

    def __init__(
        self,
        algorithm: Algorithm,
        evaluator: PipelinedEvaluator,
        key: jax.Array,
        total: int,
        done: int,
        search: Search,
    ) -> None:
        """Submit the populations that the search already holds.

        Iteration ``i`` is evaluated with ``fold_in(key, i)``, so a resumed run draws the same.
        `total` is the number of iterations of the run: later populations are drawn but not
        evaluated. `done` is the number of those that `search` has seen.
        """
        self.done, self.search = done, search
        self._algorithm, self._evaluator, self._key, self._total = algorithm, evaluator, key, total
        self._in_flight = deque(search.in_flight)
        self._evaluations: deque[Callable[[], Evaluation]] = deque()
        # One population further than `search`, between `submit` and `collect`.
        self._state = search.state
        for solutions in self._in_flight:
            self._begin(solutions)

    def submit(self) -> None:
        """Draw one more population and begin to evaluate it."""
        solutions, self._state = jax.block_until_ready(self._algorithm.ask(self._state))
        self._in_flight.append(solutions)
        self._begin(solutions)

    def wait(self) -> Evaluation:
        """Wait for the evaluation of the oldest population."""
        return self._evaluations[0]()

    def collect(self, evaluation: Evaluation) -> None:
        """Give the search the evaluation of the oldest population, which `wait` returned."""
        solutions = self._in_flight.popleft()
        self._evaluations.popleft()
        scores = evaluation.score, observed(evaluation)
        self._state = self._algorithm.tell(self._state, solutions, *scores)
        self.search = Search(self._state, tuple(self._in_flight))
        self.done += 1

    def _begin(self, solutions: Array) -> None:
        # Iterations count from 1. Populations beyond the total are drawn, as the state of the
        # search would differ otherwise, but their results would never be collected.
        number = self.done + len(self._evaluations) + 1
        if number <= self._total:
            key = jax.random.fold_in(self._key, number)
            self._evaluations.append(self._evaluator.begin(solutions, key))
