"""Algorithms and strategies by name, a user's own among them; settings that are impossible."""

import dataclasses
from typing import get_args

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from search_harness import DIM, GRID, compile_search, compiled, iterate

from qdenv.registry import Entry, Registry
from qdenv.search import registry
from qdenv.search.archive import GridArchive, Insertion
from qdenv.search.base import Algorithm, Problem
from qdenv.search.cma_mae import cma_mae
from qdenv.search.registry import ALGORITHMS, make_algorithm
from qdenv.search.settings import UNSOUND, CmaMaeConfig, CmaMeConfig, StrategyName
from qdenv.search.strategies import STRATEGIES
from qdenv.search.strategies.cma_es import Isotropic
from qdenv.types import InputError


def test_names_and_settings_find_each_other():
    own = {"cma-mae", "cma-me", "cma-mae-screened", "map-elites", "cma-es", "random", "dsage"}
    assert own <= set(ALGORITHMS.names())
    # The settings of CMA-ME are those of CMA-MAE with other defaults, but a type of their own.
    assert isinstance(CmaMeConfig(), CmaMaeConfig)
    assert ALGORITHMS.name_of(CmaMeConfig()) == "cma-me"


def test_a_users_algorithm_plugs_in_by_name(monkeypatch):
    @dataclasses.dataclass(frozen=True)
    class RingConfig:
        radius: float = 0.5

    def ring(config, problem):
        def init(key):
            return GridArchive.empty(
                jnp.zeros(problem.solution_dim), problem.measures, problem.extras
            )

        def ask(archive):
            angle = jnp.linspace(0, 6, 4)[:, None] + jnp.arange(problem.solution_dim)[None]
            return config.radius * jnp.sin(angle), archive

        def tell(archive, solutions, score, extras):
            place = solutions, score.result_objective, score.measures
            return archive.insert(*place, extras, score.success)[0]

        return Algorithm(init, ask, tell, lambda archive: archive, 4)

    algorithms = Registry("algorithm", "qdenv.algorithms", {"cma-mae": ALGORITHMS.entry("cma-mae")})
    algorithms.register("ring", Entry(RingConfig, ring))
    monkeypatch.setattr(registry, "ALGORITHMS", algorithms)
    search = compiled(RingConfig(radius=0.7))
    assert algorithms.name_of(RingConfig(radius=0.7)) == "ring"
    state = iterate(search, search.init(jax.random.key(0)))
    assert int(search.algorithm.archive(state).filled.sum()) == 4


def test_the_command_line_knows_every_strategy_and_none_that_is_unsound():
    assert set(get_args(get_args(StrategyName)[0])) == set(STRATEGIES)
    for name, reason in UNSOUND.items():
        assert name not in STRATEGIES
        assert set(reason.partition("; use ")[2].split(" or ")) <= set(STRATEGIES)


def test_a_users_strategy_plugs_in_by_name(monkeypatch):
    class Mine(Isotropic):
        def _ask(self, key, state, params):
            solutions, state = super()._ask(key, state, params)
            return solutions + 7, state

    monkeypatch.setitem(STRATEGIES, "mine", Mine)
    search = compile_search(CmaMaeConfig(strategy="mine"), Problem(DIM, GRID))
    solutions, _ = search.ask(search.init(jax.random.key(0)))
    assert 6.9 < float(solutions.mean()) < 7.1


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"emitters": 0}, "emitters must be at least 1, not 0"),
        ({"sigma0": float("nan")}, "sigma0"),
        ({"ranker": "best"}, "unknown ranker 'best': choose one of imp"),
        ({"selection": "all"}, "unknown selection"),
        ({"strategy": "newton"}, "unknown strategy"),
        ({"strategy": "LM_MA_ES"}, "LM_MA_ES is not offered: .* use lm_ma"),
        ({"restart": 0}, "restart"),
        ({"restart": "sometimes"}, "restart"),
        ({"learning_rate": 2.0}, "learning-rate must be at most 1"),
        ({"strategy": "lm_ma", "batch": 99}, "batch of at most 12"),
        ({"strategy": "Open_ES", "batch": 5}, "even batch"),
        ({"strategy": "PGPE", "batch": 5}, "even batch"),
    ],
)
def test_bad_settings_give_one_clear_line(change, message):
    with pytest.raises(InputError, match=message):
        make_algorithm(dataclasses.replace(CmaMaeConfig(), **change), Problem(DIM, GRID))


def test_an_unregistered_config_and_a_wrong_start_give_one_clear_line():
    with pytest.raises(InputError, match="choose from cma-mae"):
        make_algorithm(Insertion(0, 0), Problem(DIM, GRID))
    with pytest.raises(InputError, match="unknown algorithm 'cmamae': did you mean cma-mae"):
        ALGORITHMS.entry("cmamae")
    with pytest.raises(InputError, match="x0"):
        cma_mae(CmaMaeConfig(), Problem(DIM, GRID), x0=np.zeros(3))
