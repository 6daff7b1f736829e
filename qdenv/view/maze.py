"""Pictures of mazes: one episode of the agent as a GIF (Figure 7c), many mazes (Figure 15)."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Protocol

import numpy as np
from matplotlib.colors import ListedColormap
from matplotlib.figure import Figure
from matplotlib.ticker import PercentFormatter
from PIL import Image, ImageDraw

from qdenv.types import InputError
from qdenv.view.film import TRIANGLE, save_gif
from qdenv.view.style import PALETTE, add_legend, new_figure, paper_figure, save_figure, styled
from qdenv.view.traffic import BESIDE, TITLES, add_bar, draw_map
from qdenv.view.widths import PAGE

EMPTY, WALL, GOAL, TRAIL, AGENT, START = range(6)
PIXEL_COLOURS = (
    (20, 20, 20),
    (128, 128, 128),
    (60, 170, 80),
    (70, 62, 30),
    (245, 200, 40),
    (60, 90, 160),
)
ACROSS = 6  # panels side by side
PANEL = 2.3  # inches


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
    save_gif(path, pictures, len(pictures), seconds)


def _frame(layout: np.ndarray, goal: int, path: np.ndarray, heading: int, cell: int) -> Image.Image:
    """Draw the maze, the way so far and the agent on top of it."""
    colours = np.where(layout == 1, WALL, EMPTY).astype(np.uint8).reshape(-1)
    colours[path] = TRAIL
    colours[path[0]], colours[goal] = START, GOAL
    large = np.kron(colours.reshape(layout.shape), np.ones((cell, cell), np.uint8))
    picture = Image.fromarray(large, "P")
    picture.putpalette(sum(PIXEL_COLOURS, ()))
    row, col = divmod(int(path[-1]), layout.shape[1])
    turn = heading * np.pi / 2
    right, down = TRIANGLE.T
    x = col + 0.5 + right * np.cos(turn) - down * np.sin(turn)
    y = row + 0.5 + right * np.sin(turn) + down * np.cos(turn)
    corners = [(float(a) * cell, float(b) * cell) for a, b in zip(x, y, strict=True)]
    ImageDraw.Draw(picture).polygon(corners, fill=AGENT)
    return picture


class Maze(Protocol):
    """What is drawn of a maze."""

    @property
    def layout(self) -> np.ndarray:
        """Layout, int8 [H, W]."""

    @property
    def start(self) -> int:
        """Cell of the start."""

    @property
    def goal(self) -> int:
        """Cell of the goal."""


def save_mazes(path: Path, mazes: Sequence[Maze], titles: Sequence[str]) -> None:
    """Save a panel for each maze, its start blue and its goal green (Figure 15).

    Args:
        path: the picture; its ending chooses the format.
        mazes: at least one.
        titles: one for each.

    Raises:
        InputError: the place cannot be written to.
    """
    across = min(len(mazes), ACROSS)
    down = -(-len(mazes) // across)
    figure = new_figure(PANEL * across, (PANEL + 0.25) * down)
    panels = figure.subplots(down, across, squeeze=False).ravel()
    colours = ListedColormap([tuple(level / 255 for level in colour) for colour in PIXEL_COLOURS])
    for ax, maze, title in zip(panels, mazes, titles, strict=False):
        kinds = np.where(maze.layout == 1, WALL, EMPTY).reshape(-1)
        kinds[maze.start], kinds[maze.goal] = START, GOAL
        ax.imshow(
            kinds.reshape(maze.layout.shape),
            cmap=colours,
            vmin=-0.5,
            vmax=len(PIXEL_COLOURS) - 0.5,
            interpolation="nearest",
        )
        ax.set_title(title, fontsize=7)
    for ax in panels:
        ax.set_axis_off()
    save_figure(figure, path)


FLAT = 0.48  # of the width: the height of the curves


@styled
def draw_walks(free: np.ndarray, usage: np.ndarray, width: float) -> Figure:
    """Draw where the agent walks.

    Args:
        free: bool [H, W].
        usage: float [H, W], share of its actions that it takes on each cell.
        width: in inches.
    """
    rows, cols = free.shape
    figure = paper_figure(width, (width - BESIDE) * rows / cols + TITLES)
    axes = figure.subplots()
    draw_map(axes, free, usage, "usage")
    add_bar(axes, usage, "share of the actions taken here", percent=True)
    return figure


@styled
def draw_arrivals(arrivals: Mapping[str, np.ndarray], most: int, width: float = PAGE) -> Figure:
    """Draw the share of episodes that have reached the goal over the actions taken.

    Args:
        arrivals: by the maze's name: float [episodes], actions to the goal, NaN for none.
        most: actions after which an episode fails.
        width: in inches.
    """
    figure = paper_figure(width, FLAT * width)
    axes = figure.subplots()
    for place, (name, actions) in enumerate(arrivals.items()):
        reached = np.sort(actions[np.isfinite(actions)])
        steps = np.concatenate([[0], reached, [most]])
        share = np.concatenate([[0], np.arange(1, len(reached) + 1), [len(reached)]]) / len(actions)
        axes.step(steps, share, where="post", label=name, color=PALETTE[place % len(PALETTE)])
    axes.set(xlabel="actions", ylabel="episodes at the goal", xlim=(0, most), ylim=(0, 1.02))
    axes.yaxis.set_major_formatter(PercentFormatter(1.0))
    axes.grid()
    if len(arrivals) > 1:
        add_legend(figure, *axes.get_legend_handles_labels())
    return figure
