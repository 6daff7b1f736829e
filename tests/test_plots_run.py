"""The pictures of a run: what the colours mean, a point after one iteration, mazes worth a look."""

import json
from dataclasses import replace

import numpy as np
import pytest
import toy
from matplotlib.figure import Figure
from PIL import Image

from qdenv.configurations import PRESETS
from qdenv.domains.base import find_domain, make_domain
from qdenv.grid import parse
from qdenv.run import loop
from qdenv.run.archive import best_row
from qdenv.run.config import override
from qdenv.run.directory import RunDirectory
from qdenv.simulation.maze.world import longest_path
from qdenv.types import Measure
from qdenv.view.archive import draw_archive, scatter_objectives
from qdenv.view.layouts import draw_marks
from qdenv.view.runs import plot_run

pytestmark = pytest.mark.slow

GRID = (Measure("x", 0, 4, 4), Measure("y", 0, 3, 3))


def words(figure: Figure) -> str:
    """Collect everything a figure says."""
    texts = [axes.get_ylabel() + axes.get_title() for axes in figure.axes]
    texts += [text.get_text() for legend in figure.legends for text in legend.get_texts()]
    return " ".join(texts)


def test_the_colour_bar_says_what_it_shows_and_a_single_value_has_none():
    columns = {"index": [0, 5], "objective": [1.0, 2.0]}
    figure = draw_archive(Figure(), scatter_objectives(columns, GRID), GRID, label="speed [m/s]")
    assert len(figure.axes) == 2 and "speed [m/s]" in words(figure)
    columns["objective"] = [1.0, 1.0]
    figure = draw_archive(Figure(), scatter_objectives(columns, GRID), GRID, label="solvable")
    assert len(figure.axes) == 1 and "solvable: 1 in every filled cell" in words(figure)


def test_fleets_say_throughput_and_mazes_whether_there_is_a_way():
    assert find_domain("warehouse-even").objective_name == "throughput [tasks per timestep]"
    assert find_domain("manufacturing").objective_name == "throughput [tasks per timestep]"
    assert "solvable" in find_domain("maze-walls").objective_name


@pytest.fixture(scope="module")
def maze(tmp_path_factory) -> RunDirectory:
    """Search mazes for one iteration; nearly every one is solvable."""
    small = {"rows": 9, "cols": 9, "timesteps": 40, "steps": 8, "hidden": 4, "simulations": 2}
    short = {"evaluations": 12, "emitters": 2, "batch": 6, "sigma0": 0.7}
    changes = small | short | {"archive": ((0, 49, 14), (0, 40, 8))}
    config = override(PRESETS["maze-quick"], changes)
    return loop.train(config, tmp_path_factory.mktemp("maze") / "run", progress=False)


def test_the_best_maze_is_the_solvable_one_with_the_longest_way(maze):
    columns = maze.archive.columns
    ways = [int(longest_path(layout).length) for layout in columns["repaired"]]
    assert len(ways) > 2 and max(ways) > min(ways)
    assert (columns["objective"] == 1).sum() > 1
    best = maze.best
    assert best.objective == 1
    assert int(longest_path(best.layout).length) == max(ways)
    saved = json.loads((maze.path / "best_layout.json").read_text())
    np.testing.assert_array_equal(parse(saved["layout"], maze.tiles), best.layout)


def test_the_best_maze_is_drawn_with_the_simulators_start_and_goal(maze):
    layout = maze.best.layout
    marks = make_domain(maze.config.evaluation.domain).mark_cells(layout)
    saved = json.loads((maze.path / "best_layout.json").read_text())
    assert saved["marks"] == {name: list(cell) for name, cell in marks.items()}
    course = longest_path(layout)
    width = layout.shape[1]
    assert marks == {
        "start": divmod(int(course.start), width),
        "goal": divmod(int(course.goal), width),
    }
    axes = Figure().add_subplot()
    axes.set_ylim(8.5, -0.5)
    draw_marks(axes, marks)
    drawn = {tuple(marker.get_offsets()[0]) for marker in axes.collections}
    assert drawn == {(column, row) for row, column in marks.values()}
    assert {text.get_text() for text in axes.texts} == {"start", "goal"}


def test_ties_are_broken_by_the_named_column_and_only_ties():
    columns = {
        "objective": np.array([1.0, 1.0, 0.0, 1.0]),
        "way": np.array([[1, 1], [5, 7], [99, 99], [6, 6]]),
    }
    assert best_row(columns, "way") == 1
    assert best_row(columns, None) == 0 == best_row(columns, "not there")
    assert best_row({"objective": np.array([1.0, 2.0])}, None) == 1


def test_progress_shows_a_point_after_one_iteration(maze, tmp_path):
    assert len(maze.read_metrics()) == 1
    plot_run(maze)
    image = np.asarray(Image.open(maze.path / "progress.png").convert("RGB")).astype(int)
    coloured = np.ptp(image, axis=-1) > 60
    thirds = np.array_split(coloured, 3, axis=1)
    assert all(part.sum() > 15 for part in thirds)  # the axes themselves are black


def test_a_run_of_an_older_qdenv_whose_manifest_says_less_is_drawn(tmp_path):
    run = loop.train(replace(toy.CONFIG, evaluations=8), tmp_path / "run", progress=False)
    path = run.path / "manifest.json"
    content = json.loads(path.read_text())
    for name in ("objective", "tie_break", "tile_names"):
        del content[name]
    path.write_text(json.dumps(content))
    assert run.schema.objective == "objective" and run.schema.tie_break is None
    assert [picture.name for picture in plot_run(run)] == [
        "archive.png", "progress.png", "best_layout.png",
    ]  # fmt: skip
