"""The search against recorded outputs of pyribs 0.12, in float64."""

import functools
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from qdenv.search.archive import GridArchive
from qdenv.search.cma_mae import EmittersState, make_emitters
from qdenv.search.settings import CmaMaeConfig
from qdenv.search.strategies import make_strategy
from qdenv.search.strategies.base import StrategyState
from qdenv.search.strategies.cma_es import refresh_gap
from qdenv.types import Measure, Score

pytestmark = pytest.mark.slow

RECORDED = Path(__file__).parent / "data" / "search"
MEASURES = (Measure("x", -1, 1, 6), Measure("y", 0, 3, 5))
EXACT = {"rtol": 0, "atol": 1e-12}


@pytest.fixture(autouse=True)
def float64():
    jax.config.update("jax_enable_x64", True)  # `jax.enable_x64` is newer than the lowest version
    yield
    jax.config.update("jax_enable_x64", False)


def load(name):
    with np.load(RECORDED / f"{name}.npz") as file:
        return dict(file)


def test_archive_adds_as_pyribs_over_60_cases_of_12_batches():
    recorded = load("archive")
    insert = jax.jit(lambda archive, *batch: archive.insert(*batch))
    for case, (learning_rate, threshold_min) in enumerate(recorded["rates"]):
        archive = GridArchive.empty(
            np.zeros(1), MEASURES, learning_rate=learning_rate, threshold_min=threshold_min
        )
        rows = recorded["status"].shape[-1]
        for batch, expected in enumerate(recorded["status"][case]):
            archive, insertion = insert(
                archive,
                (batch * rows + np.arange(rows))[:, None].astype(float),
                recorded["objective_eighths"][case, batch] / 8,
                recorded["measure_fiftieths"][case, batch] / 50 + np.array([0.0, 1.5]),
            )
            np.testing.assert_array_equal(insertion.status, expected)
            np.testing.assert_allclose(insertion.value, recorded["value"][case, batch], **EXACT)
        filled = np.asarray(archive.filled)
        np.testing.assert_array_equal(
            np.where(filled, archive.genotypes[:, 0], -1), recorded["winner"][case]
        )
        for got, name in ((archive.thresholds, "threshold"), (archive.objectives, "objective")):
            expected = recorded[f"final_{name}"][case]
            np.testing.assert_allclose(np.where(filled, got, 0), expected, **EXACT)


RECORDS = {"full": "full", "separable": "sep", "limited_memory": "lm_ma"}


@pytest.mark.parametrize("name", RECORDS)
def test_strategy_follows_pyribs_for_60_iterations(name, monkeypatch):
    recorded = load(name)
    strategy, params = make_strategy(RECORDS[name], 12, 8, 0.5)
    # The key that asks is the noise itself.
    monkeypatch.setattr(jax.random, "normal", lambda key, *_: key)
    state = strategy.init(jax.random.key(0), jnp.linspace(-1, 1, 12), params)
    for step, solutions in enumerate(recorded["solutions"]):
        own, state = strategy.ask(recorded["noise"][step].astype(float), state, params)
        if name != "full":  # eigenvectors may differ in sign, and the solutions with them
            np.testing.assert_allclose(own, solutions, rtol=1e-12, atol=1e-11)
        else:
            assert int(state.refreshed) == recorded["refreshed"][step]
        parents = params.replace(num_elites=recorded["parents"][step])
        ranks = np.argsort(recorded["order"][step]).astype(float)
        state, _ = strategy.tell(None, solutions, ranks, state, parents)
        for mine, theirs in (("mean", "mean"), ("std", "sigma"), ("p_std", "ps")):
            # The step size of LM-MA-ES grows by powers of ten under random ranks.
            np.testing.assert_allclose(
                getattr(state, mine), recorded[theirs][step], rtol=1e-12, atol=1e-12
            )
        if name != "limited_memory":
            np.testing.assert_allclose(state.p_c, recorded["pc"][step], **EXACT)
        if name == "separable":
            np.testing.assert_allclose(state.C, recorded["cov"][step], **EXACT)
        if name == "full" and step % 6 == 0:
            np.testing.assert_allclose(state.C, recorded["cov"][step // 6], **EXACT)


@pytest.mark.parametrize(
    ("name", "ranker", "selection", "restart"),
    [
        ("emitters_imp", "imp", "mu", "no_improvement"),
        ("emitters_2imp", "2imp", "filter", "no_improvement"),
        ("emitters_period", "2imp", "mu", 7),
    ],
)
def test_emitters_rank_select_and_restart_as_pyribs(name, ranker, selection, restart):
    recorded = load(name)
    steps, count, dim = recorded["mean"].shape
    batch = recorded["solutions"].shape[1] // count
    config = CmaMaeConfig(
        count, batch, 0.5, ranker=ranker, selection=selection, restart=restart, strategy="iso"
    )
    emitters = make_emitters(config, jnp.zeros(dim))

    @jax.jit
    def step(archive, state, solutions, objective, measures):
        archive, insertion = archive.insert(solutions, objective, measures)
        score = Score(objective, objective, measures, jnp.ones(len(objective), bool))
        rows = solutions, score, insertion
        return archive, emitters.tell(state, jax.random.key(0), rows, archive)

    archive = GridArchive.empty(np.zeros(dim), MEASURES, None, 0.1, 0.0)
    restarts, iterations = jnp.zeros(count, jnp.int32), jnp.int32(0)
    for index in range(steps - 1):
        fields = (jnp.asarray(recorded[field][index]) for field in ("mean", "sigma", "path"))
        state = EmittersState(StrategyState(None, None, None, *fields), None, iterations, restarts)
        rows = (recorded[field][index] for field in ("solutions", "objective", "measures"))
        archive, state = step(archive, state, *rows)
        restarts, iterations = state.restarts, state.iterations
        np.testing.assert_array_equal(restarts, recorded["restarts"][index])
        before = recorded["restarts"][index - 1] if index else 0
        kept = recorded["restarts"][index] == before
        # A restarted emitter stands at a random elite; all others where pyribs has them.
        got = state.strategy.mean, state.strategy.std, state.strategy.p_std
        for values, field in zip(got, ("mean", "sigma", "path"), strict=True):
            np.testing.assert_allclose(
                np.asarray(values)[kept], recorded[field][index + 1][kept], **EXACT
            )
    assert restarts.sum() > 0


def test_isotropic_is_full_until_the_first_refresh_and_not_after():
    def run(name, count):
        strategy, params = make_strategy(name, 30, 8, 0.3)
        state = strategy.init(jax.random.key(1), jnp.ones(30), params)

        def step(state, key):
            solutions, state = strategy.ask(key, state, params)
            fitness = jnp.square(solutions * jnp.arange(1, 31)[None]).sum(-1)
            return strategy.tell(None, solutions, fitness, state, params)[0], state.mean

        return jax.lax.scan(step, state, jax.random.split(jax.random.key(2), count))[1]

    exact = int(refresh_gap(30, 8)) // 8
    iso, whole = (jax.jit(functools.partial(run, name, exact + 12))() for name in ("iso", "full"))
    np.testing.assert_allclose(iso[: exact + 1], whole[: exact + 1], **EXACT)
    assert np.abs(iso[-1] - whole[-1]).max() > 1e-3
