"""qdax' MAP-Elites driver on our archive, with qdax' own emitter and with ours."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from qdax.core.emitters.mutation_operators import isoline_variation
from qdax.core.emitters.standard_emitters import MixingEmitter
from qdax.core.map_elites import MAPElites
from qdax.utils.metrics import default_qd_metrics

from qdenv.search.archive import GridArchive
from qdenv.search.base import Problem
from qdenv.search.cma_mae import CmaMaeConfig, cma_mae
from qdenv.search.qdax_emitter import CmaMaeEmitter
from qdenv.types import Measure, Score

pytestmark = pytest.mark.slow

DIM = 8
QUICK = {"xla_backend_optimization_level": 0}  # these searches compile longer than they run
GRID = (Measure("x", -2, 2, 10), Measure("y", -2, 2, 12))


def scoring(genotypes, key=None):
    fitness = 10 - jnp.square(genotypes - 0.5).sum(axis=-1)
    return fitness[:, None], genotypes[:, :2], {"sum": genotypes.sum(axis=-1)}


def drive(emitter, iterations, first):
    """Run the driver under scan from `first` solutions: (repertoire, state, metrics over time)."""
    make = functools.partial(GridArchive.init, measures=GRID)
    driver = MAPElites(
        scoring_function=scoring,
        emitter=emitter,
        metrics_function=functools.partial(default_qd_metrics, qd_offset=0.0),
        repertoire_init=lambda g, f, d, c, e: make(
            g, f, d, c, extra_scores=e, keys_extra_scores=("sum",)
        ),
    )

    @functools.partial(jax.jit, compiler_options=QUICK)
    def run(key):
        repertoire, state, _ = driver.init(0.1 * jax.random.normal(key, (first, DIM)), None, key)
        carry = (repertoire, state, key)
        return jax.lax.scan(driver.scan_update, carry, None, iterations)

    (repertoire, state, _), metrics = run(jax.random.key(0))
    return repertoire, state, metrics


def check_elites(repertoire):
    """Demand that every elite lies in its cell with the fitness and extras of its solution."""
    assert type(repertoire) is GridArchive
    filled = np.flatnonzero(repertoire.filled)
    solutions = repertoire.genotypes[filled]
    fitness, places, extras = scoring(solutions)
    np.testing.assert_allclose(repertoire.fitnesses[filled], fitness, rtol=1e-5)
    np.testing.assert_allclose(repertoire.extra_scores["sum"][filled], extras["sum"], rtol=1e-4)
    np.testing.assert_array_equal(repertoire.cells_of(places), filled)


def test_the_driver_runs_qdax_isoline_emitter_on_our_archive():
    variation = functools.partial(isoline_variation, iso_sigma=0.2, line_sigma=0.2)
    emitter = MixingEmitter(lambda g, k: (g, k), variation, 1.0, 20)
    repertoire, _, metrics = drive(emitter, 25, first=6)
    check_elites(repertoire)
    assert (np.diff(metrics["qd_score"]) >= 0).all()
    np.testing.assert_allclose(metrics["qd_score"][-1], repertoire.qd_score, rtol=1e-6)
    assert float(metrics["coverage"][-1]) > 20


@pytest.mark.parametrize("strategy", ["iso", "sep"])
def test_the_driver_reaches_the_archive_of_our_own_loop_bit_for_bit(strategy):
    config = CmaMaeConfig(emitters=3, batch=10, sigma0=0.5, restart=7, strategy=strategy)
    repertoire, state, metrics = drive(CmaMaeEmitter(config, DIM, GRID), 40, first=0)
    check_elites(repertoire)
    assert int(state.emitters.restarts.sum()) > 0
    algorithm = cma_mae(config, Problem(DIM, GRID, {"sum": np.float32(0)}))

    def step(carry, _):
        solutions, carry = algorithm.ask(carry)
        fitness, places, extras = scoring(solutions)
        score = Score(fitness[:, 0], fitness[:, 0], places, jnp.ones(len(solutions), bool))
        return algorithm.tell(carry, solutions, score, extras), None

    @functools.partial(jax.jit, compiler_options=QUICK)
    def run(key):
        own = jax.lax.scan(step, algorithm.init(key), None, 40)[0]
        return algorithm.archive(own), own

    # The driver splits its key for the first scores, then for the emitter.
    key = jax.random.split(jax.random.split(jax.random.key(0))[0])[1]
    archive, own = run(key)
    for one, other in zip(jax.tree.leaves(repertoire), jax.tree.leaves(archive), strict=True):
        np.testing.assert_array_equal(one, other)
    np.testing.assert_array_equal(state.learning.thresholds, own.archives.learning.thresholds)
    np.testing.assert_array_equal(state.emitters.strategy.mean, own.emitters.strategy.mean)
    np.testing.assert_allclose(metrics["qd_score"][-1], archive.qd_score, rtol=1e-6)
