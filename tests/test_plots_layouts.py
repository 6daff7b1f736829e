"""Pictures of layouts: the right colour in the right place, nothing left behind."""

import itertools

import matplotlib
import numpy as np
import pytest
from matplotlib._pylab_helpers import Gcf
from matplotlib.colors import to_rgb
from matplotlib.image import imread

from qdenv.grid import parse
from qdenv.plots.layouts import (
    CHANGED,
    COLOURS,
    draw_layout,
    save_difference,
    save_frames,
    save_layout,
)

DRAWING = [".@ew", "e@..", "...."]
LAYOUT = parse(DRAWING, ".@ew")


def test_every_tile_has_its_colour():
    image = draw_layout(LAYOUT, ".@ew").images[0]
    shown = image.cmap(image.norm(image.get_array()))[..., :3]
    for row, line in enumerate(DRAWING):
        for col, tile in enumerate(line):
            assert np.allclose(shown[row, col], to_rgb(COLOURS[tile]), atol=1 / 255), tile


def test_the_legend_counts_the_tiles_that_are_there():
    names = {".": "empty", "@": "shelf", "e": "endpoint", "w": "workstation"}
    legend = draw_layout(LAYOUT, ".@ew", names=names).get_legend()
    texts = [text.get_text() for text in legend.get_texts()]
    assert texts == ["empty: 7 cells", "shelf: 2 cells", "endpoint: 2 cells", "workstation: 1 cell"]
    strange = draw_layout(np.array([[0, 1]]), "?!").get_legend().get_texts()
    assert [text.get_text() for text in strange] == ["'?': 1 cell", "'!': 1 cell"]


@pytest.mark.parametrize("ending", ["png", "svg", "pdf"])
def test_saving_writes_one_file_and_leaves_no_state(tmp_path, ending):
    backend = matplotlib.get_backend()
    save_layout(tmp_path / f"layout.{ending}", LAYOUT, ".@ew")
    assert [path.name for path in tmp_path.iterdir()] == [f"layout.{ending}"]
    assert not Gcf.figs and matplotlib.get_backend() == backend


def test_the_difference_frames_what_changed(tmp_path):
    after = LAYOUT.copy()
    save_difference(tmp_path / "none.png", LAYOUT, after, ".@ew")
    after[2, 1] = 2
    save_difference(tmp_path / "one.png", LAYOUT, after, ".@ew")

    def framed(name):
        pixels = imread(tmp_path / name)[..., :3]
        return (np.abs(pixels - to_rgb(CHANGED)).max(-1) < 0.02).sum()

    assert framed("none.png") == 0
    assert framed("one.png") >= 4


def test_a_series_has_a_panel_per_number_of_steps_and_at_most_six_in_a_row(tmp_path):
    for number, across, down in ((1, 1, 1), (6, 6, 1), (7, 6, 2)):
        path = tmp_path / f"{number}.png"
        save_frames(path, [LAYOUT] * number, range(number), ".@ew")
        height = 2.9 * 3 / 4 + 0.6  # of a panel of 3 rows and 4 columns
        assert imread(path).shape[:2] == (int(150 * height * down), int(150 * 2.9 * across))


# Colours as people without one kind of cone see them, in linear light (Machado, Oliveira and
# Fernandes 2009, severity 1).
CONES = {
    "all": np.eye(3),
    "no red": [(0.152286, 1.052583, -0.204868), (0.114503, 0.786281, 0.099216),
               (-0.003882, -0.048116, 1.051998)],
    "no green": [(0.367322, 0.860646, -0.227968), (0.280085, 0.672501, 0.047413),
                 (-0.011820, 0.042940, 0.968881)],
    "no blue": [(1.255528, -0.076749, -0.178779), (-0.078411, 0.930809, 0.147602),
                (0.004733, 0.691367, 0.303900)],
}  # fmt: skip
XYZ = np.array([(0.4124, 0.3576, 0.1805), (0.2126, 0.7152, 0.0722), (0.0193, 0.1192, 0.9505)])


def lab(colour, cones):
    """Turn a colour as these cones see it into CIE L*a*b* (white is that of sRGB)."""
    share = np.array(to_rgb(colour))
    light = np.where(share <= 0.04045, share / 12.92, ((share + 0.055) / 1.055) ** 2.4)
    seen = np.clip(np.array(CONES[cones]) @ light, 0, 1)
    x, y, z = np.cbrt(XYZ @ seen / (XYZ @ np.ones(3)))
    return np.array([116 * y - 16, 500 * (x - y), 200 * (y - z)])


@pytest.mark.parametrize("cones", CONES)
@pytest.mark.parametrize("tiles", [".@ew", ".012e", " X"])
def test_tiles_of_a_domain_are_told_apart_by_every_eye(tiles, cones):
    """A distance of 2.3 is just noticeable; ten times that is told apart at a glance."""
    seen = [lab(COLOURS[tile], cones) for tile in tiles]
    pairs = itertools.combinations(range(len(tiles)), 2)
    nearest = min(float(np.linalg.norm(seen[i] - seen[j])) for i, j in pairs)
    assert nearest > 23
