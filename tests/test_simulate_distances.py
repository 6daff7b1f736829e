"""Distances on demand: every answer is that of a plain search, whatever was asked before."""

import numpy as np
import pytest
from scipy.sparse import csr_array
from scipy.sparse.csgraph import shortest_path

from qdenv.simulate.mapf.host.fields import PAGES, ROWS, Fields, empty_fields, make_room
from qdenv.simulate.mapf.host.measure import distance, lacks_room
from qdenv.simulate.mapf.host.site import Site
from qdenv.simulate.mapf.planner import UNREACHABLE

SHAPES = {"one page": (30, 41), "many pages": (90, 75)}
GOALS = 12


def random_site(rng: np.random.Generator, shape: tuple[int, int]) -> Site:
    """Draw walls and goals, within a ring of walls."""
    free = np.pad(rng.random((shape[0] - 2, shape[1] - 2)) < 0.7, 1).reshape(-1)
    goals = rng.choice(np.flatnonzero(free), GOALS).astype(np.int64)
    steps = np.array([0, 1, -1, shape[1], -shape[1]])
    return Site(free, goals, np.ones((1, GOALS), np.float32), np.zeros(1, int), steps, shape[1], 1)


def plain_distances(site: Site) -> np.ndarray:
    """Measure the ways from all goals to all cells by scipy (int64 [goals, cells])."""
    cells = np.arange(site.free.size)
    pairs = [
        (cell, cell + step)
        for step in (1, site.width)
        for cell in cells[: -site.width]
        if site.free[cell] and site.free[cell + step]
    ]
    start, end = np.array(pairs).T
    graph = csr_array((np.ones(len(pairs)), (start, end)), (cells.size, cells.size))
    far = shortest_path(graph, directed=False, unweighted=True, indices=site.goals)
    return np.where(np.isinf(far), UNREACHABLE, far).astype(int)


def ask(fields: Fields, site: Site, rng: np.random.Generator, times: int) -> Fields:
    """Ask for random distances as a run does, with more room whenever that is wanting."""
    expected = plain_distances(site)
    for _ in range(times):
        goal, cell = rng.integers(GOALS), rng.choice(np.flatnonzero(site.free))
        found = distance(fields, site, goal, cell)
        while lacks_room(fields):
            assert found == UNREACHABLE
            fields = make_room(fields, np.array([goal]))
            found = distance(fields, site, goal, cell)
        assert found == expected[goal, cell]
    return fields


@pytest.mark.parametrize("shape", SHAPES.values(), ids=SHAPES)
def test_every_answer_is_that_of_a_plain_search(shape):
    for seed in range(4):
        rng = np.random.default_rng(seed)
        fields = ask(empty_fields(shape, GOALS, GOALS), random_site(rng, shape), rng, 500)
        assert not lacks_room(fields) and (fields.steps[1:] > 0).any()


@pytest.mark.parametrize("shape", SHAPES.values(), ids=SHAPES)
def test_fields_make_room_for_others_and_grow_where_that_is_too_little(shape):
    rng = np.random.default_rng(9)
    fields = ask(empty_fields(shape, GOALS, 2, 5), random_site(rng, shape), rng, 300)
    held = fields.page != 0
    assert fields.free[ROWS] == fields.extent.size - (fields.row >= 0).sum()
    assert fields.free[PAGES] == len(fields.steps) - 1 - held.sum()
    used = np.concatenate([fields.page[held], fields.free_pages[: fields.free[PAGES]]])
    assert sorted(used) == list(range(1, len(fields.steps)))


def test_a_first_question_measures_little_of_a_large_grid():
    shape = (401, 401)
    free = np.pad(np.ones((399, 399), bool), 1).reshape(-1)
    goal, near = 200 * 401 + 200, 210 * 401 + 215
    steps = np.array([0, 1, -1, 401, -401])
    site = Site(
        free, np.array([goal]), np.ones((1, 1), np.float32), np.zeros(1, int), steps, 401, 1
    )
    fields = empty_fields(shape, 1, 1, pages=700)
    assert distance(fields, site, 0, near) == 25
    assert 0 < (fields.page != 0).sum() <= 0.05 * fields.page.size
    assert distance(fields, site, 0, 401 + 1) == 199 + 199
    assert (fields.page != 0).mean() < 0.4  # the goal lies in the middle: a quarter, and a rim
    corners = (401 + 399, 399 * 401 + 1, 399 * 401 + 399)
    assert [distance(fields, site, 0, cell) for cell in corners] == [398] * 3
    assert (fields.page != 0).sum() == 25 * 25  # of the other tiles all cells are walls
