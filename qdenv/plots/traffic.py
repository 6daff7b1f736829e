"""The picture of a fleet's traffic: where agents drive, wait and work, and how it goes on."""

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import ListedColormap
from matplotlib.figure import Figure
from matplotlib.patheffects import withStroke
from matplotlib.ticker import PercentFormatter

from qdenv.plots.figure import new_figure, save_figure
from qdenv.study.jams import Maps, Spot

WALL = "#5f6368"
FLOOR = "#ffffff"
LINE = "#1f5fa8"
JAM = "#b5432d"
PANEL = 5.0  # inches of a map's width
BAR = 1.4  # inches of a colour bar and its labels
TITLES = 0.8  # inches above and below a map
COLOURS = {"usage": "Blues", "waiting": "Reds", "finished": "Greens"}
NUMBERED = 60  # rows or columns up to which the worst cells are numbered in the map


class Scene(NamedTuple):
    """What the picture shows.

    Attributes:
        free: bool [H, W], cells that agents may drive on.
        maps: averaged over the runs.
        worst: the worst cells, the worst first.
        over_time: [3, n]: ends of windows of time, mean throughput in each, its standard error.
        jams: timesteps at which runs congested.
        title: of the whole picture.
        runs: how many there were.
        stop: congestion ended those that congested.
    """

    free: np.ndarray
    maps: Maps
    worst: Sequence[Spot]
    over_time: np.ndarray
    jams: Sequence[int]
    title: str
    runs: int
    stop: bool = True


def save_traffic(path: str | Path, scene: Scene) -> None:
    """Save what `draw_traffic` draws; the ending of `path` chooses the format.

    Raises:
        InputError: the place cannot be written to.
    """
    save_figure(draw_traffic(scene), path)


def draw_traffic(scene: Scene) -> Figure:
    """Draw the floor plan three times and the throughput over time.

    Rows and columns are numbered as in the table of the worst cells, from 0 at the top left.
    """
    rows, cols = scene.free.shape
    tall = float(np.clip(rows / cols, 0.4, 1.6))
    figure = new_figure(2 * (PANEL + BAR), 2 * (PANEL * tall + TITLES) + 0.4)
    (waiting, usage), (finished, time) = figure.subplots(2, 2)
    figure.suptitle(scene.title)
    maps = scene.maps
    title = f"where agents wait: {maps.waiting_share:.1%} of their time"
    _draw_map(waiting, scene, maps.waiting, "waiting", title)
    _bar_of(waiting, maps.waiting, "time in which one waits here [% of all time]", percent=True)
    _number_worst(waiting, scene)
    _draw_map(usage, scene, maps.usage, "usage", "where agents are")
    _bar_of(usage, maps.usage, "time in which one is here [% of all time]", percent=True)
    _draw_map(finished, scene, maps.finished, "finished", "where tasks are finished")
    total = f"tasks per timestep here [all cells: {maps.finished.sum():.2f}]"
    _bar_of(finished, maps.finished, total, percent=False)
    _draw_time(time, scene)
    time.set_box_aspect(tall)
    return figure


def _draw_map(axes: Axes, scene: Scene, values: np.ndarray, kind: str, title: str) -> None:
    """Draw one number per cell over the walls; cells without any stay white."""
    axes.imshow(scene.free, cmap=ListedColormap([WALL, FLOOR]), vmin=0, vmax=1)
    shown = np.ma.masked_where(values <= 0, values)
    # One extreme cell must not wash out all others; the bar's tip says that there is more.
    top = float(np.quantile(values[values > 0], 0.995)) if (values > 0).any() else 1.0
    axes.imshow(shown, cmap=COLOURS[kind], vmin=0, vmax=top, interpolation="nearest")
    axes.set_title(title)
    axes.tick_params(labelsize=8)
    axes.set(xlabel="column", ylabel="row")


def _bar_of(axes: Axes, values: np.ndarray, label: str, percent: bool) -> None:
    """Add the colour bar of a map."""
    image = axes.images[-1]
    extend = "max" if values.max() > image.norm.vmax else "neither"
    assert axes.figure is not None
    bar = axes.figure.colorbar(image, ax=axes, shrink=0.85, extend=extend)
    bar.set_label(label)
    if percent:
        bar.ax.yaxis.set_major_formatter(PercentFormatter(1.0))


def _number_worst(axes: Axes, scene: Scene) -> None:
    """Mark the worst cells, with their rank where there is room for it."""
    rows, cols = scene.free.shape
    for rank, spot in enumerate(scene.worst, 1):
        place = (spot.column, spot.row)
        axes.plot(*place, "s", markersize=260 / max(rows, cols), mfc="none", mec="black", mew=0.9)
        if max(rows, cols) <= NUMBERED:
            text = axes.text(*place, str(rank), ha="center", va="center", fontsize=6.5)
            text.set_path_effects([withStroke(linewidth=1.2, foreground="white")])


def _draw_time(axes: Axes, scene: Scene) -> None:
    """Draw throughput over time, with a band of one standard error and the jams."""
    ends, mean, error = scene.over_time
    label = f"mean of {scene.runs} runs" if scene.runs > 1 else "one run"
    steps = np.concatenate([[0], ends])
    axes.stairs(mean, steps, color=LINE, baseline=None, label=label, linewidth=1.6)
    if not np.isnan(error).any():
        low, high = (np.append(side, side[-1]) for side in (mean - error, mean + error))
        label = "+- standard error"
        axes.fill_between(steps, low, high, step="post", alpha=0.25, color=LINE, label=label)
    for place, jam in enumerate(scene.jams):
        after = "ended" if scene.stop else "went on"
        word = f"{len(scene.jams)} of {scene.runs} runs congested, and {after}"
        axes.axvline(jam, color=JAM, linestyle=":", label=None if place else word)
    axes.set(xlabel="timestep", ylabel="throughput [tasks / timestep]")
    axes.set(xlim=(0, ends[-1]), ylim=(0, None), title="throughput over time")
    axes.grid(alpha=0.3)
    axes.legend(loc="best", framealpha=0.9, edgecolor="none")
