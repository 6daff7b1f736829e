"""Distances on demand: every answer is that of a plain search, whatever was asked before."""

import jax.numpy as jnp
import numpy as np
import pytest
from mapf_oracle import numpy_distances

from qdenv.simulation.mapf.distances import goal_distances
from qdenv.simulation.mapf.host.distances import DistanceFields, distance, empty_fields, make_room
from qdenv.simulation.mapf.host.state import GridMap, move_steps
from qdenv.simulation.mapf.planner import UNREACHABLE

SHAPES = {"one page": (30, 41), "many pages": (90, 75)}
GOALS = 12


def grid_of(free: np.ndarray, goals: np.ndarray) -> GridMap:
    """Make a grid with a ring of walls (bool [H', W']) and goals for host code."""
    count, width = len(goals), free.shape[1]
    odds = np.ones((1, count), np.float32)
    return GridMap(free.reshape(-1), goals, odds, np.zeros(1, int), move_steps(width), width, 1)


def random_grid(rng: np.random.Generator, shape: tuple[int, int]) -> GridMap:
    """Draw walls and goals, within a ring of walls."""
    free = np.pad(rng.random((shape[0] - 2, shape[1] - 2)) < 0.7, 1)
    return grid_of(free, rng.choice(np.flatnonzero(free), GOALS).astype(np.int64))


def plain_distances(grid: GridMap) -> np.ndarray:
    """Measure the ways from all goals to all cells one by one (int64 [goals, cells])."""
    free = grid.free.reshape(-1, grid.width)
    return np.stack([numpy_distances(free, goal) for goal in grid.goals])


def ask(
    fields: DistanceFields, grid: GridMap, rng: np.random.Generator, times: int
) -> DistanceFields:
    """Ask for random distances as a run does, with larger buffers whenever they are full."""
    expected = plain_distances(grid)
    for _ in range(times):
        goal, cell = rng.integers(GOALS), rng.choice(np.flatnonzero(grid.free))
        found = distance(fields, grid, goal, cell)
        while fields.numbers.is_full:
            assert found == UNREACHABLE
            fields = make_room(fields, np.array([goal]))
            found = distance(fields, grid, goal, cell)
        assert found == expected[goal, cell]
    return fields


@pytest.mark.parametrize("shape", SHAPES.values(), ids=SHAPES)
def test_every_answer_is_that_of_a_plain_search(shape):
    for seed in range(4):
        rng = np.random.default_rng(seed)
        fields = ask(empty_fields(shape, GOALS, GOALS), random_grid(rng, shape), rng, 500)
        assert not fields.numbers.is_full and (fields.steps[1:] > 0).any()


@pytest.mark.parametrize("shape", SHAPES.values(), ids=SHAPES)
def test_fields_make_room_for_others_and_grow_where_that_is_too_little(shape):
    rng = np.random.default_rng(9)
    fields = ask(empty_fields(shape, GOALS, 2, 5), random_grid(rng, shape), rng, 300)
    held = fields.page != 0
    assert fields.numbers.free_rows == fields.extent.size - (fields.row >= 0).sum()
    assert fields.numbers.free_pages == len(fields.steps) - 1 - held.sum()
    used = np.concatenate([fields.page[held], fields.free_pages[: fields.numbers.free_pages]])
    assert sorted(used) == list(range(1, len(fields.steps)))


def snake() -> np.ndarray:
    """Draw one winding corridor of 257 x 262 cells (bool [259, 264]) within a ring of walls."""
    free = np.zeros((259, 264), bool)
    free[1:-1:2, 1:-1] = True
    free[2:-1:4, -2] = free[4:-1:4, 1] = True
    return free


@pytest.mark.parametrize("reverse", [False, True])
def test_ways_longer_than_a_short_integer_are_counted_in_full(reverse):
    free = snake()
    cells = np.flatnonzero(free)
    goal = int(cells[-1 if reverse else 0])
    grid = grid_of(free, np.array([goal]))
    expected = plain_distances(grid)[0]
    assert expected[free.reshape(-1)].max() == free.sum() - 1 == 33_925
    fields = empty_fields(free.shape, 1, 1, pages=1000)
    found = [distance(fields, grid, 0, cell) for cell in cells[:: 7 if reverse else -7]]
    np.testing.assert_array_equal(found, expected[cells[:: 7 if reverse else -7]])


@pytest.mark.slow
def test_xla_measures_large_grids_with_longer_integers():
    free = snake()
    free[16:] = False  # a part of it, which XLA fills in a second
    cells, walls = np.flatnonzero(free), np.flatnonzero(~free)
    (found,) = goal_distances(jnp.asarray(free), jnp.array([cells[0]]), jnp.array([True]))
    expected = plain_distances(grid_of(free, np.array([cells[0]])))[0]
    assert found.dtype == jnp.int32 and expected[cells].max() == cells.size - 1
    np.testing.assert_array_equal(found[cells], expected[cells])
    assert (found[walls] > free.size).all()


@pytest.mark.slow
def test_distances_are_right_on_a_thousand_rows_and_columns():
    rng = np.random.default_rng(4)
    free = np.pad(rng.random((1000, 1000)) < 0.9, 1)
    free[1, 1] = free[1000, 1000] = True
    grid = grid_of(free, np.array([1002 + 1]))
    (far,) = plain_distances(grid)
    fields = empty_fields(free.shape, 1, 1, pages=5000)
    cells = [1000 * 1002 + 1000, *rng.choice(np.flatnonzero(far < UNREACHABLE), 300)]
    assert [distance(fields, grid, 0, cell) for cell in cells] == far[cells].tolist()
    walled_in = np.flatnonzero(free.reshape(-1) & (far == UNREACHABLE))
    assert walled_in.size and distance(fields, grid, 0, walled_in[0]) > free.size


def test_a_first_question_measures_little_of_a_large_grid():
    shape = (401, 401)
    free = np.pad(np.ones((399, 399), bool), 1)
    goal, near = 200 * 401 + 200, 210 * 401 + 215
    grid = grid_of(free, np.array([goal]))
    fields = empty_fields(shape, 1, 1, pages=700)
    assert distance(fields, grid, 0, near) == 25
    assert 0 < (fields.page != 0).sum() <= 0.05 * fields.page.size
    assert distance(fields, grid, 0, 401 + 1) == 199 + 199
    assert (fields.page != 0).mean() < 0.4  # the goal lies in the middle: a quarter, and a rim
    corners = (401 + 399, 399 * 401 + 1, 399 * 401 + 399)
    assert [distance(fields, grid, 0, cell) for cell in corners] == [398] * 3
    assert (fields.page != 0).sum() == 25 * 25  # of the other tiles all cells are walls
