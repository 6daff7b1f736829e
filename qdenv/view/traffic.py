"""Pictures of traffic: where a fleet drives, waits and works, and where a maze's agent walks."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from textwrap import wrap
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import ListedColormap
from matplotlib.figure import Figure
from matplotlib.patheffects import withStroke
from matplotlib.ticker import MaxNLocator, PercentFormatter

from qdenv.study.recordings import Maps, throughput_over_time, worst_cells
from qdenv.view import SCREEN
from qdenv.view.guidance import aspect_of, draw_flow, draw_preferences
from qdenv.view.style import ABREAST, PALETTE, WARNING, add_legend, colour, new_figure, styled

if TYPE_CHECKING:
    from qdenv.study.plans import Plan
    from qdenv.study.traffic import Study

LINE = PALETTE[0]
_BESIDE = 1.2  # inches of a colour bar, its labels, and those of the rows
_TITLES = 0.75  # inches above and below a map
_COLOURS = {"waiting": "Reds", "usage": "Blues", "finished": "Greens"}
_KEY = 6.5  # points of a rank, and of a cell that it fits into


class Scene(NamedTuple):
    """What the picture shows."""

    free: np.ndarray  # bool [H, W], cells that agents may drive on
    maps: Maps  # averaged over the runs
    worst: Sequence[Mapping[str, Any]]  # the worst cells, see `recordings.worst_cells`
    # [3, n]: ends of windows of time, mean throughput in each, its standard error
    over_time: np.ndarray
    jams: Sequence[int]  # timesteps at which runs congested
    runs: int  # number of runs
    stop: bool = True  # congestion ended those that congested
    costs: np.ndarray | None = None  # float [5, H, W], guidance; None for none
    tops: Mapping[str, float] = {}  # upper ends of maps' colour scales, by kind; their own else


def make_scene(plan: Plan, study: Study, stop: bool = True) -> Scene:
    """Make the scene of a study with maps, on a layout of a domain in which a fleet drives."""
    runs = study.done.runs
    assert study.maps is not None
    return Scene(
        free=plan.domain.drivable(plan.layout),
        maps=study.maps,
        worst=worst_cells(plan.layout, study.maps),
        over_time=throughput_over_time(runs),
        jams=[int(run.congested_at) for run in runs if run.congested],
        runs=len(runs),
        stop=stop,
        costs=plan.costs,
    )


@styled
def draw_traffic(scene: Scene, title: str, width: float = SCREEN) -> Figure:
    """Draw the floor plan three times, and the throughput over time; guidance, and who obeys it.

    Rows and columns are numbered as in the table of the worst cells, from 0 at the top left; on
    narrow paper one panel stands below the other.
    """
    across = 2 if width >= ABREAST else 1
    tall = aspect_of(scene.free)
    kinds = (*_COLOURS, "time", *(() if scene.costs is None else ("guidance", "flow")))
    down = len(kinds) // across
    figure = new_figure(width, down * ((width / across - _BESIDE) * tall + _TITLES) + 0.3)
    figure.suptitle("\n".join(wrap(title, int(13 * width))))  # 13 letters fit an inch
    panels = figure.subplots(down, across).ravel()
    for axes, kind in zip(panels, kinds, strict=True):
        _draw_panel(axes, scene, kind)
    panels[len(_COLOURS)].set_box_aspect(tall)
    return figure


@styled
def draw_panel(scene: Scene, kind: str, width: float) -> Figure:
    """Draw one panel alone: "waiting", "usage", "finished" or "time"; "guidance" or "flow"."""
    high = 0.5 * width if kind == "time" else (width - _BESIDE) * aspect_of(scene.free) + _TITLES
    figure = new_figure(width, high)
    axes = figure.subplots()
    _draw_panel(axes, scene, kind)
    axes.set_title("")  # the caption around it says so
    return figure


def _draw_panel(axes: Axes, scene: Scene, kind: str) -> None:
    """Draw one map, throughput over time, or arrows."""
    maps = scene.maps
    if kind == "time":
        _draw_time(axes, scene)
    elif kind == "guidance" and scene.costs is not None:
        draw_preferences(axes, scene.free, scene.costs)
    elif kind == "flow" and scene.costs is not None:
        draw_flow(axes, scene.free, scene.costs, maps.moves)
    elif kind == "usage":
        label = "share of time in which one is here"
        title, top = "where agents are", scene.tops.get(kind)
        draw_map(axes, scene.free, maps.usage, kind, label, title, top)
    elif kind == "finished":
        title = f"where tasks are finished: {maps.finished.sum():.2f} a timestep"
        draw_map(axes, scene.free, maps.finished, kind, "tasks per timestep here", title)
    else:
        label = "share of time in which one waits here"
        title = f"where agents wait: {maps.waiting_share:.1%} of their time"
        draw_map(axes, scene.free, maps.waiting, kind, label, title, scene.tops.get(kind))
        # The worst cells are marked, with their rank where it fits.
        specification = axes.get_subplotspec()
        assert isinstance(axes.figure, Figure) and specification is not None
        inches = axes.figure.get_figwidth() / specification.get_gridspec().ncols - _BESIDE
        side = 72 * inches / max(scene.free.shape)  # points of a cell
        look: Any = {"mfc": "none", "mec": "black", "mew": 0.7}
        for rank, spot in enumerate(scene.worst, 1):
            across, down = spot["column"], spot["row"]
            axes.plot(across, down, "s", markersize=max(0.9 * side, 3), **look)
            if side >= _KEY:
                place: Any = {"ha": "center", "va": "center", "fontsize": _KEY}
                text = axes.text(across, down, str(rank), **place)
                text.set_path_effects([withStroke(linewidth=1.4, foreground="white")])


@styled
def draw_walks(free: np.ndarray, usage: np.ndarray, width: float) -> Figure:
    """Draw where the agent of a maze walks: its share of actions on each cell, float [H, W]."""
    rows, cols = free.shape
    figure = new_figure(width, (width - _BESIDE) * rows / cols + _TITLES)
    draw_map(figure.subplots(), free, usage, "usage", "share of the actions taken here")
    return figure


@styled
def draw_arrivals(arrivals: Mapping[str, np.ndarray], most: int, width: float) -> Figure:
    """Draw the share of a maze's episodes that have reached the goal over the actions taken.

    `arrivals` are the actions to the goal by the maze's name, float [episodes], NaN if an episode
    failed; `most` is the largest number of actions of any.
    """
    figure = new_figure(width, 0.48 * width)
    axes = figure.subplots()
    for place, (name, actions) in enumerate(arrivals.items()):
        reached = np.sort(actions[np.isfinite(actions)])
        # A step up at each arrival, from no action to the last one.
        steps = np.concatenate([[0], reached, [most]])
        share = np.concatenate([[0], np.arange(1, len(reached) + 1), [len(reached)]]) / len(actions)
        axes.step(steps, share, where="post", label=name, color=colour(place))
    axes.set(xlabel="actions", ylabel="episodes at the goal", xlim=(0, most), ylim=(0, 1.02))
    axes.yaxis.set_major_formatter(PercentFormatter(1.0))
    axes.grid()
    if len(arrivals) > 1:
        add_legend(figure, axes)
    return figure


def top_of(values: np.ndarray) -> float:
    """Return the upper end of a map's colour scale; one extreme cell must not wash out others."""
    return float(np.quantile(values[values > 0], 0.995)) if (values > 0).any() else 1.0


def draw_map(
    axes: Axes,
    free: np.ndarray,
    values: np.ndarray,
    kind: str,
    label: str,
    title: str = "",
    top: float | None = None,
) -> None:
    """Draw a number per cell (float [H, W]) over the walls, with a colour bar; zeros stay white.

    `kind` is "usage" or "waiting", shares that are written in per cent, or "finished"; `top` is the
    upper end of the scale, that of the values unless given.
    """
    # Fixed ends: a map without any wall would else be all grey.
    axes.imshow(free, cmap=ListedColormap(["#5f6368", "#ffffff"]), vmin=0, vmax=1)
    shown = np.ma.masked_where(values <= 0, values)
    top = top_of(values) if top is None else top
    image = axes.imshow(shown, cmap=_COLOURS[kind], vmin=0, vmax=top, interpolation="nearest")
    axes.set_title(title)
    axes.spines[:].set_visible(True)
    axes.set(xlabel="column", ylabel="row")
    axes.yaxis.set_major_locator(MaxNLocator(integer=True))
    assert axes.figure is not None
    # The bar's tip says that there is more.
    extend = "max" if values.max() > top else "neither"
    beside = axes.inset_axes((1.03, 0.05, 0.04, 0.9))  # shares of the map: left, bottom, size
    bar = axes.figure.colorbar(image, cax=beside, extend=extend)
    bar.set_label(label)
    bar.outline.set_linewidth(0.4)
    if kind != "finished":
        bar.ax.yaxis.set_major_formatter(PercentFormatter(1.0))


def _draw_time(axes: Axes, scene: Scene) -> None:
    """Draw throughput over time, with a band of one standard error and the jams."""
    ends, mean, error = scene.over_time
    label = f"mean of {scene.runs} runs" if scene.runs > 1 else "one run"
    steps = np.concatenate([[0], ends])
    axes.stairs(mean, steps, color=LINE, baseline=None, label=label, linewidth=1.4)
    if not np.isnan(error).any():
        # The last value counts up to the end of its window, as in the line.
        low, high = (np.append(side, side[-1]) for side in (mean - error, mean + error))
        label = "+- standard error"
        axes.fill_between(steps, low, high, step="post", alpha=0.25, lw=0, color=LINE, label=label)
    for place, jam in enumerate(scene.jams):
        after = "ended" if scene.stop else "went on"
        label = f"{len(scene.jams)} of {scene.runs} runs congested, and {after}"
        axes.axvline(jam, color=WARNING, linestyle=":", label=None if place else label)
    axes.set(xlabel="timestep", ylabel="throughput [tasks / timestep]")
    axes.set(xlim=(0, ends[-1]), ylim=(0, None), title="finished tasks over time")
    axes.grid()
    # Below the panel: inside, it would cover the line.
    axes.legend(loc="upper center", bbox_to_anchor=(0.5, 0), borderaxespad=4.2)
