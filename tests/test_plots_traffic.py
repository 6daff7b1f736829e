"""The picture of a fleet's traffic: each number stands where it belongs."""

import numpy as np
import pytest
from matplotlib.image import imread

from qdenv.grid import LEFT, RIGHT
from qdenv.guidance import crisscross
from qdenv.study.recordings import Maps
from qdenv.view.style import save_figure
from qdenv.view.traffic import Scene, draw_traffic


@pytest.fixture
def scene() -> Scene:
    free = np.ones((6, 9), bool)
    free[2, 3:6] = False
    usage = np.where(free, 0.2, 0.0)
    waiting, finished = np.zeros((6, 9)), np.zeros((6, 9))
    waiting[1, 4], waiting[3, 3], finished[0, 8] = 0.5, 0.25, 1.5
    maps = Maps(usage, waiting, usage, finished, 10.0, np.zeros((5, 6, 9)))
    worst = [{"row": 1, "column": 4}, {"row": 3, "column": 3}]
    over_time = np.array([[50.0, 100.0], [1.0, 2.0], [0.1, 0.2]])
    return Scene(free, maps, worst, over_time, [80], 5)


def panels(scene):
    axes = {one.get_title(): one for one in draw_traffic(scene, "plan, 10 agents: flows").axes}
    return {title.partition(":")[0]: one for title, one in axes.items()}


def test_maps_lie_over_the_walls_and_leave_calm_cells_blank(scene):
    drawn = panels(scene)
    walls, waiting = drawn["where agents wait"].images
    np.testing.assert_array_equal(walls.get_array(), scene.free)
    shown = waiting.get_array()
    assert shown.count() == 2 and shown[1, 4] == 0.5
    assert drawn["where tasks are finished"].images[1].get_array().compressed().tolist() == [1.5]
    assert drawn["where agents are"].images[1].get_array().count() == scene.free.sum()
    assert "where agents wait: 7.5% of their time" in [
        one.get_title() for one in draw_traffic(scene, "plan, 10 agents: flows").axes
    ]


def test_colour_bars_say_what_they_show_in_which_unit(scene):
    every = draw_traffic(scene, "plan, 10 agents: flows").axes
    labels = [bar.get_ylabel() for one in every for bar in one.child_axes]
    assert labels == [
        "share of time in which one waits here",
        "share of time in which one is here",
        "tasks per timestep here",
    ]
    assert every[2].get_title() == "where tasks are finished: 1.50 a timestep"
    assert every[3].get_ylabel() == "throughput [tasks / timestep]"


def test_the_worst_cells_bear_their_rank(scene):
    ranks = {
        text.get_text(): text.get_position() for text in panels(scene)["where agents wait"].texts
    }
    assert ranks == {"1": (4, 1), "2": (3, 3)}


def test_throughput_over_time_has_a_band_and_marks_jams(scene):
    time = panels(scene)["finished tasks over time"]
    values, edges, _ = time.patches[0].get_data()
    assert values.tolist() == [1, 2] and edges.tolist() == [0, 50, 100]
    band = time.collections[0].get_paths()[0].vertices
    assert band[:, 1].max() == pytest.approx(2.2) and band[:, 1].min() == pytest.approx(0.9)
    assert time.lines[0].get_xdata() == [80, 80]
    assert time.get_ylim()[0] == 0 and time.get_xlim() == (0, 100)
    words = [text.get_text() for text in time.get_legend().get_texts()]
    assert words == ["mean of 5 runs", "+- standard error", "1 of 5 runs congested, and ended"]


def test_guidance_is_drawn_beside_what_agents_drove(scene):
    moves = np.zeros((5, 6, 9))
    moves[RIGHT, 0, 0], moves[LEFT, 0, 1] = 0.3, 0.1
    guided = scene._replace(costs=crisscross(scene.free), maps=scene.maps._replace(moves=moves))
    drawn = panels(guided)
    assert list(drawn)[4:] == ["guidance", "where agents drove"]
    assert len(panels(scene)) == 4
    title = drawn["where agents drove"].get_title()
    assert title == "where agents drove: 75% the cheaper way"


@pytest.mark.slow
@pytest.mark.parametrize("shape", [(3, 200), (200, 3), (1, 1)])
def test_any_shape_and_a_fleet_that_never_waits_can_be_drawn(shape, tmp_path):
    still = np.zeros(shape)
    over_time = np.array([[1.0], [0.0], [np.nan]])
    maps = Maps(still, still, still, still, 1.0, np.stack(5 * [still]))
    figure = draw_traffic(Scene(still == 0, maps, [], over_time, [], 1), "empty")
    save_figure(figure, tmp_path / "t.png")
    assert imread(tmp_path / "t.png").std() > 0
