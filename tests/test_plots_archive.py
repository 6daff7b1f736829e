"""The heat map: every elite is drawn, in its place."""

import numpy as np
import pytest
from matplotlib.figure import Figure
from PIL import Image
from scipy import ndimage

from qdenv.types import InputError, Measure
from qdenv.view.archive import draw_archive, draw_heatmap, scatter_objectives
from qdenv.view.style import new_figure, save_figure

GRID = (Measure("walls", 0, 4, 4), Measure("path length", 0, 30, 3))
MAZE = (Measure("walls", 0, 256, 256), Measure("path length", 0, 648, 162))


def scattered(index, objective, measures):
    return scatter_objectives({"index": index, "objective": objective}, measures)


def save_heatmap(path, objectives, measures, title=""):
    save_figure(draw_archive(new_figure(6, 4.8), objectives, measures, title), path)


def test_cells_are_row_major_and_empty_ones_blank():
    objectives = scattered([0, 5, 11], [1.0, 2.0, 3.0], GRID)
    objectives = np.where(np.isnan(objectives), -np.inf, objectives)
    grid = draw_heatmap(Figure().add_subplot(), objectives, GRID).get_array().T
    assert grid.shape == (4, 3) and grid.count() == 3
    assert (grid[0, 0], grid[1, 2], grid[3, 2]) == (1, 2, 3)


def test_axes_carry_names_and_ranges_and_the_first_measure_runs_right():
    axes = Figure().add_subplot()
    image = draw_heatmap(axes, scattered([5], [2.0], GRID), GRID)
    assert (axes.get_xlabel(), axes.get_ylabel()) == ("walls", "path length")
    assert image.get_extent() == [0, 4, 0, 30] and image.origin == "lower"
    assert image.get_cursor_data(_mouse(axes, 1.5, 25)) == 2.0
    assert image.get_cursor_data(_mouse(axes, 2.5, 25)) is np.ma.masked


def _mouse(axes, x, y):
    """Make a mouse event over a point of the data."""
    place = axes.transData.transform((x, y))
    return type("Event", (), {"x": place[0], "y": place[1], "inaxes": axes})()


def test_each_elite_of_a_sparse_maze_archive_shows_in_the_picture(tmp_path):
    rng = np.random.default_rng(0)
    # Every ninth cell of every ninth row: no two touch.
    index = np.ravel_multi_index(np.mgrid[1:256:9, 1:162:9].reshape(2, -1), (256, 162))
    objectives = scattered(index, rng.uniform(1, 2, len(index)), MAZE)
    save_heatmap(tmp_path / "archive.png", objectives, MAZE, title="maze")
    image = np.asarray(Image.open(tmp_path / "archive.png").convert("RGB")).astype(int)
    blobs, _ = ndimage.label(np.ptp(image, axis=-1) > 30, np.ones((3, 3)))
    sizes = np.bincount(blobs.ravel())[1:]
    assert (sizes < 100).sum() == len(index)
    assert (sizes >= 100).sum() == 1  # the colour bar


def test_an_empty_archive_and_a_single_measure_draw(tmp_path):
    save_heatmap(tmp_path / "empty.png", np.full(12, -np.inf), GRID)
    save_heatmap(tmp_path / "line.svg", np.arange(4.0), GRID[:1])
    shown = np.asarray(Image.open(tmp_path / "empty.png").convert("RGB"))
    blank = (shown == [0xF2, 0xF2, 0xF2]).all(axis=-1).mean()
    assert blank > 0.5  # most of the picture is the colour of empty cells
    assert (tmp_path / "line.svg").read_text().startswith("<?xml")


def test_the_heading_counts_the_filled_cells():
    small, large = GRID[:1], (Measure("x", 0, 1, 1200),)
    figure = draw_archive(Figure(), [np.nan, -np.inf, 1.0, 2.0], small)
    assert figure.axes[0].get_title() == "50.0% of 4 cells filled"
    figure = draw_archive(Figure(), np.zeros(1200), large, "maze")
    assert figure.axes[0].get_title() == "maze (100.0% of 1,200 cells filled)"


def test_objectives_that_do_not_fit_the_axes_are_refused():
    with pytest.raises(InputError, match="11 objectives"):
        draw_archive(Figure(), np.zeros(11), GRID)
    with pytest.raises(InputError, match="one or two measures"):
        draw_archive(Figure(), np.zeros(12), (*GRID, Measure("z", 0, 1, 1)))
