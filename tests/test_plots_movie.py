"""Films of a run: as many pictures as there are times, and on them what happened."""

import subprocess

import numpy as np
import pytest
from PIL import Image

from qdenv.study.recordings import Motion
from qdenv.types import InputError
from qdenv.view.film import MOST, PARTS, RATES, SIDES, TITLE, WARMTH, floor_colours, save_film
from qdenv.view.layouts import MARKS

TILES = ".@ew"
LAYOUT = np.zeros((4, 6), np.int8)
LAYOUT[2, 1:5] = 1
STEPS = 12


@pytest.fixture(scope="module")
def motion():
    """Robot 0 drives to and fro in row 0, robot 1 waits in row 3, robot 2 is served in row 3."""
    across = 5 - np.abs(np.arange(STEPS + 1) % 10 - 5)
    positions = np.stack([across, np.full(STEPS + 1, 18), np.full(STEPS + 1, 23)], 1)
    goals = np.stack([np.full(STEPS + 1, cell) for cell in (5, 0, 23)], 1)
    finished = np.zeros((STEPS, 3), bool)
    finished[4, 0] = True
    return Motion(positions.astype(np.int32), goals.astype(np.int32), finished, (), STEPS)


def pictures_of(path):
    """Read a GIF: what it says of itself, and all its pictures."""
    with Image.open(path) as film:
        pictures = []
        for number in range(film.n_frames):
            film.seek(number)
            pictures.append(film.convert("RGB"))
        film.seek(0)
        return dict(film.info), pictures


def levels(colour):
    return np.array([int(colour[at : at + 2], 16) for at in (1, 3, 5)])


def middle(picture, row, column, cell):
    """Read the colour in the middle of a cell."""
    return np.asarray(picture)[TITLE + row * cell + cell // 2, column * cell + cell // 2]


def corner(picture, row, column, cell):
    return np.asarray(picture)[TITLE + row * cell + 1, column * cell + 1]


def test_a_gif_shows_every_timestep_and_who_drives_waits_and_is_served(tmp_path, motion):
    path, side, parts = tmp_path / "run.gif", SIDES[".gif"], PARTS[".gif"]
    save_film(path, LAYOUT, TILES, motion, (0, 100))
    (info, pictures), cell = pictures_of(path), side // 6
    assert len(pictures) == STEPS * parts + 1
    assert pictures[0].size == (6 * cell, 4 * cell + TITLE)
    assert (info["loop"], info["duration"]) == (0, round(1000 / RATES[".gif"]))
    third = pictures[3 * parts]
    for row, column, name in ((0, 3, "driving"), (3, 0, "waiting"), (3, 5, "serving")):
        np.testing.assert_array_equal(middle(third, row, column, cell), levels(MARKS[name]))
    np.testing.assert_array_equal(middle(third, 2, 1, cell), levels(floor_colours(TILES)[1]))
    np.testing.assert_array_equal(corner(third, 3, 0, cell), (255, 255, 255))
    jammed = pictures[10 * parts]  # robot 1 has waited for ten timesteps
    np.testing.assert_array_equal(corner(jammed, 3, 0, cell), levels(WARMTH[1]))
    np.testing.assert_array_equal(corner(jammed, 3, 5, cell), (255, 255, 255))


def test_between_two_timesteps_a_robot_is_between_two_cells(tmp_path, motion):
    path, side, parts = tmp_path / "run.gif", SIDES[".gif"], PARTS[".gif"]
    save_film(path, LAYOUT, TILES, motion, (2, 4))
    (_, pictures), cell = pictures_of(path), side // 6
    assert (len(pictures), parts) == (5, 2)
    half = np.asarray(pictures[1])[TITLE + cell // 2]  # timestep 2.5
    dark = np.flatnonzero((half == levels(MARKS["driving"])).all(1))
    assert dark.mean() == pytest.approx(3 * cell, abs=1)


def test_a_film_decodes_to_all_its_pictures(tmp_path, motion):
    ffmpeg = pytest.importorskip("imageio_ffmpeg")
    path, side, parts = tmp_path / "run.mp4", SIDES[".mp4"], PARTS[".mp4"]
    save_film(path, LAYOUT, TILES, motion, (0, STEPS))
    command = [ffmpeg.get_ffmpeg_exe(), "-loglevel", "error", "-i", str(path)]
    command += ["-f", "rawvideo", "-pix_fmt", "rgb24", "-"]
    raw = subprocess.run(command, capture_output=True, check=True).stdout
    cell = side // 6
    shape = (4 * cell + TITLE, 6 * cell, 3)
    pictures = np.frombuffer(raw, np.uint8).reshape(-1, *shape)
    assert len(pictures) == STEPS * parts + 1
    third = pictures[3 * parts]
    for row, column, name in ((0, 3, "driving"), (3, 0, "waiting"), (3, 5, "serving")):
        apart = middle(third, row, column, cell) - levels(MARKS[name])
        assert np.abs(apart).max() < 12, name
    assert middle(third, 0, 1, cell).min() > 240


def test_the_agent_of_a_maze_leaves_its_way_behind(tmp_path):
    layout = np.array([[1, 1, 1, 1], [1, 0, 0, 0], [1, 1, 1, 1]], np.int8)
    motion = Motion(
        positions=np.array([[5], [5], [6]], np.int32),
        goals=np.full((3, 1), 7, np.int32),
        finished=np.array([[False], [True]]),
        congested=(),
        timesteps=9,
        headings=np.array([3, 0, 0], np.int8),
        shortest=2,
    )
    path, cell = tmp_path / "walk.gif", SIDES[".gif"] // 4
    save_film(path, layout, " X", motion, (0, 2))
    last = pictures_of(path)[1][-1]
    np.testing.assert_array_equal(middle(last, 1, 2, cell), levels(MARKS["agent"]))
    np.testing.assert_array_equal(middle(last, 1, 3, cell), levels(MARKS["reached"]))
    np.testing.assert_array_equal(corner(last, 1, 1, cell), levels(MARKS["start"]))
    row = np.asarray(last)[TITLE + cell + cell // 2, cell + cell // 2 : 2 * cell]
    assert (row == levels(MARKS["way"])).all(1).mean() > 0.9


@pytest.mark.slow
def test_a_long_episode_skips_actions_but_not_its_end(tmp_path):
    layout, steps = np.zeros((3, 3), np.int8), 2 * MOST + 7
    motion = Motion(
        positions=np.append(np.zeros(steps, np.int32), 1)[:, None],
        goals=np.ones((steps + 1, 1), np.int32),
        finished=(np.arange(steps) == steps - 1)[:, None],
        congested=(),
        timesteps=steps,
        headings=np.zeros(steps + 1, np.int8),
        shortest=1,
    )
    path, cell = tmp_path / "walk.gif", SIDES[".gif"] // 3
    save_film(path, layout, " X", motion, (0, steps))
    with Image.open(path) as film:
        assert film.n_frames <= MOST + 1
        film.seek(film.n_frames - 1)
        last = film.convert("RGB")
    np.testing.assert_array_equal(middle(last, 0, 1, cell), levels(MARKS["agent"]))


def test_a_film_of_no_time_is_refused(tmp_path, motion):
    for window in ((5, 5), (STEPS, STEPS + 9), (40, 50)):
        with pytest.raises(InputError, match="there is nothing to draw from timestep"):
            save_film(tmp_path / "run.gif", LAYOUT, TILES, motion, window)
    assert not list(tmp_path.iterdir())
