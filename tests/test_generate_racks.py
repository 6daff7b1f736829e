"""Racks in rows: all shelves, near the stations, where a plan leaves room."""

import jax
import numpy as np
import pytest

from qdenv.domains.base import find_domain, make_domain
from qdenv.domains.hall import HallConfig
from qdenv.generators import GENERATORS, Canvas, RacksConfig
from qdenv.grid import draw
from qdenv.types import InputError

WALLS = ["?" * 20] * 5 + ["?" * 14 + "#" * 6] * 5  # an L
KEEP = ("w" + "?" * 19, *WALLS, "w" + "?" * 19)


@pytest.fixture(scope="module")
def hall():
    return make_domain(HallConfig(rows=12, cols=20, shelves=30, keep=KEEP))


def grown(domain, solutions):
    generator = GENERATORS.make(RacksConfig(), domain.canvas)
    together = jax.jit(lambda some: jax.vmap(domain.frame)(generator.grow(some, 0)))
    return np.asarray(together(np.asarray(solutions, np.float32)))


# Racks two deep and three long, aisles of two cells, cross aisles of one; standing, and served at
# their ends as well; three more cells away from the stations.
DRAWN = {
    "lying": "we@.@@@..... .@@.@@@..... .ee.eee..... eee.eee..... "
    "@@@.@@@..... @@@.@@e..... eee.ee...... w...........",
    "standing": "we.e@@e..... e@ee@@e..... @@ee@@e..... ee..ee...... "
    "@@ee@@e..... @@ee@@e..... e@ee@@e..... we..ee......",
    "far": "w...e@@.@@.. ....@@@.@@.. ....eee.ee.. ..e.eee.ee.. "
    "..@.@@@.@@.. ..e.@@@.@@.. ....eee.ee.. w...........",
}


def test_what_a_solution_says_is_drawn():
    keep = ("w" + "?" * 11, *("?" * 12,) * 6, "w" + "?" * 11)
    hall = make_domain(HallConfig(rows=8, cols=12, shelves=20, keep=keep))
    lying = [1, 0, -1.4, -2, -1, -2, -2, -1, 0, 0, 0, -1]
    standing, far = [*lying[:4], 1, *lying[5:11], 1], [*lying[:7], 1, *lying[8:]]
    for drawn, rows in zip(grown(hall, [lying, standing, far]), DRAWN.values(), strict=True):
        assert draw(drawn, hall.tiles) == rows.split()


@pytest.mark.slow
def test_every_solution_holds_shelves_near_the_stations_and_walls_where_they_were(hall):
    solutions = np.random.default_rng(0).normal(0, 1.5, (50, 12))
    layouts = grown(hall, solutions)
    wall = np.array([[tile == "#" for tile in row] for row in KEEP])
    for layout in layouts:
        np.testing.assert_array_equal(layout == hall.tiles.index("#"), wall)
        assert (layout == hall.tiles.index("@")).sum() <= 30
    assert len({layout.tobytes() for layout in layouts}) > 40
    np.testing.assert_array_equal(grown(hall, solutions[7:8])[0], layouts[7])


def test_a_warehouse_has_racks_from_its_own_stations():
    layout = grown(find_domain("warehouse-even"), np.zeros((1, 12)))[0]
    assert layout.shape == (33, 36) and (layout == 1).sum() == 240


def test_domains_without_shelves_are_refused():
    for canvas in (find_domain("maze-walls").canvas, Canvas(2, 3, ".@e", (".",))):
        with pytest.raises(InputError, match="shelves and endpoints"):
            GENERATORS.make(RacksConfig(), canvas)
    with pytest.raises(InputError, match="--plan"):
        GENERATORS.make(RacksConfig(), find_domain("hall").canvas)
