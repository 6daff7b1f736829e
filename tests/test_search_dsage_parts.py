"""The parts of DSAGE against plain numpy: blocks, draws, queues, mutations, the inner loop."""

import functools
import itertools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import stats
from search_harness import QUICK

from qdenv.search.archive import GridArchive
from qdenv.search.base import Problem
from qdenv.search.dsage import (
    block_of_cells,
    blocks_along,
    choose_waiting,
    draw_per_block,
    mutate_tiles,
    random_tiles,
    search_surrogate,
)
from qdenv.search.settings import DsageConfig
from qdenv.types import InputError, Measure, Score

pytestmark = pytest.mark.slow


def axes(*cells):
    return tuple(Measure(f"m{i}", 0, 1, count) for i, count in enumerate(cells))


def fits_evenly(seen):
    """Return whether counts may come from even odds: chi-square, wrong once in 10,000."""
    return stats.chisquare(np.asarray(seen, float)).pvalue > 1e-4


# Cells, blocks, cells of each block: the warehouse's, the manufacturing's and the maze's.
EVEN = [
    ((100, 100), (50, 25), 8),
    ((100, 100), (25, 10), 40),
    ((256, 162), (32, 27), 48),
    ((6, 4, 2), (3, 2, 2), 4),
    ((12,), (4,), 3),
    ((1,), (1,), 1),
]


@pytest.mark.parametrize(("cells", "blocks", "each"), EVEN)
def test_blocks_are_rectangles_of_equal_size_where_they_divide_the_axes(cells, blocks, each):
    block = block_of_cells(axes(*cells), blocks)
    assert (np.bincount(block) == each).all() and block.max() + 1 == np.prod(blocks)
    for cell in (0, len(block) // 3, len(block) - 1):
        place = np.unravel_index(cell, cells)
        row = [i // (c // b) for i, c, b in zip(place, cells, blocks, strict=True)]
        assert block[cell] == np.ravel_multi_index(row, blocks)


@pytest.mark.parametrize(("cells", "blocks"), [((256, 162), (25, 27)), ((10, 7), (4, 3))])
def test_blocks_that_do_not_divide_the_axes_differ_by_one_row_at_most(cells, blocks):
    block = block_of_cells(axes(*cells), blocks).reshape(cells)
    for along in (block[:, 0] // blocks[1], block[0] % blocks[1]):
        sizes = np.bincount(along)
        assert (np.diff(along) >= 0).all() and sizes.max() - sizes.min() <= 1
    assert len(np.unique(block)) == np.prod(blocks)


def test_blocks_are_those_published_unless_wanted_and_never_more_than_cells():
    assert blocks_along(axes(100, 100), ()) == (50, 25)
    assert blocks_along(axes(256, 162), (32, 27)) == (32, 27)
    assert blocks_along(axes(10, 3), (50, 25)) == (10, 3)
    assert blocks_along(axes(1), ()) == (1,)
    assert blocks_along(axes(9, 9, 3), ()) == (4, 2, 1)
    with pytest.raises(InputError, match="give 2 numbers of blocks"):
        blocks_along(axes(100, 100), (50,))


def test_one_filled_cell_of_every_block_that_has_any_is_drawn_each_as_often():
    block = block_of_cells(axes(8, 9), (4, 3))
    filled = np.random.default_rng(0).random(72) < 0.6
    filled[block == 5] = False
    filled[block == 7] = np.arange((block == 7).sum()) == 2
    draw = jax.jit(jax.vmap(lambda key: draw_per_block(key, filled, block)))
    drawn = np.asarray(draw(jax.random.split(jax.random.key(0), 4000)))
    assert not drawn[:, ~filled].any()
    for number in range(12):
        inside = filled & (block == number)
        assert (drawn[:, inside].sum(axis=1) == min(inside.sum(), 1)).all()
        if inside.sum() > 1:
            assert fits_evenly(drawn[:, inside].sum(axis=0))
    nothing = draw_per_block(jax.random.key(0), jnp.zeros(72, bool), block)
    assert not np.asarray(nothing).any()


BATCH, BLOCKS, CELLS = 5, (4, 3), (8, 9)


@functools.cache
def queues(room, cells=CELLS, blocks=BLOCKS):
    """Compile: an archive whose elite of cell c is (c, c), fresh solutions (-1, -number)."""
    block = block_of_cells(axes(*cells), blocks)
    numbers = np.arange(len(block))
    fresh = np.stack([-np.ones(room), -np.arange(room)], axis=1).astype(np.int8)
    blank = GridArchive.empty(jax.ShapeDtypeStruct((2,), jnp.int8), axes(*cells))

    def choose(key, filled):
        archive = blank.replace(
            genotypes=jnp.asarray(np.stack([numbers, numbers], axis=1), jnp.int8),
            fitnesses=jnp.where(filled, 1.0, -jnp.inf)[:, None],
        )
        return choose_waiting(key, archive, block, jnp.asarray(fresh), BATCH)

    return jax.jit(choose), block


@pytest.mark.parametrize("share", [0.0, 0.03, 0.1, 0.5, 1.0])
@pytest.mark.parametrize("room", [15, 100])
def test_whole_batches_wait_drawn_elites_first_and_random_ones_only_in_want(share, room):
    choose, block = queues(room)
    filled = np.random.default_rng(1).random(72) < share
    for seed in range(5):
        queue, waiting = (np.asarray(leaf) for leaf in choose(jax.random.key(seed), filled))
        has = len(np.unique(block[filled]))
        assert waiting == max(-(-has // BATCH), 1) * BATCH <= room
        chosen = queue[:waiting]
        cells = chosen[chosen[:, 0] >= 0, 0].astype(int)
        assert filled[cells].all() and len(np.unique(cells)) == len(cells)
        assert len(cells) == min(waiting, filled.sum())  # others only where the archive is empty
        assert len(np.unique(block[cells[:has]])) == has
        assert len(np.unique(chosen, axis=0)) == waiting


def test_an_archive_of_one_cell_lets_its_elite_wait_once():
    choose, _ = queues(5, (1,), (1,))
    queue, waiting = choose(jax.random.key(0), np.array([True]))
    assert waiting == BATCH
    np.testing.assert_array_equal(queue[:, 0], [0, -1, -1, -1, -1])


def test_those_that_fill_the_last_batch_are_any_of_the_others():
    choose, block = queues(15)
    filled = block < 4  # four blocks of six cells: four are drawn, one more fills the batch
    keys = jax.random.split(jax.random.key(2), 3000)
    many = np.asarray(jax.vmap(lambda key: choose(key, filled)[0])(keys))[:, :BATCH, 0]
    assert fits_evenly(np.bincount(many[:, 4], minlength=72)[filled])


def mutated(parents, choices, mutations):
    mutate = jax.jit(mutate_tiles, static_argnums=(2, 3), compiler_options=QUICK)
    return np.asarray(mutate(jax.random.key(0), jnp.asarray(parents, jnp.int8), choices, mutations))


def test_random_tiles_come_evenly_everywhere():
    tiles = np.asarray(random_tiles(jax.random.key(0), 6000, 4, 5))
    assert tiles.dtype == np.int8 and tiles.shape == (6000, 4)
    assert fits_evenly(np.bincount(tiles.ravel(), minlength=5))
    for one, other in itertools.combinations(range(4), 2):
        assert fits_evenly(np.bincount(5 * tiles[:, one] + tiles[:, other], minlength=25))


@pytest.mark.parametrize(("mutations", "cells"), [(1, 9), (3, 9), (9, 9), (20, 9), (2, 1)])
def test_so_many_different_places_are_drawn_anew_and_others_stay(mutations, cells):
    # Of two tiles a new draw changes half: the changes are binomial in the places.
    most, many = min(mutations, cells), 4000
    parents = np.tile(np.arange(cells) % 2, (many, 1))
    changes = (mutated(parents, 2, mutations) != parents).sum(axis=1)
    assert changes.max() <= most
    error = np.sqrt(most / 4 / many)
    assert abs(changes.mean() - most / 2) < 4 * error
    assert abs((changes == most).mean() - 0.5**most) < 4 * np.sqrt(0.5**most / many)


def test_the_number_of_places_is_geometric_with_mean_two():
    # Parents hold a tile that is never drawn: every place drawn anew shows.
    many, cells = 20_000, 100
    children = mutated(np.full((many, cells), 9), 4, 0)
    changes = (children != 9).sum(axis=1)
    assert abs(changes.mean() - 2) < 4 * np.sqrt(2 / many)  # the variance is 2
    for number in range(1, 6):
        odds = 0.5**number
        assert abs((changes == number).mean() - odds) < 4 * np.sqrt(odds / many)
    assert changes.min() == 1 and changes.max() <= 16
    assert fits_evenly(np.bincount(children[children != 9], minlength=4))
    assert fits_evenly((children != 9).sum(axis=0))
    many_at_once = changes == 3
    assert fits_evenly((children[many_at_once] != 9).sum(axis=0))


def test_few_cells_bound_the_number_of_places():
    changes = (mutated(np.full((4000, 2), 9), 4, 0) != 9).sum(axis=1)
    assert set(changes) == {1, 2} and abs((changes == 1).mean() - 0.5) < 4 * 0.5 / np.sqrt(4000)


# The inner loop: six tiles of three kinds, worth what a known function says of them.
INNER = Problem(6, (Measure("ones", 0, 7, 7), Measure("twos", 0, 7, 7)))
WORTH = np.array([[3, -1, 4, 1, -5, 9]], np.float32)


def worth(solutions, numbers):
    ones = (solutions == 1).astype(np.float32)
    twos = (solutions == 2).astype(np.float32)
    objective = (ones * WORTH - twos * WORTH[:, ::-1]).sum(axis=1) + 20.0
    measures = numbers.stack([ones.sum(axis=1), twos.sum(axis=1)], axis=1)
    return objective, measures, ones[:, 0] + twos[:, 1] < 2  # the last: what counts


def inner_loop(config, record=None):
    def predict(solutions):
        if record is not None:
            jax.debug.callback(lambda rows: record.append(np.array(rows)), solutions, ordered=True)
        objective, measures, success = worth(solutions, jnp)
        # Result objectives are of no interest inside: the sign shows if one was taken.
        return Score(objective, -objective, measures, success)

    run = functools.partial(search_surrogate, config, INNER, 3, predict)
    return jax.jit(run, compiler_options=QUICK)


def test_the_inner_archive_is_that_of_map_elites_replayed_by_hand():
    seen, batch, random = [], 7, 2
    config = DsageConfig(inner_iterations=30, inner_batch=batch, inner_random=random)
    archive = inner_loop(config, seen)(jax.random.key(0))
    jax.effects_barrier()
    assert len(seen) == 30 and all(rows.shape == (batch, 6) for rows in seen)
    best: dict[int, tuple] = {}
    for iteration, rows in enumerate(seen):
        elites = [solution for _, solution in best.values()]
        objective, measures, success = worth(rows, np)
        cells = (measures[:, 0] * 7 + measures[:, 1]).astype(int)
        for row in np.nonzero(success)[0]:
            if cells[row] not in best or objective[row] > best[cells[row]][0]:
                best[cells[row]] = objective[row], rows[row]
        if iteration >= random:  # a child differs from some elite of before in few places
            near = [min((row != elite).sum() for elite in elites) for row in rows]
            assert max(near) <= 6 and np.mean(near) <= 2
    objectives = np.full(49, -np.inf)
    for cell, (objective, solution) in best.items():
        objectives[cell] = objective
        np.testing.assert_array_equal(archive.genotypes[cell], solution)
    np.testing.assert_array_equal(archive.objectives, objectives)
    assert archive.genotypes.dtype == jnp.int8


def test_told_the_truth_the_inner_loop_finds_more_the_longer_it_runs():
    def scores(iterations):
        search = inner_loop(DsageConfig(inner_iterations=iterations, inner_batch=7))
        return np.array([float(search(jax.random.key(seed)).qd_score) for seed in range(5)])

    assert min(scores(64) / scores(4)) > 1.2


def test_an_inner_loop_that_is_told_nothing_ends_with_nothing():
    config = DsageConfig(inner_iterations=5, inner_batch=4)

    def predict(solutions):
        nan = jnp.full(len(solutions), jnp.nan)
        return Score(nan, nan, jnp.stack([nan, nan], axis=1), jnp.ones(len(solutions), bool))

    run = functools.partial(search_surrogate, config, INNER, 3, predict)
    archive = jax.jit(run, compiler_options=QUICK)(jax.random.key(0))
    assert not np.asarray(archive.filled).any()
