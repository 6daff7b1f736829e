"""Demand by place: tables, zones, order lines; and goals that are drawn by it."""

import re

import jax.numpy as jnp
import numpy as np
import pytest
from scipy.stats import chi2

from qdenv.grid import parse
from qdenv.io.demand import read_demand
from qdenv.simulation.mapf.goals import rows_of_odds, station_goal, tile_goal, weigh
from qdenv.simulation.mapf.planner import draw_goals, goal_table
from qdenv.types import Goal, InputError, TaskRule

TILES = ".@ewio"
LAYOUT = parse(["e@e.w", "..e.i", "@e..i", "....o"], TILES)
ENDPOINTS = TILES.index("e") == LAYOUT


def test_a_table_of_the_plans_shape(tmp_path):
    path = tmp_path / "heat.csv"
    path.write_text("1;2;0,5;;0\n0;0;4;0;0\n\n0;3;0;0;0\n0;0;0;0;0\n")
    expected = [[1, 2, 0.5, 0, 0], [0, 0, 4, 0, 0], [0, 3, 0, 0, 0], [0] * 5]
    np.testing.assert_array_equal(read_demand(path, ENDPOINTS), expected)
    path.write_text("\n".join([";".join(["0,5"] * 5)] * 4))  # more commas than semicolons
    assert (read_demand(path, ENDPOINTS) == 0.5).all()
    path.write_text(",,,,\n1,2,3,4,5\n,,,,\n,,,,\n\n")
    assert read_demand(path, ENDPOINTS).sum(1).tolist() == [0, 15, 0, 0], "empty cells are 0"


def test_zones_weigh_rectangles_and_the_last_one_counts():
    odds = read_demand("0:2,0:5=3 1:4,2:3=0", ENDPOINTS)
    assert odds.tolist() == [[3] * 5, [3, 3, 0, 3, 3], [1, 1, 0, 1, 1], [1, 1, 0, 1, 1]]
    many = " ".join([*["0:1,0:1=2"] * 500, "1:2,1:2=7"])  # longer than a file's name may be
    assert read_demand(many, ENDPOINTS)[1, 1] == 7


def test_order_lines_count_at_endpoints_and_shelves_share_theirs(tmp_path):
    orders, places = tmp_path / "orders.csv", tmp_path / "places.csv"
    orders.write_text("order,row,col,quantity\n1,0,0,2\n2,2,1,1\n3,2,1,4\n4,0,1,6\n")
    odds = read_demand(orders, ENDPOINTS)
    # The shelf at (0, 1) has endpoints on both sides, three of six each.
    found = {(0, 0): 5, (0, 2): 3, (1, 2): 0, (2, 1): 5}
    assert {cell: odds[cell] for cell in found} == found
    assert odds[3, 0] == 5 and odds[0, 4] == 3, "other cells have what the nearest endpoint has"
    orders.write_text("Place;Order\nA-1;1\nA-2;2\na-1;3\n")
    places.write_text("place;row;column\nA-1;0;0\nA-2;1;2\n")
    odds = read_demand(f"{orders},{places}", ENDPOINTS)
    assert (odds[0, 0], odds[1, 2], odds[2, 1]) == (2, 1, 0)
    places.write_text("row,column,place\n0,0,A-1\n1,2,A-2\n1,2\n,,\n")
    np.testing.assert_array_equal(read_demand(f"{orders},{places}", ENDPOINTS), odds)
    places.write_text("row,column,place\n0,0,A-1\n1,2,a-2\n1,2,A-2\n2,1,a-1\n")
    with pytest.raises(InputError, match=r"places.csv: line 5: place 'a-1' has another cell"):
        read_demand(f"{orders},{places}", ENDPOINTS)


BAD = {
    "0:2,0:5": "is not a demand: write zones as",
    "0:2,0:9=3": "up to 4 and columns up to 5",
    "0:2,0:5=-3": "zone '0:2,0:5=-3': '-3' is not a weight: give a number like 1200",
    "0:2,0:5=nan": "'nan' is not a weight",
    "0:2=1": "write zones as ROWS,COLUMNS=WEIGHT",
    "nothing.csv": "nothing.csv",
    "1,2\n3,4": "2 x 2 numbers, the plan has 4 x 5",
    "1,2,3,4,5\n1,2\n1,2,3,4,5\n1,2,3,4,5": "4 x 2 or 5 numbers",
    "1,2,x,4,5": "line 1, column 2: 'x' is not a weight",
    '"1,200",2,3,4,5': "line 1, column 0: '1,200' is not a weight: give a number like 1200 or 1.2",
    "": "empty",
    "row,col\n3,3": "row 3, column 3 is neither an endpoint of the plan nor beside one",
    "row,col\n0,0\n1.5,0": "line 3: row and column must be whole numbers",
    "row,col\n-1,0": "row -1, column 0 is neither an endpoint",
    "row,col\n0,0\n1,5": "row 1, column 5 is neither an endpoint",
    "row,row,col\n0,0,0": "several columns row in its first line",
    "row,col,count,quantity\n0,0,1,2": "several columns count or quantity in its first line",
    "row,quantity\n0,1": "no column column",
    "place\nA1": "place 'a1' is unknown: name a second file",
}


@pytest.mark.parametrize("source", BAD)
def test_what_is_no_demand_is_refused_in_a_line(source, tmp_path):
    if source[1:2] != ":" and source != "nothing.csv":
        (tmp_path / "demand.csv").write_text(source)
        read = tmp_path / "demand.csv"
    else:
        read = source
    with pytest.raises(InputError, match=re.escape(BAD[source])):
        read_demand(read, ENDPOINTS)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ('{"weights": [1], "tasks": [[0]]}', "goals on a map of 0 x 0, the plan has 4 x 5"),
        ('{"layout": [".....", ".....", ".....", "..."], "tasks": [[-5]]}', "a goal is not a cell"),
        ('{"layout": [".....", ".....", ".....", "....."], "tasks": [[20]]}', "the map, 0 to 19"),
    ],
)
def test_goals_lie_on_the_map_of_the_plan(content, message, tmp_path):
    (tmp_path / "goals.json").write_text(content)
    with pytest.raises(InputError, match=message):
        read_demand(tmp_path / "goals.json", ENDPOINTS)


def test_odds_are_written_and_read_back():
    odds = np.array([[0.25, 1e-3, 12345], [0, 1, 1 / 3]])
    everywhere = Goal(lambda layout: np.ones(layout.shape, np.float32))
    read = weigh(everywhere, rows_of_odds(odds), (2, 3)).weight(np.zeros((2, 3), np.int8))
    np.testing.assert_allclose(read, odds, rtol=1e-5)
    for rows, message in (
        (("1 2", "3"), "2 x 1 or 2 numbers, the plan 2 x 2 cells"),
        (("1 2", "3 -4"), "0 or more"),
        (("1 2", "3 nan"), "0 or more"),
        (("1 2", "3 x"), "0 or more"),
        (("1 2", "3 1e308"), r"at most 1e\+30"),
        (("0 0", "0 0"), "0 everywhere"),
    ):
        with pytest.raises(InputError, match=message):
            weigh(everywhere, rows, (2, 2))


def test_odds_may_be_small():
    odds = tuple(" ".join(["3e-9"] * 5) for _ in range(4))
    rule = TaskRule(TILES, ".ewio", (weigh(tile_goal("e", TILES), odds, LAYOUT.shape),))
    last = goal_table(LAYOUT, rule, LAYOUT.size).odds[0]
    np.testing.assert_allclose(last, np.minimum(np.arange(1, 21) / ENDPOINTS.sum(), 1), rtol=1e-6)


def test_goals_are_drawn_with_the_odds_of_their_places_and_kinds():
    odds = "1 0 2 0 0", "0 0 3 0 0", "0 4 0 0 0", "9 9 9 9 9"
    stations = station_goal("wio", TILES, {"i": 7, "o": 3}, {"i": 3, "o": 1})
    rule = TaskRule(TILES, ".ewio", (weigh(tile_goal("e", TILES), odds, LAYOUT.shape), stations))
    table, draws = goal_table(LAYOUT, rule, LAYOUT.size), 100_000
    cells = np.asarray(table.cells)
    for kind, expected in enumerate(
        (
            {(0, 0): 0.1, (0, 2): 0.2, (1, 2): 0.3, (2, 1): 0.4},
            {(1, 4): 3 / 8, (2, 4): 3 / 8, (3, 4): 1 / 4},  # no task is left for workstations
        )
    ):
        drawn = cells[draw_goals(table, jnp.full(draws, kind), 5 + kind)]
        counts = np.bincount(drawn, minlength=LAYOUT.size).reshape(LAYOUT.shape)
        wanted = np.zeros(LAYOUT.shape)
        for cell, share in expected.items():
            wanted[cell] = share * draws
        assert (counts[wanted == 0] == 0).all()
        there = wanted > 0
        distance = ((counts - wanted)[there] ** 2 / wanted[there]).sum()
        assert distance < chi2.ppf(0.999, there.sum() - 1)
    stays = stations.stays(LAYOUT)
    assert (stays[TILES.index("i") == LAYOUT] == 7).all() and stays[3, 4] == 3
    assert stays[0, 4] == 0
