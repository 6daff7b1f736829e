"""Pictures of layouts: the right colour in the right place, nothing left behind."""

import matplotlib
import numpy as np
import pytest
from colours import CONES, nearest
from matplotlib._pylab_helpers import Gcf
from matplotlib.colors import to_rgb
from matplotlib.image import imread

from qdenv.domains.base import find_domain
from qdenv.grid import parse
from qdenv.guidance import crisscross
from qdenv.study.plans import Plan
from qdenv.types import InputError
from qdenv.view.change import draw_change
from qdenv.view.layouts import CHANGED, COLOURS, draw_frames, draw_plan
from qdenv.view.style import save_figure

DRAWING = [".@ew", "e@..", "...."]
LAYOUT = parse(DRAWING, ".@ew")


def test_every_tile_has_its_colour():
    image = draw_plan(LAYOUT, ".@ew").axes[0].images[0]
    shown = image.cmap(image.norm(image.get_array()))[..., :3]
    for row, line in enumerate(DRAWING):
        for col, tile in enumerate(line):
            assert np.allclose(shown[row, col], to_rgb(COLOURS[tile]), atol=1 / 255), tile


def test_the_legend_counts_the_tiles_that_are_there():
    names = {".": "empty", "@": "shelf", "e": "endpoint", "w": "workstation"}
    legend = draw_plan(LAYOUT, ".@ew", names).axes[0].get_legend()
    texts = [text.get_text() for text in legend.get_texts()]
    assert texts == ["empty: 7 cells", "shelf: 2 cells", "endpoint: 2 cells", "workstation: 1 cell"]
    strange = draw_plan(np.array([[0, 1]]), "?!").axes[0].get_legend().get_texts()
    assert [text.get_text() for text in strange] == ["'?': 1 cell", "'!': 1 cell"]


@pytest.mark.slow
@pytest.mark.parametrize("ending", ["png", "svg", "pdf"])
def test_saving_writes_one_file_and_leaves_no_state(tmp_path, ending):
    backend = matplotlib.get_backend()
    save_figure(draw_plan(LAYOUT, ".@ew"), tmp_path / f"layout.{ending}", crop=True)
    assert [path.name for path in tmp_path.iterdir()] == [f"layout.{ending}"]
    assert not Gcf.figs and matplotlib.get_backend() == backend


@pytest.mark.slow
def test_a_change_frames_what_was_removed_and_placed(tmp_path):
    plan = Plan("plan", LAYOUT, find_domain("warehouse-even"), False)

    def drawn(after):
        figure = draw_change(plan, plan._replace(layout=after))
        save_figure(figure, tmp_path / "d.png", crop=True)
        pixels = imread(tmp_path / "d.png")[..., :3]
        titles = [axes.get_title() for axes in figure.axes]
        return (np.abs(pixels - to_rgb(CHANGED)).max(-1) < 0.02).sum(), titles

    after = LAYOUT.copy()
    framed, titles = drawn(after)
    assert framed == 0 and titles == ["before\nnothing removed", "after\nnothing placed"]
    after[2, 1] = 2  # an endpoint on bare floor: framed where it is placed alone
    framed, titles = drawn(after)
    assert framed >= 4 and titles == ["before\nnothing removed", "after\nplaced: endpoint 1"]
    after[1, 1] = 0
    more, titles = drawn(after)
    assert more > framed and titles[0] == "before\nremoved: shelf 1"


def test_usages_before_and_after_share_one_colour_scale():
    plan = Plan("plan", LAYOUT, find_domain("warehouse-even"), False)
    usages = np.full(LAYOUT.shape, 0.1), np.full(LAYOUT.shape, 0.4)
    figure = draw_change(plan, plan, usages, ("today", "new"))
    maps = [axes.images[-1] for axes in figure.axes[2:4]]
    assert [image.get_clim() for image in maps] == [(0, 0.4)] * 2
    assert [axes.get_title().partition("\n")[0] for axes in figure.axes[:2]] == ["today", "new"]
    lanes = draw_change(plan, plan._replace(costs=crisscross(LAYOUT != 1)), usages)
    assert lanes.axes[1].get_title() == "after\nlanes: arrows point the cheaper way"
    with pytest.raises(InputError, match="nothing to match"):
        draw_change(plan, plan._replace(layout=LAYOUT[:2]))


@pytest.mark.slow
def test_a_series_has_a_panel_per_number_of_steps_and_at_most_six_in_a_row(tmp_path):
    for number, across, down in ((1, 1, 1), (6, 6, 1), (7, 6, 2)):
        path = tmp_path / f"{number}.png"
        save_figure(draw_frames([LAYOUT] * number, range(number), ".@ew"), path)
        height = 2.9 * 3 / 4 + 0.6  # of a panel of 3 rows and 4 columns
        assert imread(path).shape[:2] == (int(150 * height * down), int(150 * 2.9 * across))


@pytest.mark.parametrize("cones", CONES)
@pytest.mark.parametrize("tiles", [".@ew", ".012e", " X"])
def test_tiles_of_a_domain_are_told_apart_by_every_eye(tiles, cones):
    """A distance of 2.3 is just noticeable; ten times that is told apart at a glance."""
    assert nearest([COLOURS[tile] for tile in tiles], cones) > 23
