"""Films of a run, as GIF or MP4: tiles, robots, jams; in a maze the agent's way."""

import contextlib
import tempfile
from collections.abc import Iterator, Sequence
from itertools import chain, product
from pathlib import Path
from subprocess import PIPE, Popen

import numpy as np
from matplotlib import font_manager
from PIL import Image, ImageDraw, ImageFont
from PIL.ImageColor import getrgb

from qdenv.io.files import write_atomically
from qdenv.progress import Progress, silent
from qdenv.study.recordings import Motion
from qdenv.types import InputError
from qdenv.view.layouts import COLOURS, MARKS, UNKNOWN

WARMTH = ("#ffd873", "#fdb84e", "#fb9038", "#f1602b", "#d9301f", "#a50f15")  # of jams
JAM_FROM = 5  # timesteps of waiting in a row that make a jam
JAM_STEP = 5  # timesteps from one step of warmth to the next
_PAPER = "#ffffff"
# Corners of a triangle that points to heading 0 (right), in cells from the middle: (right, down).
_TRIANGLE = np.array([(0.38, 0.0), (-0.32, -0.34), (-0.32, 0.34)])
TITLE = 26  # pixels above the layout
_FINE = 4  # a mark is drawn so much larger, then reduced: its edge is smooth

# By a film's ending:
SIDES = {".gif": 600, ".mp4": 720}  # pixels of the layout's longer side, about
PARTS = {".gif": 2, ".mp4": 3}  # pictures from one timestep to the next
RATES = {".gif": 12.5, ".mp4": 24}  # pictures a second
MOST = 600  # pictures of an episode in a maze, beside its last: it may take thousands of actions


def save_film(
    path: Path,
    layout: np.ndarray,
    tiles: str,
    motion: Motion,
    window: tuple[int, int],
    progress: Progress = silent,
) -> None:
    """Draw a stretch of a run as a film; the ending of `path` chooses GIF or MP4.

    The layout is int8 [H, W], the window the timesteps at which the film begins and ends, cut to
    those of the run. Raises InputError if the place cannot be written to, or the window is empty.
    """
    kind = path.suffix.lower()
    parts, side = PARTS[kind], SIDES[kind]
    first, last = window[0], min(window[1], motion.steps)
    if not 0 <= first < last:
        raise InputError(f"there is nothing to draw from timestep {first} to {last} of the run")
    times = [first + part / parts for part in range((last - first) * parts + 1)]
    if motion.headings is not None and len(times) > MOST:
        # Evenly, and always the end: whether the goal is reached.
        times = [*range(first, last, -(-(last - first) // MOST)), last]

    def pictures() -> Iterator[Image.Image]:
        for number, picture in enumerate(_draw(layout, tiles, motion, times, side)):
            progress(f"drawing {path}", number / len(times), "")
            yield picture

    if kind == ".gif":
        _save_gif(path, pictures(), len(times), tiles)
    else:
        _save_mp4(path, pictures())


def _draw(
    layout: np.ndarray, tiles: str, motion: Motion, times: Sequence[float], side: int
) -> Iterator[Image.Image]:
    """Draw a run at increasing times (timesteps, or between two), about `side` pixels large."""
    stage = _Stage(layout, tiles, side)
    waits = motion.waits
    waited, done = np.zeros(motion.positions.shape[1], int), 0  # timesteps in a row, by agent
    for time in times:
        while done < int(np.ceil(time)):
            waited = np.where(waits[done], waited + 1, 0)
            done += 1
        step = int(time)
        picture = stage.floor.copy()
        pen = ImageDraw.Draw(picture)
        if motion.headings is None:
            stage.draw_robots(picture, motion, time, waited)
            rate = motion.finished[:step].sum() / max(step, 1)
            share = np.count_nonzero(waited) / len(waited)
            title = f"timestep {step}   {rate:.2f} tasks per timestep   {share:.0%} wait"
        else:
            stage.draw_agent(pen, motion, time)
            end = ", goal reached" if motion.finished[:step].any() else ""
            title = f"action {step}, shortest path {motion.shortest} moves{end}"
        pen.text((8, TITLE / 2), title, MARKS["ink"], stage.font, "lm")
        yield picture


def floor_colours(tiles: str) -> list[str]:
    """List the colours of an alphabet's tiles in films and replays, paler than in pictures."""
    return [_mix(COLOURS.get(tile, UNKNOWN), _PAPER, 0.4) for tile in tiles]


def _mix(ground: str, colour: str, share: float) -> str:
    """Lay a share of a colour over another one, both "#rrggbb"."""
    pairs = zip(getrgb(ground), getrgb(colour), strict=True)
    return "#" + "".join(f"{round(low + share * (high - low)):02x}" for low, high in pairs)


class _Stage:
    """What all pictures of a run share, and how agents are drawn on it."""

    def __init__(self, layout: np.ndarray, tiles: str, side: int) -> None:
        """Draw the floor (int8 [H, W]) below an empty title, about `side` pixels large."""
        rows, self.cols = layout.shape
        self.cell = max(2, round(side / max(layout.shape)))  # pixels
        colours = np.array([getrgb(colour) for colour in floor_colours(tiles)], np.uint8)
        large = colours[layout].repeat(self.cell, 0).repeat(self.cell, 1)
        width, height = self.cols * self.cell, rows * self.cell + TITLE
        # Encoders of films need even sides.
        self.floor = Image.new("RGB", (width + width % 2, height + height % 2), _PAPER)
        self.floor.paste(Image.fromarray(large), (0, TITLE))
        self.font = ImageFont.truetype(font_manager.findfont("DejaVu Sans"), 13)
        self._discs = {}
        for name in ("driving", "waiting", "serving"):
            # Transparent outside in the disc's own colour, which its edge is mixed with.
            disc = Image.new("RGBA", (self.cell * _FINE,) * 2, f"{MARKS[name]}00")
            low, high = 0.1 * self.cell * _FINE, 0.9 * self.cell * _FINE
            ImageDraw.Draw(disc).ellipse((low, low, high, high), MARKS[name])
            self._discs[name] = disc.resize((self.cell,) * 2, Image.Resampling.LANCZOS)

    def _pixels(self, cells: np.ndarray) -> np.ndarray:
        """Return the upper left corners of cells [...] in pixels, int [..., 2]: (right, down)."""
        return np.stack([cells % self.cols, cells // self.cols], -1) * self.cell + [0, TITLE]

    def _corners(self, motion: Motion, time: float) -> np.ndarray:
        """Return the corners of all agents at a time, int [A, 2]."""
        step = int(time)
        # Between two timesteps, agents are on the way from one cell to the next.
        before, after = self._pixels(motion.positions[[step, min(step + 1, motion.steps)]])
        return np.rint(before + (time - step) * (after - before)).astype(int)

    def draw_robots(
        self, picture: Image.Image, motion: Motion, time: float, waited: np.ndarray
    ) -> None:
        """Draw robots; a cell in which one has waited for long is warm."""
        corners, step = self._corners(motion, time), int(np.ceil(time)) - 1
        pen, end = ImageDraw.Draw(picture), self.cell - 1
        for agent in np.flatnonzero(waited >= JAM_FROM):
            x, y = corners[agent].tolist()
            warm = WARMTH[min((waited[agent] - JAM_FROM) // JAM_STEP, len(WARMTH) - 1)]
            pen.rectangle((x, y, x + end, y + end), warm)
        # One that stays without waiting is served, or has no order.
        still = (step >= 0) & (motion.positions[step] == motion.positions[step + 1])
        kinds = np.where(waited > 0, "waiting", np.where(still, "serving", "driving"))
        for kind, corner in zip(kinds.tolist(), corners.tolist(), strict=True):
            picture.paste(self._discs[kind], tuple(corner), self._discs[kind])

    def draw_agent(self, pen: ImageDraw.ImageDraw, motion: Motion, time: float) -> None:
        """Draw the agent of a maze, its start, its goal and its way so far."""
        assert motion.headings is not None
        end, middle = self.cell - 1, self.cell / 2
        for name, cell in (("start", motion.positions[0, 0]), ("reached", motion.goals[0, 0])):
            x, y = self._pixels(cell).tolist()
            pen.rectangle((x, y, x + end, y + end), MARKS[name])
        past = self._pixels(motion.positions[: int(time) + 1, 0])
        here = self._corners(motion, time)[0]
        way = [tuple(at) for at in (np.vstack([past, here]) + middle).tolist()]
        pen.line(way, MARKS["way"], max(2, self.cell // 6), "curve")
        turn = motion.headings[int(time)] * np.pi / 2
        (right, down), (x, y) = _TRIANGLE.T * self.cell, way[-1]
        across = x + right * np.cos(turn) - down * np.sin(turn)
        along = y + right * np.sin(turn) + down * np.cos(turn)
        corners = list(zip(across.tolist(), along.tolist(), strict=True))
        pen.polygon(corners, MARKS["agent"], MARKS["ink"])


def _save_gif(path: Path, pictures: Iterator[Image.Image], count: int, tiles: str) -> None:
    """Write pictures as a GIF that repeats for ever; the last one is shown for a second."""
    # One palette for all pictures, so that nothing flickers: the floor, the marks, and the colours
    # of their smooth edges on any ground, in which a mark has a share of nearly half.
    grounds, marks = [*floor_colours(tiles), *WARMTH, _PAPER], list(MARKS.values())
    edges = [_mix(*pair, 0.45) for pair in product(grounds, marks)]
    colours = list(dict.fromkeys([*grounds, *marks, *edges]))[:256]
    levels = [level for colour in colours for level in getrgb(colour)]
    palette = Image.new("P", (1, 1))
    palette.putpalette(levels + levels[:3] * (256 - len(colours)))
    reduced = (one.quantize(palette=palette, dither=Image.Dither.NONE) for one in pictures)
    times = [round(1000 / RATES[".gif"])] * (count - 1) + [1000]  # milliseconds
    look = {"duration": times, "loop": 0, "disposal": 1, "save_all": True, "append_images": reduced}
    write_atomically(path, lambda file: next(reduced).save(file, "GIF", **look))


def _save_mp4(path: Path, pictures: Iterator[Image.Image]) -> None:
    """Write pictures (of even sides) as a film that any browser plays."""
    import imageio_ffmpeg  # an extra

    first = next(pictures)
    with tempfile.TemporaryDirectory() as folder:
        film = Path(folder) / "film.mp4"
        command = [imageio_ffmpeg.get_ffmpeg_exe(), "-loglevel", "error", "-f", "rawvideo"]
        command += ["-pix_fmt", "rgb24", "-s", "{}x{}".format(*first.size)]
        command += ["-r", f"{RATES['.mp4']}", "-i", "-"]
        # H.264 in the form that every browser plays, and begins to play before all is there.
        command += ["-c:v", "libx264", "-pix_fmt", "yuv420p", "-crf", "28", "-preset", "veryfast"]
        command += ["-movflags", "+faststart", str(film)]
        # A group of its own: Ctrl-C is for this program, which ends the encoder by itself.
        # `imageio_ffmpeg.write_frames` does that by a fork, which threads of JAX do not survive.
        with Popen(command, stdin=PIPE, stderr=PIPE, process_group=0) as encoder:
            assert encoder.stdin is not None and encoder.stderr is not None
            with contextlib.suppress(BrokenPipeError):  # its message is read below
                for picture in chain([first], pictures):
                    encoder.stdin.write(picture.tobytes())
                encoder.stdin.close()
            message = encoder.stderr.read().decode(errors="replace")
        if encoder.returncode:
            raise InputError(f"{path}: the encoder failed ({' '.join(message.split())[:200]})")
        write_atomically(path, film.read_bytes())
