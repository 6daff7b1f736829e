"""One conformance suite over all registered algorithms, and CMA-MAE's own rules."""

import io
from functools import partial

import chex
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from search_harness import (
    CONFIGS,
    DIM,
    QUICK,
    assert_same,
    compiled,
    extras_of,
    iterate,
    on_host,
    score_of,
)

pytestmark = pytest.mark.slow


@pytest.mark.parametrize("name", CONFIGS)
def test_restored_in_the_middle_equals_uninterrupted_finite_and_is_traced_once(name):
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
    assert sorted(search.traced) == ["ask", "init", "tell"]
    archive = search.algorithm.archive(state)
    filled = np.asarray(archive.filled)
    assert filled.any()
    elites = jax.tree.map(lambda leaf: np.asarray(leaf)[filled], archive)
    chex.assert_tree_all_finite(elites.replace(centroids=archive.centroids))
    if hasattr(state, "emitters"):
        chex.assert_tree_all_finite(state.emitters)


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
    jax.tree.map(partial(np.testing.assert_allclose, rtol=1e-3, atol=1e-3), many, expected)


def test_the_elite_carries_its_own_extras_and_both_objectives_go_their_ways():
    search = compiled(CONFIGS["cma-mae"])
    state = search.init(jax.random.key(0))
    for _ in range(3):
        state = iterate(search, state)
    state = on_host(state)
    learning, archive, store = state.archives
    stored = store.solutions
    filled = archive.objectives > -np.inf
    solutions = stored[archive.genotypes[filled]]
    expected = score_of(solutions).result_objective
    np.testing.assert_array_equal(archive.extra_scores["runs"][filled], solutions[:, :4])
    np.testing.assert_allclose(archive.objectives[filled], expected, rtol=1e-5)
    learnt = learning.objectives > -np.inf
    expected = score_of(stored[learning.genotypes[learnt]]).objective
    np.testing.assert_allclose(learning.objectives[learnt], expected, rtol=1e-5)


def test_arrays_of_a_wrong_shape_are_refused_while_tracing():
    search = compiled(CONFIGS["cma-mae"])
    solutions, state = search.ask(search.init(jax.random.key(0)))
    solutions = np.asarray(solutions)
    score, extras = score_of(solutions), extras_of(solutions)
    tell = search.algorithm.tell
    for wrong in (
        score._replace(objective=score.objective[:, None]),
        score._replace(success=score.success[:-1]),
        score._replace(measures=score.measures[:, :1]),
    ):
        with pytest.raises(AssertionError):
            tell(state, solutions, wrong, extras)
    with pytest.raises(AssertionError):
        tell(state, solutions[:-1], jax.tree.map(lambda leaf: leaf[:-1], score), extras)
