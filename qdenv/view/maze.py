"""Pictures of mazes: many of them (Figure 15), where the agent walks, how soon it arrives."""

from collections.abc import Mapping, Sequence
from typing import Protocol

import numpy as np
from matplotlib.colors import ListedColormap
from matplotlib.figure import Figure
from matplotlib.ticker import PercentFormatter

from qdenv.view.film import MARKS
from qdenv.view.layouts import COLOURS as TILES
from qdenv.view.style import PALETTE, add_legend, new_figure, styled
from qdenv.view.traffic import BESIDE, TITLES, draw_map
from qdenv.view.widths import PAGE

_ACROSS = 6  # panels side by side
_PANEL = 2.3  # inches


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


@styled
def draw_mazes(mazes: Sequence[Maze], titles: Sequence[str]) -> Figure:
    """Draw a panel for each maze, its start blue and its goal green (Figure 15).

    Args:
        mazes: at least one.
        titles: one for each.
    """
    across = min(len(mazes), _ACROSS)
    down = -(-len(mazes) // across)
    figure = new_figure(_PANEL * across, (_PANEL + 0.25) * down)
    panels = figure.subplots(down, across, squeeze=False).ravel()
    colours = ListedColormap([TILES[" "], TILES["X"], MARKS["start"], MARKS["reached"]])
    for ax, maze, title in zip(panels, mazes, titles, strict=False):
        kinds = maze.layout.copy()
        kinds.flat[[maze.start, maze.goal]] = 2, 3
        ax.imshow(kinds, cmap=colours, vmin=-0.5, vmax=3.5, interpolation="nearest")
        ax.set_title(title, fontsize=7)
        ax.set(xticks=[], yticks=[])
        ax.spines[:].set_visible(True)
    for ax in panels[len(mazes) :]:
        ax.set_axis_off()
    return figure


_FLAT = 0.48  # of the width: the height of the curves


@styled
def draw_walks(free: np.ndarray, usage: np.ndarray, width: float) -> Figure:
    """Draw where the agent walks.

    Args:
        free: bool [H, W].
        usage: float [H, W], share of its actions that it takes on each cell.
        width: in inches.
    """
    rows, cols = free.shape
    figure = new_figure(width, (width - BESIDE) * rows / cols + TITLES)
    axes = figure.subplots()
    draw_map(axes, free, usage, "usage", "share of the actions taken here")
    return figure


@styled
def draw_arrivals(arrivals: Mapping[str, np.ndarray], most: int, width: float = PAGE) -> Figure:
    """Draw the share of episodes that have reached the goal over the actions taken.

    Args:
        arrivals: by the maze's name: float [episodes], actions to the goal, NaN for none.
        most: actions after which an episode fails.
        width: in inches.
    """
    figure = new_figure(width, _FLAT * width)
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
