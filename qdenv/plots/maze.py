"""Moving picture of the maze agent: one episode as a GIF, colours as in Figure 7c."""

from pathlib import Path
from typing import BinaryIO

import numpy as np
from PIL import Image, ImageDraw

from qdenv.files import write_atomically
from qdenv.types import InputError

EMPTY, WALL, GOAL, TRAIL, AGENT, START = range(6)
PALETTE = (
    (20, 20, 20),
    (128, 128, 128),
    (60, 170, 80),
    (70, 62, 30),
    (245, 200, 40),
    (60, 90, 160),
)
# Corners of a triangle that points to heading 0 (right), in cells from the middle: (right, down).
TRIANGLE = np.array([(0.38, 0.0), (-0.32, -0.34), (-0.32, 0.34)])


def save_episode(
    path: Path,
    layout: np.ndarray,
    goal: int,
    positions: np.ndarray,
    headings: np.ndarray,
    cell: int = 0,
    seconds: float = 0.06,
    frames: int = 600,
) -> None:
    """Draw one episode as a GIF that any browser plays; long ones skip steps.

    Args:
        path: the file to write.
        layout: int8 [H, W], 1 is wall.
        goal: cell of the goal.
        positions: int [T + 1], cell after every action, the start first.
        headings: int [T + 1], 0 right, 1 down, 2 left, 3 up.
        cell: pixels per tile; chosen by the size of the maze unless given.
        seconds: per frame.
        frames: largest number of frames.

    Raises:
        InputError: nothing to draw, or the file cannot be written.
    """
    if len(positions) < 1 or frames < 1:
        raise InputError("an episode needs at least its first pose, and one frame")
    stride = -(-len(positions) // frames)
    shown = sorted({*range(0, len(positions), stride), len(positions) - 1})
    cell = cell or max(4, min(24, 640 // max(layout.shape)))
    pictures = [_frame(layout, goal, positions[: t + 1], int(headings[t]), cell) for t in shown]
    # The last picture rests for a second, so that the end is seen before the loop begins anew.
    times = [round(1000 * seconds)] * (len(pictures) - 1) + [1000]

    def write(file: BinaryIO) -> None:
        pictures[0].save(
            file, "GIF", save_all=True, append_images=pictures[1:], duration=times, loop=0
        )

    write_atomically(Path(path), write)


def _frame(layout: np.ndarray, goal: int, path: np.ndarray, heading: int, cell: int) -> Image.Image:
    """Draw the maze, the way so far and the agent on top of it."""
    colours = np.where(layout == 1, WALL, EMPTY).astype(np.uint8).reshape(-1)
    colours[path] = TRAIL
    colours[path[0]], colours[goal] = START, GOAL
    large = np.kron(colours.reshape(layout.shape), np.ones((cell, cell), np.uint8))
    picture = Image.fromarray(large, "P")
    picture.putpalette(sum(PALETTE, ()))
    row, col = divmod(int(path[-1]), layout.shape[1])
    turn = heading * np.pi / 2
    right, down = TRIANGLE.T
    x = col + 0.5 + right * np.cos(turn) - down * np.sin(turn)
    y = row + 0.5 + right * np.sin(turn) + down * np.cos(turn)
    corners = [(float(a) * cell, float(b) * cell) for a, b in zip(x, y, strict=True)]
    ImageDraw.Draw(picture).polygon(corners, fill=AGENT)
    return picture
