"""One conformance suite over all registered algorithms and strategies, and CMA-MAE's own rules."""

import dataclasses
import functools
import io
from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from qdenv.search.archive import GridArchive, Insertion
from qdenv.search.base import Algorithm
from qdenv.search.cma_mae import CmaMaeConfig, cma_mae
from qdenv.search.emitters import is_flat, rank, restart_rule
from qdenv.search.registry import ALGORITHMS, Entry, make_algorithm
from qdenv.search.strategies.evosax import EVOSAX_NAMES
from qdenv.search.strategies.full import full
from qdenv.search.strategies.registry import STRATEGIES
from qdenv.types import InputError, Measure, Score

DIM = 12
GRID = (Measure("x", -1, 1, 8), Measure("y", -1, 1, 9))
QUICK = {"xla_backend_optimization_level": 0}  # these searches compile longer than they run
EXTRAS = {"layout": np.zeros((2, 3), np.int8), "runs": np.zeros(4, np.float32)}
CONFIGS = {name: entry.config() for name, entry in ALGORITHMS.items()} | {
    f"cma-mae with {name}": CmaMaeConfig(emitters=2, batch=6, strategy=name)
    for name in ("full", "lm_ma", "SNES")
}


class Compiled(NamedTuple):
    """An algorithm with jitted functions and the names of those that were traced."""

    algorithm: Algorithm
    init: Callable
    ask: Callable
    tell: Callable
    traced: list


@functools.cache
def compiled(config):
    algorithm, traced = make_algorithm(config, DIM, GRID, EXTRAS), []

    def jit(name, donate=()):
        def call(*args):
            traced.append(name)
            return getattr(algorithm, name)(*args)

        return jax.jit(call, donate_argnums=donate, compiler_options=QUICK)

    return Compiled(algorithm, jit("init"), jit("ask"), jit("tell", 0), traced)


def score_of(solutions, success=None, numbers=np):
    """Score the negative sphere around 0.3 over the first two parameters."""
    objective = 5 - numbers.square(solutions - 0.3).sum(axis=-1)
    success = numbers.ones(len(solutions), bool) if success is None else success
    return Score(objective, objective - 1, solutions[:, :2], success)


def extras_of(solutions, numbers=np):
    layouts = (numbers.abs(solutions[:, :6]) * 10).astype(np.int8).reshape(-1, 2, 3)
    return {"layout": layouts, "runs": solutions[:, :4]}


def iterate(search, state, change=lambda score: score):
    """Run one iteration with the evaluation on the host."""
    solutions, state = search.ask(state)
    solutions = np.asarray(solutions)
    return search.tell(state, solutions, change(score_of(solutions)), extras_of(solutions))


def on_host(tree):
    """Copy a state off the device: the original may be donated."""
    return jax.tree.map(lambda leaf: np.array(leaf), tree)


def assert_same(left, right):
    for one, other in zip(jax.tree.leaves(left), jax.tree.leaves(right), strict=True):
        np.testing.assert_array_equal(one, other)


@pytest.mark.parametrize("name", CONFIGS)
def test_restored_in_the_middle_equals_uninterrupted(name):
    search = compiled(CONFIGS[name])
    state = search.init(jax.random.key(3))
    for iteration in range(6):
        if iteration == 3:
            leaves, structure = jax.tree.flatten(state)
            file = io.BytesIO()
            np.savez(file, **{str(i): np.asarray(leaf) for i, leaf in enumerate(leaves)})
            file.seek(0)
            saved = np.load(file, allow_pickle=False)
            restored = jax.tree.unflatten(structure, [saved[str(i)] for i in range(len(leaves))])
        state = iterate(search, state)
    for _ in range(3):
        restored = iterate(search, restored)
    assert_same(state, restored)
    assert search.algorithm.archive(state).coverage > 0


@pytest.mark.parametrize("name", CONFIGS)
def test_failures_leave_no_trace_and_no_nan(name):
    search = compiled(CONFIGS[name])
    size = search.algorithm.batch_size
    nothing = np.zeros(size, bool)
    bad = np.full(size, np.nan, np.float32)
    kinds = [
        lambda s: s._replace(success=nothing),
        lambda s: s._replace(objective=bad),
        lambda s: s._replace(result_objective=np.full_like(bad, np.inf)),
        lambda s: s._replace(measures=np.full((size, 2), -np.inf, np.float32)),
    ]
    some = lambda s: s._replace(success=np.arange(size) % 3 == 0)  # noqa: E731
    state = search.init(jax.random.key(0))
    filled = 0
    for kind in (*kinds, some, *kinds):
        state = iterate(search, state, kind)
        for leaf in jax.tree.leaves(state):
            assert not np.isnan(np.asarray(leaf)).any()
        solutions, state = search.ask(state)
        assert solutions.shape == (size, DIM) and np.isfinite(solutions).all()
        archive = search.algorithm.archive(state)
        gained, filled = np.asarray(archive.filled).sum() - filled, np.asarray(archive.filled).sum()
        assert 0 < gained <= (size + 2) // 3 if kind is some else gained == 0


@pytest.mark.parametrize("name", CONFIGS)
def test_nothing_is_traced_twice(name):
    search = compiled(CONFIGS[name])
    state = search.init(jax.random.key(9))
    for _ in range(2):
        state = iterate(search, state)
    assert sorted(search.traced) == ["ask", "init", "tell"]


@pytest.mark.parametrize("name", ["cma-mae", "map-elites"])
def test_scan_and_vmap_over_seeds_equal_the_plain_loop(name):
    search = compiled(CONFIGS[name])
    algorithm = search.algorithm
    keys = jax.random.split(jax.random.key(1), 2)
    looped = []
    for key in keys:
        state = search.init(key)
        for _ in range(4):
            state = iterate(search, state)
        looped.append(on_host(algorithm.archive(state)))

    def run(key):
        def step(state, _):
            solutions, state = algorithm.ask(state)
            score = score_of(solutions, numbers=jnp)
            return algorithm.tell(state, solutions, score, extras_of(solutions, jnp)), None

        return algorithm.archive(jax.lax.scan(step, algorithm.init(key), None, 4)[0])

    many = jax.jit(jax.vmap(run), compiler_options=QUICK)(keys)
    expected = jax.tree.map(lambda *rows: np.stack(rows), *looped)
    for one, other in zip(jax.tree.leaves(many), jax.tree.leaves(expected), strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-3, atol=1e-3)


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


def test_the_elite_carries_its_own_extras_and_both_objectives_go_their_ways():
    search = compiled(CONFIGS["cma-mae"])
    state = search.init(jax.random.key(0))
    for _ in range(3):
        state = iterate(search, state)
    state = on_host(state)
    archive, learning = state.result, state.learning
    filled = archive.objectives > -np.inf
    solutions = archive.genotypes[filled]
    expected = score_of(solutions).result_objective
    np.testing.assert_array_equal(archive.extra_scores["runs"][filled], solutions[:, :4])
    np.testing.assert_allclose(archive.objectives[filled], expected, rtol=1e-5)
    learnt = learning.objectives > -np.inf
    expected = score_of(learning.genotypes[learnt]).objective
    np.testing.assert_allclose(learning.objectives[learnt], expected, rtol=1e-5)


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
            order = jnp.argsort(sign * jnp.square(solutions - target).sum(-1), axis=-1)
            told = solutions, order, jnp.full(1, batch // 2), jnp.full(1, batch)
            return jax.vmap(strategy.tell)(state, *told), None

        state = jax.vmap(strategy.init)(*start)
        state, _ = jax.lax.scan(step, state, jax.random.split(jax.random.key(1), 25))
        means, _ = jax.vmap(strategy.ask)(state, jax.random.split(jax.random.key(2), 1))
        return jnp.linalg.norm(means.mean(axis=1) - target)

    away = float(jnp.linalg.norm(target))
    assert float(distance(1.0)) < 0.85 * away
    assert float(distance(-1.0)) > 1.1 * away


def test_a_masked_row_changes_nobodys_rank():
    rng = np.random.default_rng(0)
    values, status = rng.normal(size=12), rng.integers(0, 3, 12)
    values[5] = values[7]  # a tie
    for masked in range(12):
        usable = np.arange(12) != masked
        poisoned = np.where(usable, values, -np.inf)
        for keys, kept in (
            ((poisoned,), (values[usable],)),
            ((np.where(usable, status, 0), poisoned), (status[usable], values[usable])),
        ):
            order = np.asarray(rank(keys, jnp.asarray(usable)))
            assert order[-1] == masked
            alone = np.flatnonzero(usable)[np.asarray(rank(kept, jnp.ones(11, bool)))]
            np.testing.assert_array_equal(order[:-1], alone)


def test_flat_rankings_are_noticed_among_successes_only():
    order = jnp.arange(4)
    flat = jnp.array([1.0, 1.0, 1.0, -jnp.inf])
    assert bool(is_flat((flat,), order, jnp.int32(3)))
    assert not bool(is_flat((flat,), order, jnp.int32(4)))
    assert not bool(is_flat((flat,), order, jnp.int32(1)))
    assert not bool(is_flat((jnp.array([2, 1, 1, 1]), jnp.ones(4)), order, jnp.int32(4)))


def test_failed_rows_that_were_no_parents_anyway_do_not_move_the_search():
    search = compiled(CONFIGS["cma-mae"])
    solutions, state = search.ask(search.init(jax.random.key(0)))
    solutions, state = np.asarray(solutions), on_host(state)
    score = score_of(solutions)
    ranks = score.objective.reshape(5, 10).argsort(axis=1).argsort(axis=1)
    success = (ranks >= 4).reshape(-1)  # the worst four of each emitter fail
    means = [
        np.asarray(search.tell(state, solutions, which, extras_of(solutions)).emitters.strategy[0])
        for which in (score, score._replace(success=success))
    ]
    np.testing.assert_array_equal(*means)


def test_one_emitter_of_batch_one_restarts_from_x0_while_there_is_no_elite():
    search = compiled(CmaMaeConfig(emitters=1, batch=1))
    state = search.init(jax.random.key(0))
    for _ in range(4):
        state = iterate(search, state, lambda score: score._replace(success=np.zeros(1, bool)))
        np.testing.assert_array_equal(state.emitters.strategy.mean[0], np.zeros(DIM))
    assert state.emitters.restarts.tolist() == [4]
    state = iterate(search, state)
    assert int(state.result.filled.sum()) == 1


def test_restart_rules():
    accepted = np.array([0, 3])
    rules = [(restart_rule(rule), rule) for rule in ("no_improvement", "basic", 4)]
    for iteration in (3, 4, 8):
        got = {rule: decide(accepted, iteration).tolist() for decide, rule in rules}
        due = iteration % 4 == 0
        expected = {"no_improvement": [True, False], "basic": [False] * 2, 4: [due] * 2}
        assert got == expected


def test_restarts_stand_on_an_elite_with_a_fresh_distribution():
    search = compiled(CmaMaeConfig(emitters=3, batch=4, restart=3))
    state = search.init(jax.random.key(5))
    for _ in range(3):
        state = iterate(search, state)
    state = on_host(state)
    elites = state.learning.genotypes[state.learning.fitnesses[:, 0] > -np.inf]
    for mean in state.emitters.strategy.mean:
        assert (elites == mean).all(axis=1).any()
    np.testing.assert_allclose(state.emitters.strategy.sigma, 0.2)
    assert not state.emitters.strategy.path.any()


def test_a_users_algorithm_plugs_in_by_name(monkeypatch):
    @dataclasses.dataclass(frozen=True)
    class RingConfig:
        radius: float = 0.5

    def ring(config, solution_dim, measures, extras=None):
        def init(key):
            return GridArchive.empty(jnp.zeros(solution_dim), measures, extras)

        def ask(archive):
            angle = jnp.linspace(0, 6, 4)[:, None] + jnp.arange(solution_dim)
            return config.radius * jnp.sin(angle), archive

        def tell(archive, solutions, score, extras):
            place = solutions, score.result_objective, score.measures
            return archive.insert(*place, extras, score.success)[0]

        return Algorithm(init, ask, tell, lambda archive: archive, 4)

    monkeypatch.setitem(ALGORITHMS, "ring", Entry(RingConfig, ring))
    search = compiled(RingConfig(radius=0.7))
    state = iterate(search, search.init(jax.random.key(0)))
    assert int(search.algorithm.archive(state).filled.sum()) == 4


def test_a_users_strategy_plugs_in_by_name(monkeypatch):
    monkeypatch.setitem(STRATEGIES, "mine", lambda dim, batch, s: STRATEGIES["iso"](dim, batch, 1))
    algorithm = make_algorithm(CmaMaeConfig(strategy="mine"), DIM, GRID)
    solutions, _ = algorithm.ask(algorithm.init(jax.random.key(0)))
    assert 0.9 < float(solutions.std()) < 1.1


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"emitters": 0}, "emitters must be a positive"),
        ({"sigma0": float("nan")}, "sigma0"),
        ({"ranker": "best"}, "unknown ranker 'best': choose one of imp"),
        ({"selection": "all"}, "unknown selection"),
        ({"strategy": "LM_MA_ES"}, "unknown strategy"),
        ({"restart": 0}, "restart"),
        ({"restart": "sometimes"}, "restart"),
        ({"learning_rate": 2.0}, "learning rate"),
        ({"strategy": "lm_ma", "batch": 99}, "batch of at most 12"),
        ({"strategy": "Open_ES", "batch": 5}, "even batch"),
    ],
)
def test_bad_settings_give_one_clear_line(change, message):
    with pytest.raises(InputError, match=message):
        make_algorithm(dataclasses.replace(CmaMaeConfig(), **change), DIM, GRID)


def test_an_unregistered_config_and_a_wrong_start_give_one_clear_line():
    with pytest.raises(InputError, match="choose from cma-mae"):
        make_algorithm(Insertion(0, 0), DIM, GRID)
    with pytest.raises(InputError, match="x0"):
        cma_mae(CmaMaeConfig(), DIM, GRID, x0=np.zeros(3))
