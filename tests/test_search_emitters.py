"""Emitters: ranking, failures, restarts."""

import jax
import jax.numpy as jnp
import numpy as np
from search_harness import CONFIGS, DIM, compiled, extras_of, iterate, on_host, score_of

from qdenv.search.cma_mae import CmaMaeConfig, is_flat, rank, restart_rule


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
        np.asarray(
            search.tell(state, solutions, which, extras_of(solutions)).emitters.strategy.mean
        )
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
    assert int(state.archives.result.filled.sum()) == 1


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
    learning = state.archives.learning
    rows = learning.genotypes[learning.fitnesses[:, 0] > -np.inf]
    elites = state.archives.store.solutions[rows]
    for mean in state.emitters.strategy.mean:
        assert (elites == mean).all(axis=1).any()
    np.testing.assert_allclose(state.emitters.strategy.std, 0.2)
    assert not state.emitters.strategy.p_std.any()
