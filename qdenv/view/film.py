"""Pictures of a run at one time after the other: tiles, robots, jams; in a maze the agent's way."""

from __future__ import annotations

import contextlib
import tempfile
from collections.abc import Callable, Iterable, Iterator, Sequence
from itertools import chain, product
from pathlib import Path
from subprocess import PIPE, Popen
from typing import BinaryIO, NamedTuple

import numpy as np
from matplotlib import font_manager
from PIL import Image, ImageDraw, ImageFont

from qdenv.io.files import write_atomically
from qdenv.study.recordings import Motion
from qdenv.types import InputError
from qdenv.view.layouts import COLOURS, UNKNOWN

_FADING = 0.4  # of the tiles' colours towards white, so that robots stand out
# What is drawn over the tiles, told apart by colour-blind eyes, too.
MARKS = {
    "driving": "#1c4e9a",
    "waiting": "#c62f1d",
    "serving": "#00796b",
    "goal": "#00796b",
    "way": "#d6338a",
    "agent": "#f2b705",
    "start": "#3c6fb0",
    "reached": "#2e9e5b",
    "ink": "#1b1b1b",
}
WARMTH = ("#ffd873", "#fdb84e", "#fb9038", "#f1602b", "#d9301f", "#a50f15")  # of jams
JAM_FROM = 5  # timesteps of waiting in a row that make a jam
JAM_STEP = 5  # timesteps from one step of warmth to the next
_PAPER = "#ffffff"
# Corners of a triangle that points to heading 0 (right), in cells from the middle: (right, down).
_TRIANGLE = np.array([(0.38, 0.0), (-0.32, -0.34), (-0.32, 0.34)])
TITLE = 26  # pixels above the layout
_FINE = 4  # a mark is drawn so much larger, then reduced: its edge is smooth
_EDGE = 0.45  # share of a mark's colour in the colours that its edge has


def _mix(ground: str, colour: str, share: float) -> str:
    """Lay a share of a colour over another one, both "#rrggbb"."""
    pairs = [(int(ground[at : at + 2], 16), int(colour[at : at + 2], 16)) for at in (1, 3, 5)]
    return "#" + "".join(f"{round(low + share * (high - low)):02x}" for low, high in pairs)


def floor_colours(tiles: str) -> list[str]:
    """List the colours in which films and replays show the tiles of an alphabet."""
    return [_mix(COLOURS.get(tile, UNKNOWN), _PAPER, _FADING) for tile in tiles]


def _palette_of(tiles: str) -> Image.Image:
    """Make the palette of a GIF: the same in all pictures, so that nothing flickers."""
    floors, marks = floor_colours(tiles), list(MARKS.values())
    edges = [_mix(*pair, _EDGE) for pair in product([*floors, *WARMTH, _PAPER], marks)]
    colours = list(dict.fromkeys([*floors, *WARMTH, _PAPER, *marks, *edges]))[:256]
    levels = [int(colour[at : at + 2], 16) for colour in colours for at in (1, 3, 5)]
    palette = Image.new("P", (1, 1))
    palette.putpalette(levels + levels[:3] * (256 - len(colours)))
    return palette


def _draw(
    layout: np.ndarray, tiles: str, motion: Motion, times: Sequence[float], side: int
) -> Iterator[Image.Image]:
    """Draw a run at some times, the later the later.

    Args:
        layout: int8 [H, W].
        tiles: the alphabet.
        motion: what moved.
        times: timesteps, or between two.
        side: pixels of the layout's longer side, about.

    Returns:
        pictures of one size, their sides even.
    """
    stage = _Stage(layout, tiles, side)
    waits = motion.waits
    waited, done = np.zeros(motion.positions.shape[1], int), 0
    for time in times:
        while done < int(np.ceil(time)):
            waited = np.where(waits[done], waited + 1, 0)
            done += 1
        picture = stage.floor.copy()
        pen = ImageDraw.Draw(picture)
        pen.text((8, TITLE / 2), _title_of(motion, time, waited), MARKS["ink"], stage.font, "lm")
        if motion.headings is None:
            stage.draw_robots(picture, motion, time, waited)
        else:
            stage.draw_agent(pen, motion, time)
        yield picture


def _title_of(motion: Motion, time: float, waited: np.ndarray) -> str:
    """Say how things stand at a time."""
    step = int(time)
    if motion.headings is not None:
        end = ", goal reached" if motion.finished[:step].any() else ""
        return f"action {step}, shortest path {motion.shortest} moves{end}"
    rate = motion.finished[:step].sum() / max(step, 1)
    share = np.count_nonzero(waited) / len(waited)
    return f"timestep {step}   {rate:.2f} tasks per timestep   {share:.0%} wait"


class _Stage:
    """What all pictures of a run share, and how things are drawn on it.

    Attributes:
        cell: pixels of a cell's side.
        cols: columns of the layout.
        floor: the layout below an empty title.
        font: of the title.
    """

    def __init__(self, layout: np.ndarray, tiles: str, side: int) -> None:
        """Draw the floor (int8 [H, W]), its longer side about `side` pixels."""
        rows, self.cols = layout.shape
        self.cell = max(2, round(side / max(layout.shape)))
        colours = np.array([_levels(colour) for colour in floor_colours(tiles)], np.uint8)
        large = colours[layout].repeat(self.cell, 0).repeat(self.cell, 1)
        width, height = self.cols * self.cell, rows * self.cell + TITLE
        # Encoders of films want even sides.
        self.floor = Image.new("RGB", (width + width % 2, height + height % 2), _PAPER)
        self.floor.paste(Image.fromarray(large), (0, TITLE))
        self.font = ImageFont.truetype(font_manager.findfont("DejaVu Sans"), 13)
        self.discs = {name: self._disc(MARKS[name]) for name in ("driving", "waiting", "serving")}

    def _disc(self, colour: str) -> Image.Image:
        large = Image.new("RGBA", (self.cell * _FINE,) * 2, f"{colour}00")
        low, high = 0.1 * self.cell * _FINE, 0.9 * self.cell * _FINE
        ImageDraw.Draw(large).ellipse((low, low, high, high), colour)
        return large.resize((self.cell,) * 2, Image.Resampling.LANCZOS)

    def corners(self, motion: Motion, time: float) -> np.ndarray:
        """Place everybody at a time, int [A, 2]: (right, down), pixels of a cell's corner."""
        step = int(time)
        here, there = motion.positions[[step, min(step + 1, motion.steps)]]
        before, after = (np.stack([at % self.cols, at // self.cols], 1) for at in (here, there))
        place = (before + (time - step) * (after - before)) * self.cell
        return np.rint(place).astype(int) + np.array([0, TITLE])

    def draw_robots(
        self, picture: Image.Image, motion: Motion, time: float, waited: np.ndarray
    ) -> None:
        """Draw robots; a cell in which one has waited for long is warm."""
        corners, step = self.corners(motion, time), int(np.ceil(time)) - 1
        pen, end = ImageDraw.Draw(picture), self.cell - 1
        for agent in np.flatnonzero(waited >= JAM_FROM):
            x, y = corners[agent].tolist()
            warm = WARMTH[min((waited[agent] - JAM_FROM) // JAM_STEP, len(WARMTH) - 1)]
            pen.rectangle((x, y, x + end, y + end), warm)
        still = np.zeros(len(waited), bool)
        if step >= 0:
            still = motion.positions[step] == motion.positions[step + 1]
        kinds = np.where(waited > 0, "waiting", np.where(still, "serving", "driving"))
        for kind, corner in zip(kinds.tolist(), corners.tolist(), strict=True):
            disc = self.discs[kind]
            picture.paste(disc, tuple(corner), disc)

    def draw_agent(self, pen: ImageDraw.ImageDraw, motion: Motion, time: float) -> None:
        """Draw the agent of a maze, its start, its goal and its way so far."""
        assert motion.headings is not None
        end, middle = self.cell - 1, self.cell / 2
        for name, cell in (("start", motion.positions[0, 0]), ("reached", motion.goals[0, 0])):
            x, y = int(cell) % self.cols * self.cell, int(cell) // self.cols * self.cell + TITLE
            pen.rectangle((x, y, x + end, y + end), MARKS[name])
        cells = motion.positions[: int(time) + 1, 0]
        past = np.stack([cells % self.cols, cells // self.cols], 1) * self.cell + [0, TITLE]
        here = self.corners(motion, time)[0]
        way = [tuple(at) for at in (np.vstack([past, here]) + middle).tolist()]
        pen.line(way, MARKS["way"], max(2, self.cell // 6), "curve")
        turn = motion.headings[int(time)] * np.pi / 2
        (right, down), (x, y) = _TRIANGLE.T * self.cell, way[-1]
        across = x + right * np.cos(turn) - down * np.sin(turn)
        along = y + right * np.sin(turn) + down * np.cos(turn)
        corners = list(zip(across.tolist(), along.tolist(), strict=True))
        pen.polygon(corners, MARKS["agent"], MARKS["ink"])


def _levels(colour: str) -> tuple[int, ...]:
    return tuple(int(colour[at : at + 2], 16) for at in (1, 3, 5))


# H.264 in the form that every browser plays, and from its beginning before all of it is there.
_CODING = ["-c:v", "libx264", "-pix_fmt", "yuv420p", "-crf", "28", "-preset", "veryfast"]
_CODING += ["-movflags", "+faststart"]
_REST = 1.0  # seconds that the last picture of a GIF is seen before it begins anew


class _Kind(NamedTuple):
    """How films of one kind are drawn."""

    side: int  # pixels of the layout's longer side, about
    parts: int  # pictures from one timestep to the next
    rate: float  # pictures a second


MOST = 600  # pictures of an episode in a maze, which may take thousands of actions
KINDS = {".gif": _Kind(600, 2, 12.5), ".mp4": _Kind(720, 3, 24)}


def save_film(
    path: Path,
    layout: np.ndarray,
    tiles: str,
    motion: Motion,
    window: tuple[int, int],
    progress: Callable[[str, float], None] = lambda doing, share: None,
) -> None:
    """Draw a stretch of a run as a film; the ending of `path` chooses GIF or MP4.

    Args:
        path: the file to write.
        layout: int8 [H, W].
        tiles: the alphabet.
        motion: what moved.
        window: timesteps at which the film begins and ends; cut to those of the run.
        progress: called with the step and its completed share.

    Raises:
        InputError: the place cannot be written to, or the window is empty.
    """
    kind = KINDS[path.suffix.lower()]
    first, last = window[0], min(window[1], motion.steps)
    if not 0 <= first < last:
        raise InputError(f"there is nothing to draw from timestep {first} to {last} of the run")
    times = [first + part / kind.parts for part in range((last - first) * kind.parts + 1)]
    if motion.headings is not None and len(times) > MOST:
        times = [*range(first, last, -(-(last - first) // MOST)), last]

    def told() -> Iterator[Image.Image]:
        for number, picture in enumerate(_draw(layout, tiles, motion, times, kind.side)):
            progress(f"drawing {path}", number / len(times))
            yield picture

    if path.suffix.lower() == ".gif":
        palette = _palette_of(tiles)
        pictures = (one.quantize(palette=palette, dither=Image.Dither.NONE) for one in told())
        _save_gif(path, pictures, len(times), 1 / kind.rate)
    else:
        _save_mp4(path, told(), kind.rate)


def _save_gif(path: Path, pictures: Iterable[Image.Image], count: int, seconds: float) -> None:
    """Write pictures as a GIF that plays for ever; the last one rests for a second.

    Args:
        path: the file.
        pictures: of one size and one palette.
        count: how many there are.
        seconds: that each one is seen.

    Raises:
        InputError: the place cannot be written to.
    """
    times = [round(1000 * seconds)] * (count - 1) + [round(1000 * _REST)]

    def write(file: BinaryIO) -> None:
        rest = iter(pictures)
        next(rest).save(
            file, "GIF", save_all=True, append_images=rest, duration=times, loop=0, disposal=1
        )

    write_atomically(Path(path), write)


def _save_mp4(path: Path, pictures: Iterable[Image.Image], rate: float) -> None:
    """Write pictures (of even sides) as a film that any browser plays.

    Raises:
        InputError: the place cannot be written to.
    """
    import imageio_ffmpeg  # an extra

    rest = iter(pictures)
    first = next(rest)
    with tempfile.TemporaryDirectory() as folder:
        film = Path(folder) / "film.mp4"
        command = [imageio_ffmpeg.get_ffmpeg_exe(), "-loglevel", "error", "-f", "rawvideo"]
        command += ["-pix_fmt", "rgb24", "-s", "{}x{}".format(*first.size), "-r", f"{rate}"]
        command += ["-i", "-", *_CODING, str(film)]
        # A group of its own: Ctrl-C is for this program, which ends the encoder by itself.
        # `imageio_ffmpeg.write_frames` does that by a fork, which threads of JAX do not survive.
        with Popen(command, stdin=PIPE, stderr=PIPE, process_group=0) as encoder:
            assert encoder.stdin is not None and encoder.stderr is not None
            with contextlib.suppress(BrokenPipeError):  # its message is read below
                for picture in chain([first], rest):
                    encoder.stdin.write(picture.tobytes())
                encoder.stdin.close()
            message = encoder.stderr.read().decode(errors="replace")
        if encoder.returncode:
            raise InputError(f"{path}: the encoder failed ({' '.join(message.split())[:200]})")
        write_atomically(Path(path), film.read_bytes())
