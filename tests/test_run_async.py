"""Populations asked ahead: what is asked of whom, told in order, and kept by checkpoints."""

import random
import shutil
import threading
from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import toy
from search_harness import compiled, extras_of, score_of

from qdenv.run import evaluate, loop
from qdenv.run.directory import RunDirectory
from qdenv.run.evaluate import AsyncEvaluation, Search
from qdenv.run.experiment import make_experiment, make_iteration
from qdenv.search.base import Algorithm
from qdenv.search.cma_mae import CmaMaeConfig
from qdenv.search.settings import CmaEsConfig, MapElitesConfig
from qdenv.types import InputError

pytestmark = pytest.mark.slow

AHEAD = 2
SHORT = replace(
    toy.CONFIG, algorithm=replace(toy.CONFIG.algorithm, ahead=AHEAD), evaluations=48
)  # six iterations, checkpoints after 2, 4 and 6


def scribe(ahead: int) -> tuple[Algorithm, list]:
    """Make an algorithm that writes down what is asked and told, and when."""
    log: list = []

    def ask(state):
        asked, told = state
        log.append(("ask", int(asked), int(told)))
        return jnp.full((1, 1), asked), (asked + 1, told)

    def tell(state, solutions, score, extras):
        asked, told = state
        log.append(("tell", int(solutions[0, 0]), int(told)))
        return asked, told + 1

    return Algorithm(lambda key: (0, 0), ask, tell, lambda state: None, 1, ahead=ahead), log


class Shuffled:
    """Evaluates each population in a thread of its own, which takes some time or other."""

    under_way = most = 0

    def begin(self, solutions, key):
        """Note how many are under way."""
        self.under_way += 1
        self.most = max(self.most, self.under_way)
        over = threading.Event()
        threading.Timer(random.Random(int(solutions[0, 0])).uniform(0, 0.05), over.set).start()

        def finish():
            over.wait()
            self.under_way -= 1
            return type("Evaluation", (), {"score": None})

        return finish


@pytest.mark.parametrize("ahead", [0, 1, 3])
def test_population_i_is_asked_when_all_up_to_i_minus_1_minus_ahead_are_told(ahead, monkeypatch):
    monkeypatch.setattr(evaluate, "observed", lambda evaluation: {})
    algorithm, log = scribe(ahead)
    evaluator, total = Shuffled(), 7
    search = Search.begin(algorithm, jax.random.key(0))
    under_way = AsyncEvaluation(algorithm, evaluator, jax.random.key(1), total, 0, search)
    while under_way.done < total:
        under_way.submit()
        under_way.collect(under_way.wait())
    asks = [(number, told) for what, number, told in log if what == "ask"]
    assert asks == [(number, max(0, number - ahead)) for number in range(total + ahead)]
    tells = [(number, told) for what, number, told in log if what == "tell"]
    assert tells == [(number, number) for number in range(total)]
    assert evaluator.most == ahead + 1
    assert [int(solutions[0, 0]) for solutions in under_way.search.in_flight] == [
        *range(total, total + ahead)
    ]


def test_the_answers_to_a_team_change_that_team_alone():
    config = CmaMaeConfig(emitters=2, batch=6, ahead=1, strategy="sep")
    algorithm = compiled(config)
    state = algorithm.init(jax.random.key(0))
    first, state = algorithm.ask(state)
    second, state = algorithm.ask(state)
    for turn, solutions in enumerate((first, second)):
        before = jax.tree.map(np.asarray, state.emitters[0])
        solutions = np.asarray(solutions)
        state = algorithm.tell(state, solutions, score_of(solutions), extras_of(solutions))
        moved = np.asarray(state.emitters[0].strategy.mean != before.strategy.mean)
        assert moved[turn].any() and not moved[1 - turn].any()


def test_teams_learn_from_their_own_solutions_as_one_team_does_alone():
    # Without a look at the archive a team's way follows from its start and its noise alone.
    alone = CmaEsConfig(emitters=1, batch=8)
    team, single = compiled(replace(alone, ahead=1)), compiled(alone)
    both, one = team.init(jax.random.key(0)), single.init(jax.random.key(0))
    inner = jax.tree.map(lambda leaf: leaf[0], both.emitters[0])
    one = one._replace(emitters=inner)
    waiting = []
    for iteration in range(8):
        solutions, both = team.ask(both)
        waiting.append(np.asarray(solutions))
        if iteration % 2 == 0:
            ours = waiting[-1]
            one = single.tell(one, ours, score_of(ours), extras_of(ours))
        if iteration:
            told = waiting.pop(0)
            both = team.tell(both, told, score_of(told), extras_of(told))
    learnt = jax.tree.map(lambda leaf: np.asarray(leaf[0]), both.emitters[0].strategy)
    jax.tree.map(
        lambda ours, theirs: np.testing.assert_allclose(ours, theirs, rtol=1e-5, atol=1e-6),
        learnt,
        jax.tree.map(np.asarray, one.emitters.strategy),
    )


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    return loop.train(SHORT, tmp_path_factory.mktemp("run") / "whole", progress=False)


def same(one: RunDirectory, other: RunDirectory) -> bool:
    timeless = [[row._replace(seconds=0.0) for row in run.read_metrics()] for run in (one, other)]
    files = [(run.path / "archive.npz").read_bytes() for run in (one, other)]
    return files[0] == files[1] and timeless[0] == timeless[1]


def test_a_run_that_asks_ahead_goes_on_bit_for_bit(whole, tmp_path):
    run = loop.train(replace(SHORT, evaluations=8), tmp_path / "run", progress=False)
    assert same(loop.resume(loop.resume(run.path, False, 40).path, False, 48), whole)


def test_another_number_of_populations_ahead_is_no_continuation(whole, tmp_path):
    copy = tmp_path / "copy"
    shutil.copytree(whole.path, copy)
    config = copy / "config.json"
    config.write_text(config.read_text().replace('"ahead": 2', '"ahead": 0'))
    with pytest.raises(InputError, match="another configuration"):
        loop.resume(copy, False, 64)


def test_map_elites_asks_ahead_too(tmp_path):
    config = replace(SHORT, algorithm=MapElitesConfig(emitters=2, batch=4, ahead=1))
    whole = loop.train(config, tmp_path / "whole", progress=False)
    run = loop.train(replace(config, evaluations=24), tmp_path / "run", progress=False)
    assert same(loop.resume(run.path, False, 48), whole)


def test_one_iteration_as_one_function_asks_nothing_ahead():
    with pytest.raises(InputError, match="leave ahead at 0"):
        make_iteration(make_experiment(SHORT))
