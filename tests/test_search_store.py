"""One store for several archives: what is in it, how large it is, and what it never copies."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from search_harness import CONFIGS, EXTRAS, GRID, PROBLEM, extras_of, iterate, score_of

from qdenv.search import base
from qdenv.search.archive import GridArchive
from qdenv.search.base import ROW, Problem, Store, StoredArchive, collector
from qdenv.search.cma_mae import CmaMaeConfig
from qdenv.search.map_elites import MapElitesConfig
from qdenv.search.registry import make_algorithm

BATCH = 7
SEARCHES = {name: CONFIGS[name] for name in ("cma-mae", "cma-me", "random")} | {
    "map-elites": MapElitesConfig(emitters=2, batch=6, sigma_iso=0.3)
}


def search(algorithm):
    state = algorithm.init(jax.random.key(2))
    for _ in range(5):
        state = iterate(algorithm, state)
    return state


@pytest.mark.slow
def test_archives_of_rows_hold_what_archives_of_solutions_hold():
    soft = {"learning_rate": 0.1, "threshold_min": 0.0}
    dense = [GridArchive.empty(np.zeros(3, np.float32), GRID, None, **soft)]
    dense += [GridArchive.empty(np.zeros(3, np.float32), GRID)]
    rows = [GridArchive.empty(ROW, GRID, None, **soft), GridArchive.empty(ROW, GRID)]
    store = Store.empty(jnp.zeros(3), BATCH, *rows)
    assert len(store.used) == 1 + BATCH + 2 * 8 * 9
    add = jax.jit(lambda archive, *batch: archive.insert(*batch)[0])
    rng = np.random.default_rng(0)
    for _ in range(80):
        solutions = rng.normal(size=(BATCH, 3)).astype(np.float32)
        measures = rng.uniform(-1, 1, (BATCH, 2)).astype(np.float32)
        both = rng.normal(size=(2, BATCH)).astype(np.float32)  # each archive has its objective
        free = store.free_rows(BATCH)
        assert not np.asarray(store.used)[np.asarray(free)].any() and len(set(free.tolist())) == 7
        given = list(zip(dense, both, strict=True))
        dense = [add(archive, solutions, objective, measures) for archive, objective in given]
        given = list(zip(rows, both, strict=True))
        rows = [add(archive, free, objective, measures) for archive, objective in given]
        store = store.write(free, solutions, rows[0].cells_of(measures), *rows)
    for one, other in zip(dense, rows, strict=True):
        np.testing.assert_array_equal(
            one.genotypes, StoredArchive(None, other, store).dense().genotypes
        )
    # Every solution is there once, and nothing else is.
    distinct = {row.tobytes() for archive in dense for row in np.asarray(archive.genotypes)}
    assert int(store.used.sum()) == len(distinct)  # zeros, the row of empty cells, among them


@pytest.mark.slow
@pytest.mark.parametrize("name", SEARCHES)
def test_a_growing_search_finds_the_same_bit_for_bit(name, monkeypatch):
    monkeypatch.setattr(base, "_FIRST_ROWS", 1)
    algorithm = make_algorithm(SEARCHES[name], PROBLEM)
    found_by = base.growing(algorithm)
    ask, tell = jax.jit(algorithm.ask), jax.jit(algorithm.tell)
    small, full = search(found_by), search(algorithm._replace(ask=ask, tell=tell))
    store, most = small.archives.store, len(full.archives.store.used)
    rows, used = len(store.used), int(store.used.sum())
    assert used <= rows < min(most, 2 * (used + algorithm.batch_size))
    grown = small._replace(archives=small.archives._replace(store=store.resized(most)))
    jax.tree.map(np.testing.assert_array_equal, grown, full)
    columns, expected = collector(found_by)(small), algorithm.archive(full).elites()
    assert columns.keys() == expected.keys() and len(columns["index"]) > 3
    for column, values in expected.items():
        assert columns[column].tobytes() == values.tobytes() and values.ndim == columns[column].ndim


@pytest.mark.slow
def test_a_store_grows_to_its_full_size_and_no_further(monkeypatch):
    monkeypatch.setattr(base, "_FIRST_ROWS", 1)
    algorithm = base.growing(make_algorithm(CmaMaeConfig(), PROBLEM))
    state, sizes = algorithm.init(jax.random.key(0)), set()
    rng = np.random.default_rng(1)
    for number in range(12):
        solutions, state = algorithm.ask(state)
        score = score_of(np.array(solutions))
        places = rng.uniform(-1, 1, (50, 2)).astype(np.float32)
        # The two archives want the opposite, so they share next to nothing.
        rising = np.full(50, number, np.float32) + rng.uniform(size=50).astype(np.float32)
        score = score._replace(objective=rising, result_objective=-rising, measures=places)
        state = algorithm.tell(state, solutions, score, extras_of(np.array(solutions)))
        sizes.add(len(state.archives.store.used))
    assert sizes == {51, 102, 195}  # 195 = 1 + 50 + 2 * 72


def test_nothing_ever_holds_a_solution_for_every_cell():
    size = 4096
    algorithm = make_algorithm(CmaMaeConfig(), Problem(size, GRID, EXTRAS))
    dense = 4 * size * 8 * 9
    key = jax.random.key(0)
    running = base.growing(algorithm)
    state = jax.eval_shape(algorithm.init, key)

    def workspace(function, *given):
        return jax.jit(function).lower(*given).compile().memory_analysis().temp_size_in_bytes

    assert workspace(running.init, key) < dense / 10
    # What the progress of a run and its files ask of an archive.
    assert workspace(lambda state: algorithm.archive(state).qd_score, state) < dense / 10

    def take(state, cells):
        return jax.tree.map(lambda leaf: leaf[cells], algorithm.archive(state))

    assert workspace(take, state, jnp.arange(4)) < dense / 10
