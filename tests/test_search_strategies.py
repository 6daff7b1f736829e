"""Evolution strategies: evosax algorithms, also for evosax' users; the arithmetic by hand."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from evosax.algorithms.distribution_based.base import DistributionBasedAlgorithm
from search_harness import QUICK

from qdenv.search.cma_mae import make_member
from qdenv.search.strategies import STRATEGIES, make_strategy
from qdenv.search.strategies.base import Strategy, full_rates, rates_table
from qdenv.search.strategies.cma_es import Full, refresh_gap

pytestmark = pytest.mark.slow

OURS = [name for name, kind in STRATEGIES.items() if issubclass(kind, Strategy)]


def test_only_emitters_that_are_due_renew_their_eigensystem_also_under_vmap():
    strategy = Full(4, jnp.zeros(6))
    params = strategy.default_params
    factors = np.random.default_rng(0).normal(size=(2, 3, 6, 6)).astype(np.float32)
    covariance = factors @ factors.swapaxes(-1, -2)
    evaluations = jnp.array([[0, 1000, 0], [0, 0, 0]], jnp.int32)

    def refreshed(covariance, evaluations):
        state = strategy.init(jax.random.key(0), jnp.zeros(6), params)
        state = state.replace(C=covariance, evaluations=evaluations)
        return strategy.ask(jax.random.key(1), state, params)[1]

    together = jax.jit(jax.vmap(jax.vmap(refreshed)))(covariance, evaluations)
    alone = jax.jit(jax.vmap(refreshed))
    apart = [alone(covariance[row], evaluations[row]) for row in range(2)]
    for renewed in (together, jax.tree.map(lambda *rows: jnp.stack(rows), *apart)):
        np.testing.assert_array_equal(renewed.refreshed, evaluations)
        scaled = renewed.B * renewed.eigenvalues[..., None, :]
        rebuilt = np.asarray(scaled @ renewed.B.swapaxes(-1, -2))
        expected = np.where(evaluations[..., None, None] > 0, covariance, np.eye(6))
        np.testing.assert_allclose(rebuilt, expected, atol=1e-4)


def test_the_eigensystem_is_left_alone_under_a_vmap_over_emitters_until_it_is_due():
    # A select would compute it at every ask: the branch must have survived the vmap.
    strategy = Full(4, jnp.zeros(6))
    params = strategy.default_params
    states = jax.vmap(strategy.init, (0, 0, None))(
        jax.random.split(jax.random.key(0), 3), jnp.zeros((3, 6)), params
    )
    ask = jax.vmap(strategy.ask, (0, 0, None))
    text = str(jax.make_jaxpr(ask)(jax.random.split(jax.random.key(1), 3), states, params))
    assert "eigh" in text and "eigh" in text.partition("cond[")[2] and "select_and" not in text
    assert "eigh" not in text.partition("cond[")[0]


@pytest.mark.parametrize("name", STRATEGIES)  # ours follow pyribs step by step, too
def test_every_strategy_learns_from_the_ranks_it_is_given(name):
    # Ranked by the distance to a far point, the mean comes nearer; told the reverse, it flees.
    dim, batch = 20, 10
    target = jnp.full(dim, 2.0)
    init, ask, tell, _ = make_member(*make_strategy(name, dim, batch, 0.3))

    @functools.partial(jax.jit, compiler_options=QUICK)
    def distance(sign):
        def step(carry, key):
            solutions, state, tell_key = ask(carry[0], key)
            order = jnp.argsort(sign * jnp.square(solutions - target[None]).sum(-1))
            ranks = jnp.argsort(order).astype(solutions.dtype)
            told = solutions, ranks, jnp.ones(batch, bool), batch // 2
            return (tell(state, tell_key, *told), tell_key), None

        start = init(jnp.zeros(dim), jax.random.key(0))
        (state, _), _ = jax.lax.scan(step, start, jax.random.split(jax.random.key(1), 25))
        means = ask(state, jax.random.key(2))[0]
        return jnp.linalg.norm(means.mean(axis=0) - target)

    away = float(jnp.linalg.norm(target))
    assert float(distance(1.0)) < 0.85 * away
    assert float(distance(-1.0)) > 1.1 * away


@pytest.mark.parametrize("name", OURS)
def test_evosax_users_run_our_strategies_as_evosax_algorithms(name):
    # Their loop, on the sphere, with fitness in place of ranks and a tree in place of an array.
    solution = {"a": jnp.zeros((4, 3)), "b": jnp.zeros(12)}
    strategy = STRATEGIES[name](population_size=8, solution=solution)
    assert isinstance(strategy, DistributionBasedAlgorithm)
    params = strategy.default_params
    start = jax.tree.map(lambda leaf: leaf + 3, solution)

    @functools.partial(jax.jit, compiler_options=QUICK)
    def run(key):
        def step(state, key):
            population, state = strategy.ask(key, state, params)
            parts = [jnp.square(leaf).reshape(8, -1).sum(-1) for leaf in population.values()]
            fitness = sum(parts).at[3].set(jnp.nan)  # failed, however good
            state, metrics = strategy.tell(key, population, fitness, state, params)
            return state, metrics["best_fitness"]

        keys = jax.random.split(key, 150)
        return jax.lax.scan(step, strategy.init(key, start, params), keys)

    state, best = run(jax.random.key(0))
    assert int(state.generation_counter) == 150 and jnp.isfinite(state.mean).all()
    assert float(best[-1]) == float(state.best_fitness) < 0.1 * float(best[0])
    assert (np.diff(best) <= 0).all() and strategy.get_mean(state)["a"].shape == (4, 3)


@pytest.mark.parametrize("wrap", [jax.jit, lambda function: function], ids=["jit", "plain"])
def test_one_isotropic_step_is_the_arithmetic_of_the_tutorial(wrap):
    # P = 4, b = 4, two parents, sigma 0.5; all by hand from Hansen's table 1 and (38) to (44).
    strategy, params = make_strategy("iso", 4, 4, 0.5)
    solutions = np.array([[1, 0, 0, 0], [0, 2, 0, 0], [9, 9, 9, 9], [-9, 9, 9, 9]], np.float32)
    state = strategy.init(jax.random.key(0), jnp.zeros(4), params)
    ranks = jnp.array([1.0, 0.0, jnp.nan, 2.0])
    state, _ = wrap(strategy.tell)(None, solutions, ranks, state, params)
    raw = np.log(2.5) - np.log([1, 2])
    first, second = raw / raw.sum()
    mu_eff = 1 / (first**2 + second**2)
    rate = (mu_eff + 2) / (4 + mu_eff + 5)
    mean = np.array([second, 2 * first, 0, 0])
    path = np.sqrt(rate * (2 - rate) * mu_eff) * mean / 0.5
    damping = 1 + rate  # sqrt((mu_eff - 1) / 5) is below 1
    sigma = 0.5 * np.exp(min(1, rate / damping * (np.square(path).sum() / 4 - 1) / 2))
    np.testing.assert_allclose(state.mean, mean, rtol=1e-6)
    np.testing.assert_allclose(state.p_std, path, rtol=1e-6)
    np.testing.assert_allclose(state.std, sigma, rtol=1e-6)


def test_the_table_of_rates_has_the_textbook_numbers_and_an_idle_first_row():
    table = rates_table(10, 100, full_rates)
    assert table.weights.shape == (11, 10)
    np.testing.assert_allclose(table.weights.sum(axis=1), 1, rtol=1e-6)
    weights = np.log(5.5) - np.log(np.arange(1, 6))
    weights /= weights.sum()
    mu_eff = 1 / np.square(weights).sum()
    np.testing.assert_allclose(table.weights[5, :5], weights, rtol=1e-6)
    np.testing.assert_allclose(table.mu_eff[5], mu_eff, rtol=1e-6)
    np.testing.assert_allclose(table.rank_one[5], 2 / (101.3**2 + mu_eff), rtol=1e-6)
    np.testing.assert_allclose(
        table.rank_mu[5], 2 * (mu_eff - 2 + 1 / mu_eff) / (102**2 + mu_eff), rtol=1e-6
    )
    assert [float(table[field][0]) for field in (2, 4, 5, 6)] == [0, 0, 0, 0]


@pytest.mark.parametrize(("emitters", "batch"), [(5, 10), (1, 50)])
def test_the_paper_budget_ends_before_a_full_matrix_would_be_refreshed(emitters, batch):
    # pyribs' rule at the 11,011 parameters of the warehouse's automaton, by hand: half the
    # batch over n (c_1 + c_mu) evaluations of one emitter.
    weights = np.log(batch // 2 + 0.5) - np.log(np.arange(1, batch // 2 + 1))
    mu_eff = weights.sum() ** 2 / np.square(weights).sum()
    rank_one = 2 / (11_012.3**2 + mu_eff)
    rank_mu = 2 * (mu_eff - 2 + 1 / mu_eff) / (11_013**2 + mu_eff)
    gap = 0.5 * batch / (11_011 * (rank_one + rank_mu))
    assert refresh_gap(11_011, batch) == pytest.approx(gap)
    assert refresh_gap(11_011, batch) > 10_000 / emitters
