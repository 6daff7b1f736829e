"""DSAGE as a whole on a toy of 6 x 6 tiles: better than chance, resumable, deaf to failures."""

import functools
from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from search_harness import QUICK, assert_same, compile_search

from qdenv.search import base
from qdenv.search.base import Problem
from qdenv.search.dsage import dsage
from qdenv.search.settings import DsageConfig
from qdenv.surrogates.settings import SurrogateConfig
from qdenv.types import Encoding, InputError, Measure, Score

pytestmark = pytest.mark.slow

SIDE, KINDS = 6, 3
BATCH = 8
COUNTS = (Measure("ones", 0, 36, 12), Measure("twos", 0, 36, 12))


def encoding(rows, cols, **stages):
    def draw(solutions):
        return jnp.asarray(solutions, jnp.int8).reshape(-1, rows, cols)

    return Encoding((rows, cols), KINDS, draw=draw, choices=KINDS, **stages)


TOY = Problem(SIDE**2, COUNTS, {"runs": np.zeros(2, np.float32)}, encoding(SIDE, SIDE))
CONFIG = DsageConfig(
    batch=BATCH,
    initial=2 * BATCH,
    inner_iterations=100,
    inner_batch=32,
    downsample=(6, 6),
    surrogate=SurrogateConfig(channels=8, epochs=10, minibatch=32, samples=256),
)

SMALLEST = SurrogateConfig(channels=1, blocks=0, epochs=1, minibatch=3, samples=1)


@functools.cache
def toy():
    return compile_search(CONFIG, TOY, donated=())  # states are used again


def score_of(solutions):
    """Like ones to the left and twos at the top: 0 at worst, 36 at best."""
    layouts = np.asarray(solutions).reshape(-1, SIDE, SIDE)
    right, down = np.meshgrid(np.linspace(0, 1, SIDE), np.linspace(0, 1, SIDE))
    objective = np.where(layouts == 1, 1 - right, np.where(layouts == 2, 1 - down, 0.5))
    objective = objective.sum(axis=(1, 2)).astype(np.float32)
    ones, twos = ((layouts == kind).sum(axis=(1, 2)) for kind in (1, 2))
    measures = np.stack([ones, twos], axis=1).astype(np.float32)
    return Score(objective + 1, objective, measures, np.ones(len(layouts), bool))


def iterate(search, state, change=lambda score: score):
    solutions, state = search.ask(state)
    solutions = np.asarray(solutions)
    assert np.isin(solutions, np.arange(KINDS)).all()
    return search.tell(state, solutions, change(score_of(solutions)), {"runs": solutions[:, :2]})


def best_of_cells(score):
    """Sum the best result objective of every cell, by a dictionary."""
    best: dict[tuple, float] = {}
    for objective, measures in zip(score.result_objective, score.measures, strict=True):
        cell = tuple(np.minimum(measures // 3, 11))
        best[cell] = max(best.get(cell, 0), float(objective))
    return sum(best.values())


def test_dsage_beats_chance_at_equal_true_evaluations():
    search, iterations = toy(), 40
    found, chance, learnt = [], [], []
    for seed in range(3):
        state, told = search.init(jax.random.key(seed)), []
        for iteration in range(iterations):
            notes = search.algorithm.notes(state)
            if iteration < 3:  # the third ask is the first that thinks
                assert all(np.isnan(value) for name, value in notes.items() if name != "fits")
            solutions, state = search.ask(state)
            told.append(np.asarray(solutions))
            state = search.tell(state, told[-1], score_of(told[-1]), {"runs": told[-1][:, :2]})
        archive = search.algorithm.archive(state)
        everything = score_of(np.concatenate(told))
        np.testing.assert_allclose(archive.qd_score, best_of_cells(everything), rtol=1e-5)
        found.append(float(archive.qd_score))
        random = np.random.default_rng(seed).integers(0, KINDS, (iterations * BATCH, SIDE**2))
        chance.append(best_of_cells(score_of(random)))
        notes = search.algorithm.notes(state)
        learnt.append([float(notes["r2_result"]), float(notes["r2_ones"]), float(notes["fits"])])
        assert np.isfinite(list(notes.values())).all()
    # Measured: 2.0 to 2.2 times as much; 0.97 and more explained, of batches not learnt yet.
    assert min(np.array(found) / np.array(chance)) > 1.7
    assert np.min(learnt, axis=0)[:2].min() > 0.8
    assert sorted(search.traced) == ["ask", "init", "tell"]  # though it thought many times


def test_resumed_anywhere_in_an_outer_loop_it_goes_on_bit_for_bit():
    search = toy()
    states = [search.init(jax.random.key(5))]
    for _ in range(30):
        states.append(iterate(search, states[-1]))
    waiting = np.array([int(state.waiting) for state in states])
    before_thinking, between = np.nonzero(waiting == 0)[0], np.nonzero(waiting)[0]
    assert before_thinking[-1] > 2 and between[-1] > 2  # beyond the random solutions, too
    for begin in (0, 1, *before_thinking[-3:], *between[-3:]):
        # As a checkpoint keeps it: arrays off the device, and back.
        restored = jax.tree.map(lambda leaf: jnp.asarray(np.array(leaf)), states[begin])
        expected = states[begin + 1] if begin < 30 else iterate(search, states[begin])
        assert_same(iterate(search, restored), expected)


def test_an_iteration_asked_for_twice_is_the_same():
    search = toy()
    state = search.init(jax.random.key(6))
    for _ in range(4):
        again = search.ask(state)
        assert_same(search.ask(state), again)
        state = iterate(search, state)


def test_what_failed_rows_hold_teaches_nothing():
    search, failed = toy(), np.arange(BATCH) % 3 == 1

    def spoilt(garbage):
        def change(score):
            objective = np.where(failed, garbage, score.objective)
            measures = np.where(failed[:, None], garbage, score.measures)
            return Score(objective, objective - 1, measures, ~failed)

        return change

    one = other = search.init(jax.random.key(7))
    for _ in range(4):
        one, other = iterate(search, one, spoilt(np.nan)), iterate(search, other, spoilt(1e30))
    # Which row was last written for which cell may differ where no elite lies.
    assert_same(one._replace(archives=0), other._replace(archives=0))
    assert_same(search.algorithm.archive(one), search.algorithm.archive(other))
    assert int(one.model.ring.known) == 4 * (~failed).sum() and int(one.model.fitted.fits) > 0
    told = np.asarray(one.model.ring.samples.numbers)[: int(one.model.ring.known), 1]
    truth = score_of(np.asarray(one.model.ring.samples.drawn)[: int(one.model.ring.known)])
    np.testing.assert_allclose(told, truth.result_objective, atol=1e-6)


def test_when_all_evaluations_fail_it_goes_on_with_random_tiles():
    search = toy()
    state = search.init(jax.random.key(8))
    nothing = np.zeros(BATCH, bool)
    for _ in range(6):
        before = np.asarray(state.queue)
        state = iterate(search, state, lambda score: score._replace(success=nothing))
        assert int(state.model.ring.known) == int(state.model.fitted.fits) == 0
        assert int(state.waiting) % BATCH == 0
        assert all(np.isfinite(leaf).all() for leaf in jax.tree.leaves(state.model.fitted))
    assert (np.asarray(state.queue) != before).any()
    notes = search.algorithm.notes(state)
    assert all(np.isnan(value) for name, value in notes.items() if name != "fits")
    state = iterate(search, iterate(search, state))
    assert int(state.model.fitted.fits) > 0 and search.algorithm.archive(state).filled.any()


def test_a_store_that_grows_changes_nothing(monkeypatch):
    monkeypatch.setattr(base, "_FIRST_ROWS", 18)
    # Compiled as the other: bits depend on how much is optimised.
    monkeypatch.setattr(jax, "jit", functools.partial(jax.jit, compiler_options=QUICK))
    plain, grown = toy(), base.growing(toy().algorithm)
    one, other = plain.init(jax.random.key(0)), grown.init(jax.random.key(0))
    sizes = []
    for _ in range(5):
        solutions, one = plain.ask(one)
        again, other = grown.ask(other)
        np.testing.assert_array_equal(solutions, again)
        solutions = np.asarray(solutions)
        told = solutions, score_of(solutions), {"runs": solutions[:, :2]}
        one, other = plain.tell(one, *told), grown.tell(other, *told)
        sizes.append(len(other.archives.store.used))
        assert_same(plain.algorithm.archive(one), grown.archive(other))
        assert_same(one._replace(archives=0), other._replace(archives=0))
    assert (
        sizes[0] < sizes[-1] < len(one.archives.store.used)
    )  # it did grow, and holds less than it might


# Everything small, or the wrong way round: (settings, tiles, cells of the measures, stages).
ODD = {
    "one tile, one cell": (
        DsageConfig(batch=3, initial=1, inner_iterations=2, inner_batch=1, downsample=(50,)),
        (1, 1),
        (1,),
        (),
    ),
    "three measures": (
        DsageConfig(batch=2, initial=5, inner_iterations=1, inner_batch=5, mutations=99),
        (2, 3),
        (4, 3, 2),
        ("usage",),
    ),
}


@pytest.mark.parametrize("name", ODD)
def test_searches_of_odd_sizes_end_and_stay_finite(name):
    config, shape, cells, stages = ODD[name]
    measures = tuple(Measure(f"m{i}", 0, 1, count) for i, count in enumerate(cells))
    tiles = encoding(*shape, **dict.fromkeys(stages, True))
    problem = Problem(int(np.prod(shape)), measures, None, tiles)
    config = replace(config, surrogate=SMALLEST)
    search = compile_search(config, problem)
    state = search.init(jax.random.key(0))
    for number in range(9):
        solutions, state = search.ask(state)
        solutions = np.asarray(solutions)
        assert solutions.shape == (config.batch, problem.solution_dim)
        assert np.isin(solutions, np.arange(KINDS)).all()
        objective = solutions.sum(axis=1)
        axes = np.stack([objective / (2 + place) for place in range(len(cells))], axis=1) % 1
        extras = {"usage": np.full((config.batch, *shape), 1 / problem.solution_dim, np.float32)}
        extras["usage"][number % config.batch] = np.nan  # this map is no reason to learn nothing
        success = np.arange(config.batch) != number % 4
        state = search.tell(state, solutions, Score(objective, objective, axes, success), extras)
        for leaf in jax.tree.leaves(state._replace(archives=0)):
            assert np.isfinite(leaf).all()
    assert int(state.model.fitted.fits) >= 1 and int(state.model.ring.known) == 1
    assert search.algorithm.archive(state).filled.any()
    assert sorted(search.traced) == ["ask", "init", "tell"]


def test_what_has_no_tiles_or_a_start_is_refused():
    for choices in (0, 1):
        with pytest.raises(InputError, match="its generator is direct"):
            dsage(CONFIG, TOY._replace(encoding=TOY.encoding._replace(choices=choices)))
    with pytest.raises(InputError, match="encode none"):
        dsage(CONFIG, TOY._replace(encoding=None))
    with pytest.raises(InputError, match="leave the start out"):
        dsage(CONFIG, TOY, np.zeros(SIDE**2))
    with pytest.raises(InputError, match="give 2 numbers of blocks"):
        dsage(DsageConfig(downsample=(3,)), TOY)
