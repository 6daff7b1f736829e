"""The picture of a fleet's traffic: where agents drive, wait and work, and how it goes on."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from textwrap import wrap
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import ListedColormap
from matplotlib.figure import Figure
from matplotlib.patheffects import withStroke
from matplotlib.ticker import PercentFormatter

from qdenv.grid import of_tiles
from qdenv.study.recordings import Maps, Spot, throughput_over_time, worst_cells
from qdenv.view.style import PALETTE, WARNING, new_figure, styled
from qdenv.view.widths import SCREEN

if TYPE_CHECKING:
    from qdenv.study.plans import Plan
    from qdenv.study.traffic import Study

_WALL = "#5f6368"
_FLOOR = "#ffffff"
LINE = PALETTE[0]
_PLACE = (1.03, 0.05, 0.04, 0.9)  # of a colour bar, in shares of its map: left, bottom, size
BESIDE = 1.2  # inches of a colour bar, its labels, and those of the rows
TITLES = 0.75  # inches above and below a map
_ABREAST = 5.0  # inches from which two panels stand side by side
_TALL = 0.5  # of the width: the height of throughput over time alone
_COLOURS = {"usage": "Blues", "waiting": "Reds", "finished": "Greens"}
_LETTERS_PER_INCH = 13  # of a title
_KEY = 6.5  # points of a rank, and of a cell that has room for it


class Scene(NamedTuple):
    """What the picture shows."""

    free: np.ndarray  # bool [H, W], cells that agents may drive on
    maps: Maps  # averaged over the runs
    worst: Sequence[Spot]  # the worst cells, the worst first
    # [3, n]: ends of windows of time, mean throughput in each, its standard error
    over_time: np.ndarray
    jams: Sequence[int]  # timesteps at which runs congested
    title: str  # of the whole picture
    runs: int  # how many there were
    stop: bool = True  # congestion ended those that congested


def scene_of(plan: Plan, study: Study, title: str, stop: bool = True) -> Scene:
    """Make the scene of a study that looked at where agents wait.

    Args:
        plan: the layout, of a domain in which a fleet drives.
        study: with maps.
        title: of the whole picture.
        stop: congestion ended those that congested.
    """
    tasks, runs = plan.domain.simulator.tasks, study.done.runs
    assert tasks is not None and study.maps is not None
    return Scene(
        free=np.asarray(of_tiles(plan.layout, tasks.traversable, tasks.tiles)),
        maps=study.maps,
        worst=worst_cells(plan.layout, study.maps),
        over_time=throughput_over_time(runs),
        jams=[int(run.congested_at) for run in runs if run.congested],
        title=title,
        runs=len(runs),
        stop=stop,
    )


@styled
def draw_traffic(scene: Scene, width: float = SCREEN) -> Figure:
    """Draw the floor plan three times and the throughput over time.

    Rows and columns are numbered as in the table of the worst cells, from 0 at the top left.

    Args:
        scene: what is drawn.
        width: in inches; on narrow paper one panel stands below the other.
    """
    across = 2 if width >= _ABREAST else 1
    tall = _tallness(scene)
    height = len(_PANELS) // across * ((width / across - BESIDE) * tall + TITLES) + 0.3
    figure = new_figure(width, height)
    figure.suptitle("\n".join(wrap(scene.title, int(_LETTERS_PER_INCH * width))))
    every = figure.subplots(len(_PANELS) // across, across).ravel()
    for axes, draw in zip(every, _PANELS.values(), strict=True):
        draw(axes, scene)
    every[-1].set_box_aspect(tall)
    return figure


@styled
def draw_panel(scene: Scene, kind: str, width: float) -> Figure:
    """Draw one of the four panels alone: "waiting", "usage", "finished" or "time"."""
    time = kind == "time"
    height = _TALL * width if time else (width - BESIDE) * _tallness(scene) + TITLES
    figure = new_figure(width, height)
    axes = figure.subplots()
    _PANELS[kind](axes, scene)
    axes.set_title("")  # whatever stands around it says so
    return figure


def _tallness(scene: Scene) -> float:
    rows, cols = scene.free.shape
    return float(np.clip(rows / cols, 0.4, 1.6))


def _draw_waiting(axes: Axes, scene: Scene) -> None:
    """Draw the share of time in which one waits on each cell, and number the worst cells."""
    maps = scene.maps
    label = "share of time in which one waits here"
    title = f"where agents wait: {maps.waiting_share:.1%} of their time"
    draw_map(axes, scene.free, maps.waiting, "waiting", label, title)
    _number_worst(axes, scene)


def _draw_usage(axes: Axes, scene: Scene) -> None:
    """Draw the share of time in which an agent is on each cell."""
    label = "share of time in which one is here"
    draw_map(axes, scene.free, scene.maps.usage, "usage", label, "where agents are")


def _draw_finished(axes: Axes, scene: Scene) -> None:
    """Draw how many tasks are finished on each cell."""
    finished = scene.maps.finished
    title = f"where tasks are finished: {finished.sum():.2f} a timestep"
    draw_map(axes, scene.free, finished, "finished", "tasks per timestep here", title)


def draw_map(
    axes: Axes, free: np.ndarray, values: np.ndarray, kind: str, label: str, title: str = ""
) -> None:
    """Draw one number per cell over the walls, with a colour bar; cells without any stay white.

    Args:
        axes: where.
        free: bool [H, W].
        values: float [H, W].
        kind: "usage" or "waiting", shares that are written in per cent, or "finished".
        label: of the colour bar.
        title: above.
    """
    axes.imshow(free, cmap=ListedColormap([_WALL, _FLOOR]), vmin=0, vmax=1)
    shown = np.ma.masked_where(values <= 0, values)
    # One extreme cell must not wash out all others; the bar's tip says that there is more.
    top = float(np.quantile(values[values > 0], 0.995)) if (values > 0).any() else 1.0
    image = axes.imshow(shown, cmap=_COLOURS[kind], vmin=0, vmax=top, interpolation="nearest")
    axes.set_title(title)
    axes.spines[:].set_visible(True)
    axes.set(xlabel="column", ylabel="row")
    assert axes.figure is not None
    extend = "max" if values.max() > top else "neither"
    bar = axes.figure.colorbar(image, cax=axes.inset_axes(_PLACE), extend=extend)
    bar.set_label(label)
    bar.outline.set_linewidth(0.4)
    if kind != "finished":
        bar.ax.yaxis.set_major_formatter(PercentFormatter(1.0))


def _number_worst(axes: Axes, scene: Scene) -> None:
    """Mark the worst cells, with their rank where there is room for it."""
    specification = axes.get_subplotspec()
    assert isinstance(axes.figure, Figure) and specification is not None
    inches = axes.figure.get_figwidth() / specification.get_gridspec().ncols - BESIDE
    side = 72 * inches / max(scene.free.shape)
    for rank, spot in enumerate(scene.worst, 1):
        place = (spot.column, spot.row)
        axes.plot(*place, "s", markersize=max(0.9 * side, 3), mfc="none", mec="black", mew=0.7)
        if side >= _KEY:
            text = axes.text(*place, str(rank), ha="center", va="center", fontsize=_KEY)
            text.set_path_effects([withStroke(linewidth=1.4, foreground="white")])


def _draw_time(axes: Axes, scene: Scene) -> None:
    """Draw throughput over time, with a band of one standard error and the jams."""
    ends, mean, error = scene.over_time
    label = f"mean of {scene.runs} runs" if scene.runs > 1 else "one run"
    steps = np.concatenate([[0], ends])
    axes.stairs(mean, steps, color=LINE, baseline=None, label=label, linewidth=1.4)
    if not np.isnan(error).any():
        low, high = (np.append(side, side[-1]) for side in (mean - error, mean + error))
        label = "+- standard error"
        axes.fill_between(steps, low, high, step="post", alpha=0.25, lw=0, color=LINE, label=label)
    for place, jam in enumerate(scene.jams):
        after = "ended" if scene.stop else "went on"
        word = f"{len(scene.jams)} of {scene.runs} runs congested, and {after}"
        axes.axvline(jam, color=WARNING, linestyle=":", label=None if place else word)
    axes.set(xlabel="timestep", ylabel="throughput [tasks / timestep]")
    axes.set(xlim=(0, ends[-1]), ylim=(0, None), title="finished tasks over time")
    axes.grid()
    # Below the panel: inside, it would cover the line.
    axes.legend(loc="upper center", bbox_to_anchor=(0.5, 0), borderaxespad=4.2)


# What draws each panel, in reading order.
_PANELS: dict[str, Callable[[Axes, Scene], None]] = {
    "waiting": _draw_waiting,
    "usage": _draw_usage,
    "finished": _draw_finished,
    "time": _draw_time,
}
