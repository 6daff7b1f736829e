"""Evolution strategies: refreshing under vmap, learning from ranks, plain calls and jit alike."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from search_harness import QUICK

from qdenv.search.strategies.evosax import EVOSAX_NAMES
from qdenv.search.strategies.full import full, refresh_gap
from qdenv.search.strategies.rates import full_rates, rates_table
from qdenv.search.strategies.registry import STRATEGIES


def test_only_emitters_that_are_due_renew_their_eigensystem_also_under_vmap():
    strategy = full(6, 4, 0.3)
    factors = np.random.default_rng(0).normal(size=(2, 3, 6, 6)).astype(np.float32)
    covariance = factors @ factors.swapaxes(-1, -2)
    keys = jax.random.split(jax.random.key(0), (2, 3))
    fresh = jax.vmap(jax.vmap(strategy.init))(jnp.zeros((2, 3, 6)), keys)
    evaluations = jnp.array([[0, 1000, 0], [0, 0, 0]], jnp.int32)
    states = fresh._replace(covariance=covariance, evaluations=evaluations)
    together = jax.jit(jax.vmap(strategy.refresh))(states)
    alone = jax.jit(strategy.refresh)
    apart = [alone(jax.tree.map(lambda leaf, row=row: leaf[row], states)) for row in range(2)]
    for renewed in (together, jax.tree.map(lambda *rows: jnp.stack(rows), *apart)):
        np.testing.assert_array_equal(renewed.refreshed, evaluations)
        scaled = renewed.basis * renewed.eigenvalues[..., None, :]
        rebuilt = np.asarray(scaled @ renewed.basis.swapaxes(-1, -2))
        expected = np.where(evaluations[..., None, None] > 0, covariance, np.eye(6))
        np.testing.assert_allclose(rebuilt, expected, atol=1e-4)


@pytest.mark.parametrize("name", EVOSAX_NAMES)  # our own follow pyribs step by step
def test_every_strategy_learns_from_the_order_it_is_given(name):
    # Ranked by the distance to a far point, the mean comes nearer; told the reverse, it flees.
    dim, batch = 20, 10
    target = jnp.full(dim, 2.0)
    strategy = STRATEGIES[name](dim, batch, 0.3)

    @functools.partial(jax.jit, compiler_options=QUICK)
    def distance(sign):
        start = jnp.zeros((1, dim)), jax.random.split(jax.random.key(0), 1)

        def step(state, key):
            state = strategy.refresh(state)
            solutions, state = jax.vmap(strategy.ask)(state, key[None])
            order = jnp.argsort(sign * jnp.square(solutions - target[None, None]).sum(-1), axis=-1)
            told = solutions, order, jnp.full(1, batch // 2), jnp.full(1, batch)
            return jax.vmap(strategy.tell)(state, *told), None

        state = jax.vmap(strategy.init)(*start)
        state, _ = jax.lax.scan(step, state, jax.random.split(jax.random.key(1), 25))
        means, _ = jax.vmap(strategy.ask)(state, jax.random.split(jax.random.key(2), 1))
        return jnp.linalg.norm(means.mean(axis=1) - target[None])

    away = float(jnp.linalg.norm(target))
    assert float(distance(1.0)) < 0.85 * away
    assert float(distance(-1.0)) > 1.1 * away


@pytest.mark.parametrize("wrap", [jax.jit, lambda function: function], ids=["jit", "plain"])
def test_one_isotropic_step_is_the_arithmetic_of_the_tutorial(wrap):
    # P = 4, b = 4, two parents, sigma 0.5; all by hand from Hansen's table 1 and (38) to (44).
    strategy = STRATEGIES["iso"](4, 4, 0.5)
    solutions = np.array([[1, 0, 0, 0], [0, 2, 0, 0], [9, 9, 9, 9], [-9, 9, 9, 9]], np.float32)
    state = strategy.init(jnp.zeros(4), jax.random.key(0))
    state = wrap(strategy.tell)(state, solutions, jnp.array([1, 0, 3, 2]), 2, 4)
    raw = np.log(2.5) - np.log([1, 2])
    first, second = raw / raw.sum()
    mu_eff = 1 / (first**2 + second**2)
    rate = (mu_eff + 2) / (4 + mu_eff + 5)
    mean = np.array([second, 2 * first, 0, 0])
    path = np.sqrt(rate * (2 - rate) * mu_eff) * mean / 0.5
    damping = 1 + rate  # sqrt((mu_eff - 1) / 5) is below 1
    sigma = 0.5 * np.exp(min(1, rate / damping * (np.square(path).sum() / 4 - 1) / 2))
    np.testing.assert_allclose(state.mean, mean, rtol=1e-6)
    np.testing.assert_allclose(state.path, path, rtol=1e-6)
    np.testing.assert_allclose(state.sigma, sigma, rtol=1e-6)


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
