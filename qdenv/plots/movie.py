"""Films of one run: an animated GIF or an MP4, drawn without a display."""

from __future__ import annotations

import contextlib
import tempfile
from collections.abc import Callable, Iterable, Iterator
from itertools import chain
from pathlib import Path
from subprocess import PIPE, Popen
from typing import BinaryIO, NamedTuple

import numpy as np
from PIL import Image

from qdenv.io.files import write_atomically
from qdenv.plots.frames import draw, palette_of
from qdenv.study.motion import Motion
from qdenv.types import InputError

# H.264 in the form that every browser plays, and from its beginning before all of it is there.
CODING = ["-c:v", "libx264", "-pix_fmt", "yuv420p", "-crf", "28", "-preset", "veryfast"]
CODING += ["-movflags", "+faststart"]
REST = 1.0  # seconds that the last picture of a GIF is seen before it begins anew


class Kind(NamedTuple):
    """How films of one kind are drawn."""

    side: int  # pixels of the layout's longer side, about
    parts: int  # pictures from one timestep to the next
    rate: float  # pictures a second


KINDS = {".gif": Kind(600, 2, 12.5), ".mp4": Kind(720, 3, 24)}


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
        progress: told what is done, and which share of it.

    Raises:
        InputError: the place cannot be written to, or the window is empty.
    """
    kind = KINDS[path.suffix.lower()]
    first, last = window[0], min(window[1], motion.steps)
    if not 0 <= first < last:
        raise InputError(f"there is nothing to draw from timestep {first} to {last} of the run")
    times = [first + part / kind.parts for part in range((last - first) * kind.parts + 1)]

    def told() -> Iterator[Image.Image]:
        for number, picture in enumerate(draw(layout, tiles, motion, times, kind.side)):
            progress(f"drawing {path}", number / len(times))
            yield picture

    if path.suffix.lower() == ".gif":
        palette = palette_of(tiles)
        pictures = (one.quantize(palette=palette, dither=Image.Dither.NONE) for one in told())
        save_gif(path, pictures, len(times), 1 / kind.rate)
    else:
        save_mp4(path, told(), kind.rate)


def save_gif(path: Path, pictures: Iterable[Image.Image], count: int, seconds: float) -> None:
    """Write pictures as a GIF that plays for ever; the last one rests for a second.

    Args:
        path: the file.
        pictures: of one size and one palette.
        count: how many there are.
        seconds: that each one is seen.

    Raises:
        InputError: the place cannot be written to.
    """
    times = [round(1000 * seconds)] * (count - 1) + [round(1000 * REST)]

    def write(file: BinaryIO) -> None:
        rest = iter(pictures)
        next(rest).save(
            file, "GIF", save_all=True, append_images=rest, duration=times, loop=0, disposal=1
        )

    write_atomically(Path(path), write)


def save_mp4(path: Path, pictures: Iterable[Image.Image], rate: float) -> None:
    """Write pictures (of even sides) as a film that any browser plays.

    Raises:
        InputError: the place cannot be written to.
    """
    # Only here: the encoder is an extra.
    import imageio_ffmpeg

    rest = iter(pictures)
    first = next(rest)
    with tempfile.TemporaryDirectory() as folder:
        film = Path(folder) / "film.mp4"
        command = [imageio_ffmpeg.get_ffmpeg_exe(), "-loglevel", "error", "-f", "rawvideo"]
        command += ["-pix_fmt", "rgb24", "-s", "{}x{}".format(*first.size), "-r", f"{rate}"]
        command += ["-i", "-", *CODING, str(film)]
        # A group of its own: Ctrl-C is for this program, which ends the encoder by itself.
        with Popen(command, stdin=PIPE, stderr=PIPE, process_group=0) as encoder:
            assert encoder.stdin is not None and encoder.stderr is not None
            with contextlib.suppress(BrokenPipeError):  # what it complains about is read below
                for picture in chain([first], rest):
                    encoder.stdin.write(picture.tobytes())
                encoder.stdin.close()
            said = encoder.stderr.read().decode(errors="replace")
        if encoder.returncode:
            raise InputError(f"{path}: the encoder failed ({' '.join(said.split())[:200]})")
        write_atomically(Path(path), film.read_bytes())
