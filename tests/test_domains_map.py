"""Maps as they are: every free cell may be a goal, and what is cut off is closed."""

import numpy as np
import pytest
from conftest import STUDY_DATA

import qdenv
from qdenv.cli.main import run
from qdenv.domains.base import find_domain, make_domain
from qdenv.domains.map import MapConfig
from qdenv.io.layouts import endings_for, write_layout
from qdenv.study.plans import close_parts, read_plan, with_tasks
from qdenv.types import InputError

HEAD = "type octile\nheight {}\nwidth {}\nmap\n"
PARTS = ["....@T", "..@@@.", "....@."]  # two free cells are cut off in the last column


def save(path, rows):
    path.write_text(HEAD.format(len(rows), len(rows[0])) + "\n".join(rows) + "\n")
    return path


def test_robots_drive_from_goal_to_goal_on_any_free_cells(tmp_path):
    done = qdenv.simulate(
        save(tmp_path / "own.map", [".....", ".@.@.", "....."]),
        agents=3,
        domain="map",
        timesteps=50,
        seeds=2,
        audit=True,
    )
    assert done["valid"] and done["domain"] == "map"
    # Two random free cells of this ring are 3.5 steps apart on average.
    assert done["steps_per_task"] == pytest.approx(3.5, abs=0.8)


def test_free_cells_cut_off_from_the_largest_part_are_closed_and_that_is_said(tmp_path):
    plan = read_plan(save(tmp_path / "own.map", PARTS), "map")
    closed = close_parts(plan)
    assert closed.whose == "domain map, 2 cells cut off from the largest part are closed"
    assert np.argwhere(plan.layout != closed.layout).tolist() == [[1, 5], [2, 5]]
    assert close_parts(closed) is closed
    room = qdenv.make_environment(tmp_path / "own.map", agents=10, domain="map")
    assert np.array_equal(room.layout, closed.layout)
    done = qdenv.simulate(
        tmp_path / "own.map", agents=10, domain="map", timesteps=9, seeds=1, stop=False
    )
    assert done["runs"][0]["end_timestep"] == 9
    with pytest.raises(InputError, match="11 agents need as many free cells, the layout has 10"):
        qdenv.simulate(tmp_path / "own.map", agents=11, domain="map", timesteps=9)
    with pytest.raises(InputError, match="11 agents need as many free cells, the layout has 10"):
        qdenv.guide(tmp_path / "own.map", agents=11, domain="map", path=tmp_path / "run")


def test_what_a_repair_can_join_stays_as_it_is(tmp_path):
    path = tmp_path / "plan.txt"
    path.write_text("w..@.w\n..@@@.\nw.@e@.\n")
    plan = read_plan(path, "warehouse-even")
    assert close_parts(plan) is plan


def test_the_demand_of_a_single_row_is_of_that_size_alone():
    row = make_domain(MapConfig(rows=1, cols=5, demand=("1 2 3 1 1",)))
    assert row.resized(1, 5).config == row.config and row.resized(2, 5).config.demand == ()


def test_only_its_name_chooses_the_domain(tmp_path):
    path = save(tmp_path / "own.map", PARTS)
    assert read_plan(path).domain.name != "map"
    assert read_plan(path, "map").domain.name == "map"


def test_a_map_is_written_and_read_back_equal(tmp_path):
    domain = make_domain(find_domain("map").config)
    assert ".map" in endings_for(domain.tiles, domain.meanings)
    plan = read_plan(save(tmp_path / "own.map", PARTS), "map")
    write_layout(tmp_path / "again.map", plan.layout, domain.tiles, domain.meanings)
    np.testing.assert_array_equal(read_plan(tmp_path / "again.map", "map").layout, plan.layout)


@pytest.mark.skipif(not (STUDY_DATA / "formats").exists(), reason="nobody has the examples here")
def test_a_published_map_is_driven_on():
    path = STUDY_DATA / "formats" / "planviz_random-32-32-20.map"
    done = qdenv.simulate(path, agents=50, domain="map", timesteps=60, seeds=1, audit=True)
    assert done["valid"] and done["mean_of_all"] > 1


def test_goals_are_as_likely_as_a_scenario_has_them(tmp_path, capsys):
    plan = read_plan(save(tmp_path / "own.map", [".....", ".@.@.", "....."]), "map")
    # Bucket, map, width, height, start x, y, goal x, y, length.
    line = "0\town.map\t5\t3\t2\t0\t{}\t{}\t1"
    goals = [line.format(*cell) for cell in ((4, 2), (0, 0), (4, 2))]
    (tmp_path / "own.scen").write_text("\n".join(["version 1", *goals]))
    tasks = with_tasks(plan, {"demand": tmp_path / "own.scen"}).domain.simulator.tasks
    odds = np.asarray(tasks.cycle[0].weight(plan.layout))
    assert odds[2, 4] == 2 * odds[0, 0] > 0 and np.count_nonzero(odds) == 2
    words = "--domain map --robots 2 --timesteps 9 --seeds 1 --no-verdict --demand"
    words = [*words.split(), str(tmp_path / "own.scen")]
    assert run(["simulate", str(tmp_path / "own.map"), *words]) == 0
    assert "demand by place" in capsys.readouterr().out
    save(tmp_path / "other.map", ["....", "...."])
    assert run(["simulate", str(tmp_path / "other.map"), *words]) == 2
    assert "goals on a map of 3 x 5, the plan has 2 x 4" in capsys.readouterr().err
