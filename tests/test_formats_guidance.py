"""Guidance in files: the published ones, the round trip to the bit, one clear line for bad ones."""

import json

import numpy as np
import pytest
from conftest import STUDY_DATA
from hypothesis import given, settings
from hypothesis import strategies as st

from qdenv.domains.base import find_domain
from qdenv.grid import DOWN, LEFT, RIGHT, UP, WAIT, parse
from qdenv.guidance import crisscross, existing_moves
from qdenv.io.guidance import TABLE_HEAD, costs_of, weights_of
from qdenv.io.layouts import read_drawing, write_layout
from qdenv.ops.options import read_plan
from qdenv.ops.output import Layout
from qdenv.study.plans import Plan, guide, keep_costs
from qdenv.types import InputError

WAREHOUSE = find_domain("warehouse-even")
ROWS = ["w.e", "@..", "e.w"]
PLAN = Plan("small", parse(ROWS, WAREHOUSE.tiles), WAREHOUSE, assumed=False)
FREE = PLAN.layout != 1


def test_weights_stand_in_the_published_order():
    """Waits, then right, up, left, down of each cell, row by row."""
    costs = costs_of([*range(1, 9), *range(101, 119)], FREE)
    np.testing.assert_array_equal(costs[WAIT][FREE], np.arange(1, 9))
    assert np.isinf(costs[WAIT, 1, 0]) and np.isinf(costs[LEFT, 1, 1])
    assert costs[RIGHT, 0, 0] == 101
    assert [costs[way, 0, 1] for way in (RIGHT, LEFT, DOWN)] == [102, 103, 104]
    assert [costs[way, 1, 1] for way in (RIGHT, UP, DOWN)] == [107, 108, 109]
    assert [costs[way, 2, 2] for way in (UP, LEFT)] == [117, 118]
    assert weights_of(costs) == [*range(1, 9), *range(101, 119)]
    one = costs_of([7, *range(101, 119)], FREE)
    assert set(one[WAIT][FREE]) == {7} and weights_of(one) == [7, *range(101, 119)]


@settings(max_examples=50, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), ending=st.sampled_from([".json", ".csv"]))
def test_costs_come_back_to_the_bit(seed, ending, tmp_path_factory):
    rng = np.random.default_rng(seed)
    layout = rng.integers(0, 4, rng.integers(1, 8, 2)).astype(np.int8)
    layout[0, 0] = 0  # where no robot can be there are no costs
    costs = np.exp(rng.normal(0, 3, (5, *layout.shape)))
    costs[1:][rng.random(costs[1:].shape) < 0.1] = np.inf  # lanes of one way
    path = tmp_path_factory.mktemp("costs") / f"plan{ending}"
    Layout(layout, WAREHOUSE, costs=costs).save(path)
    again = read_plan(path, "warehouse-even")
    np.testing.assert_array_equal(again.layout, layout)
    moves = existing_moves(layout != 1)
    np.testing.assert_array_equal(again.costs, np.where(moves, costs, np.inf))
    assert again.guidance == str(path)


GRAPHS = sorted((STUDY_DATA / "guidance").glob("*.csv"))


@pytest.mark.skipif(not GRAPHS, reason="no published guidance graphs (QDENV_STUDY_DATA)")
@pytest.mark.parametrize("table", GRAPHS, ids=lambda path: path.stem)
def test_the_published_files_agree_and_are_written_back(table, tmp_path):
    other = table.with_name(f"{table.stem.removesuffix('_g_graph')}.json")
    plan, same = read_plan(table), read_plan(other)
    np.testing.assert_array_equal(plan.layout, same.layout)
    np.testing.assert_array_equal(plan.costs, same.costs)
    saved = Layout(plan.layout, plan.domain, costs=plan.costs)
    assert saved.save(tmp_path / "again.csv").read_text() == table.read_text()
    saved.save(tmp_path / "again.json")
    again, published = (json.loads(path.read_text()) for path in (tmp_path / "again.json", other))
    assert again["weights"] == published["weights"] and again["layout"] == published["layout"]


def test_costs_without_a_layout_are_for_any_floor_of_as_many_moves(tmp_path):
    path, costs = tmp_path / "costs.json", costs_of(range(1, 27), FREE)
    path.write_text(json.dumps({"weights": weights_of(costs)}))
    np.testing.assert_array_equal(guide(PLAN, path).costs, costs)
    with pytest.raises(InputError, match="costs of moves without a layout: give it as --guidance"):
        read_plan(path)


def test_guidance_is_a_name_a_file_or_an_array(tmp_path):
    path = Layout(PLAN.layout, WAREHOUSE, costs=crisscross(FREE)).save(tmp_path / "own.json")
    own = read_plan(path)
    assert guide(own) is own and own.guidance == str(path)
    assert guide(own, "none").costs is None and guide(own, "none").guidance == "none"
    for guidance, name in (
        (path, str(path)),
        ("crisscross", "crisscross"),
        (own.costs, "an array"),
    ):
        guided = guide(PLAN, guidance)
        np.testing.assert_array_equal(guided.floor.costs, own.floor.costs)
        assert guided.guidance == name


LINES = [TABLE_HEAD, *(f"{i},.,0,{i},1,inf,1,inf,1" for i in range(3))]


@pytest.mark.parametrize(
    ("name", "content", "reason"),
    [
        ("g.json", '{"weights": [1, 2, 3]}', "3 weights are not those of this layout: its 8 free"),
        ("g.json", '{"weights": "many"}', r'weights: cannot be read \(must be a list, not "many"'),
        ("g.json", '{"weights": [1, "x"]}', r'\[1\]: must be a number, not "x"'),
        ("g.json", '{"weights": [1, NaN]}', "NaN is not allowed"),
        ("g.json", json.dumps({"weights": [0] * 26}), "above zero"),
        ("g.json", json.dumps({"weights": [1] * 8 + [-2] * 18}), "above zero"),
        ("g.json", json.dumps({"weights": [1] * 8 + [-1] * 18}), "one-way lanes cut off row 0"),
        ("g.json", json.dumps({"layout": ROWS}), "no costs of moves"),
        ("g.json", json.dumps({"layout": ["w.e"], "weights": []}), "1 x 3, small is 3 x 3"),
        ("g.json", json.dumps({"layout": ["w.e", ".@.", "e.w"], "weights": []}), "row 1, column 0"),
        ("g.json", json.dumps({"layout": ["w.e", "?..", "e.w"], "weights": []}), "unknown tile"),
        ("g.txt", "w.e\n@..\ne.w", "no costs of moves"),
        ("g.csv", "\n".join(LINES), "1 x 3, small is 3 x 3"),
        ("g.csv", "\n".join([*LINES, "3,.,0,3,1,inf,x,inf,1"]), "line 5 is not a cell"),
        ("g.csv", "\n".join([*LINES, "3,.,0"]), "line 5 is not a cell"),
        ("g.csv", "\n".join([*LINES, "3,.,0,3,1,inf,1,inf"]), "is not a cell"),
        ("g.csv", "\n".join([*LINES, "3,.,999999999,99999999,1,1,1,1,1"]), "not one line"),
        ("g.csv", "\n".join([*LINES, "3,.,0,2,1,inf,1,inf,1"]), "not one line, with one tile"),
        ("g.csv", "\n".join([*LINES, "3,.e,0,3,1,inf,1,inf,1"]), "not one line, with one tile"),
        ("g.csv", TABLE_HEAD, "not one line"),
        ("g.csv", f"{TABLE_HEAD}\n0,.,-2,-2,1,1,1,1,1", "not one line"),
        (
            "g.grid",
            "\n".join(["Grid size (x, y)", "1,1", TABLE_HEAD, "0,Travel,0,x,1,1,1,1,1"]),
            "line 4 is not a cell",
        ),
    ],
)
def test_bad_guidance_is_refused_in_one_line(name, content, reason, tmp_path):
    path = tmp_path / name
    path.write_text(content)
    with pytest.raises(InputError, match=reason) as error:
        guide(PLAN, path)
    assert str(path) in str(error.value) and str(error.value).isprintable()


def test_a_plan_with_impossible_costs_is_refused_where_it_is_read(tmp_path):
    path = tmp_path / "plan.csv"
    path.write_text("\n".join([*LINES[:3], "2,.,0,2,inf,inf,nan,inf,1"]))
    with pytest.raises(InputError, match="above zero, and finite for waiting"):
        read_plan(path)


def test_unknown_names_are_refused():
    with pytest.raises(InputError, match="unknown guidance 'criscross': did you mean crisscross"):
        guide(PLAN, "criscross")
    with pytest.raises(InputError, match="an array: costs of moves have the shape"):
        guide(PLAN, np.ones((5, 2, 2)))
    maze = Plan("maze", np.zeros((3, 3), np.int8), find_domain("maze-walls"), assumed=False)
    with pytest.raises(InputError, match="no fleet drives in maze-walls"):
        guide(maze, "crisscross")


def test_text_and_maps_hold_no_costs(tmp_path):
    with pytest.raises(InputError, match=r"a .txt holds no costs of moves: write a .json or .csv"):
        write_layout(tmp_path / "a.txt", PLAN.layout, WAREHOUSE.tiles, {}, crisscross(FREE))


def test_a_layout_in_a_table_of_costs_is_a_layout(tmp_path):
    path = Layout(PLAN.layout, WAREHOUSE, costs=crisscross(FREE)).save(tmp_path / "plan.csv")
    assert path.read_text().startswith(TABLE_HEAD)
    assert read_drawing(path).rows == ROWS


def test_a_changed_floor_keeps_its_costs_and_new_moves_cost_the_mean():
    layout, moves = parse(["w.e", "...", "e.w"], WAREHOUSE.tiles), existing_moves(FREE)
    costs = np.where(moves, crisscross(FREE), np.inf)
    kept = keep_costs(PLAN._replace(costs=costs), layout)
    np.testing.assert_array_equal(kept[moves], costs[moves])
    new = kept[existing_moves(layout != 1) & ~moves]
    assert len(new) == 7 and set(new) == {costs[moves].mean()}
    assert keep_costs(PLAN, layout) is None
