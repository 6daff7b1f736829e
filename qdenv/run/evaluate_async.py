"""Populations under way: asked in order, evaluated side by side, told in order."""

from collections import deque
from collections.abc import Callable
from typing import Any, NamedTuple

import jax

from qdenv.pipeline import PipelinedEvaluator
from qdenv.run.problem import seen
from qdenv.search.base import Algorithm
from qdenv.types import Array, Evaluation


class Search(NamedTuple):
    """A search between two iterations; one pytree, which checkpoints hold."""

    state: Any  # of the algorithm
    # float [B, P] each, the populations it was asked for and not told of, the oldest first: as many
    # as the algorithm may be asked ahead
    asked: tuple[Array, ...]


def begin_search(algorithm: Algorithm, key: jax.Array) -> Search:
    """Start a search: nothing is told, and all is asked that may be asked ahead."""
    state, asked = algorithm.init(key), []
    for _ in range(algorithm.ahead):
        solutions, state = algorithm.ask(state)
        asked.append(solutions)
    return Search(state, tuple(asked))


class Flight:
    """The populations of a run that are under way.

    Population i is asked of the search that was told of all up to i - 1 - ahead, however fast
    the others were evaluated: what is found does not depend on who works how fast.
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
        """Begin to evaluate what was asked for before.

        Args:
            algorithm: as `search.growth.growing` gives it.
            evaluator: of populations.
            key: iteration ``i`` is evaluated with ``fold_in(key, i)``, so a resumed run draws the
                same.
            total: iterations of the run; later populations are asked for but not evaluated.
            done: iterations that `search` was told of.
            search: to go on from.
        """
        self._algorithm, self._evaluator, self._key = algorithm, evaluator, key
        self._total, self._done, self._search = total, done, search
        self._asked = deque(search.asked)
        self._evaluations: deque[Callable[[], Evaluation]] = deque()
        self._state = search.state  # asked once more than `search`, between `launch` and `land`
        for solutions in self._asked:
            self._begin(solutions)

    @property
    def done(self) -> int:
        """Count the iterations the search was told of."""
        return self._done

    @property
    def search(self) -> Search:
        """The search after iteration `done`."""
        return self._search

    def launch(self) -> None:
        """Ask for one more population and begin to evaluate it."""
        solutions, self._state = jax.block_until_ready(self._algorithm.ask(self._state))
        self._asked.append(solutions)
        self._begin(solutions)

    def wait(self) -> Evaluation:
        """Wait for the evaluation of the oldest population."""
        return self._evaluations[0]()

    def land(self, evaluation: Evaluation) -> None:
        """Tell the search of the oldest population."""
        solutions = self._asked.popleft()
        self._evaluations.popleft()
        told = solutions, evaluation.score, seen(evaluation)
        self._state = self._algorithm.tell(self._state, *told)
        self._search = Search(self._state, tuple(self._asked))
        self._done += 1

    def _begin(self, solutions: Array) -> None:
        number = self._done + len(self._evaluations) + 1
        if number <= self._total:
            key = jax.random.fold_in(self._key, number)
            self._evaluations.append(self._evaluator.begin(solutions, key))
