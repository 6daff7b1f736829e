"""The heat map of an archive: one coloured cell per elite."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.image import AxesImage
from matplotlib.patches import Patch
from numpy.typing import ArrayLike

from qdenv.types import InputError, Measure
from qdenv.view.style import new_figure, save_figure, styled

COLOURS = "viridis"
_EMPTY = "#f2f2f2"
WIDTH, TALL = 6.0, 0.8  # inches of a picture, and its height as a share of that


def objective_grid(objectives: ArrayLike, measures: Sequence[Measure]) -> np.ndarray:
    """Lay the objectives of all cells [C] out as a grid [cells_0, cells_1], NaN where empty.

    Args:
        objectives: float [C], row-major, not finite where a cell is empty.
        measures: one or two.

    Raises:
        InputError: there are more than two measures, or the number of cells differs.
    """
    if len(measures) not in (1, 2):
        raise InputError(f"a heat map shows one or two measures, not {len(measures)}")
    shape = tuple(int(axis.cells) for axis in measures)
    values = np.asarray(objectives, dtype=float).reshape(-1)
    if values.size != np.prod(shape):
        raise InputError(f"{values.size} objectives do not fill a grid of {shape} cells")
    grid = np.where(np.isfinite(values), values, np.nan).reshape(shape)
    return grid if len(shape) == 2 else grid[:, None]


def scatter_objectives(
    index: ArrayLike, objective: ArrayLike, measures: Sequence[Measure]
) -> np.ndarray:
    """Turn saved elites into the objectives of all cells, float [C], NaN where empty.

    Args:
        index: int [elites], their cells.
        objective: float [elites].
        measures: the axes of the archive.
    """
    objectives = np.full(int(np.prod([axis.cells for axis in measures])), np.nan)
    objectives[np.asarray(index)] = np.asarray(objective)
    return objectives


def draw_heatmap(
    axes: Axes,
    objectives: ArrayLike,
    measures: Sequence[Measure],
    low: float | None = None,
    high: float | None = None,
) -> AxesImage:
    """Draw the heat map into matplotlib `axes`; give the image, for a colour bar.

    The first measure runs to the right, the second upwards.

    Args:
        axes: matplotlib axes.
        objectives: float [C], row-major, not finite where a cell is empty.
        measures: one or two.
        low: objective of the darkest colour; the least by default.
        high: objective of the brightest colour; the greatest by default.
    """
    grid = objective_grid(objectives, measures)
    first, second = measures[0], measures[1] if len(measures) == 2 else None
    bottom, top = (second.low, second.high) if second else (0.0, 1.0)
    filled = np.isfinite(grid).any()
    image = axes.imshow(
        grid.T,
        origin="lower",
        extent=(first.low, first.high, bottom, top),
        aspect="auto",
        interpolation="nearest",
        cmap=COLOURS,
        vmin=low if low is not None or filled else 0,
        vmax=high if high is not None or filled else 1,
    )
    axes.set_facecolor(_EMPTY)
    axes.set_xlabel(first.name)
    if second:
        axes.set_ylabel(second.name)
    else:
        axes.set_yticks([])
    return image


@styled
def draw_archive(
    figure: Figure,
    objectives: ArrayLike,
    measures: Sequence[Measure],
    title: str = "",
    label: str = "objective",
    low: float | None = None,
    high: float | None = None,
) -> None:
    """Draw a heat map with its colour bar and heading into an empty figure.

    Args:
        figure: where.
        objectives: float [C], row-major, not finite where a cell is empty.
        measures: one or two.
        title: printed above, beside the share of filled cells.
        label: what the colours mean.
        low: objective of the darkest colour.
        high: objective of the brightest colour.

    Raises:
        InputError: the objectives do not fit the grid.
    """
    axes = figure.add_subplot()
    image = draw_heatmap(axes, objectives, measures, low, high)
    axes.set_title(describe_filling(objectives, title), fontsize="medium")
    values = np.asarray(objectives, dtype=float)
    values = values[np.isfinite(values)]
    if low is None and high is None and len(values) and values.min() == values.max():
        # A scale of one colour says nothing; matplotlib would invent a range around it.
        said = f"{label}: {values[0]:g} in every filled cell"
        red, green, blue, _ = (float(part) for part in image.to_rgba(values[0]))
        patch = Patch(facecolor=(red, green, blue), label=said)
        figure.legend(handles=[patch], loc="outside lower center", frameon=False)
    else:
        figure.colorbar(image, ax=axes, label=label)


def save_heatmap(
    path: str | Path,
    objectives: ArrayLike,
    measures: Sequence[Measure],
    title: str = "",
    label: str = "objective",
    width: float = WIDTH,
) -> None:
    """Save the heat map of an archive as an image, atomically.

    Args:
        path: where; the suffix decides the format (png, pdf, svg). The other arguments, and what
            may go wrong, are those of `draw_archive`.
        objectives: float [C], row-major, not finite where a cell is empty.
        measures: one or two.
        title: printed above, beside the share of filled cells.
        label: what the colours mean.
        width: in inches.

    Raises:
        InputError: the objectives do not fit the grid, or the place cannot be written to.
    """
    figure = new_figure(width, TALL * width)
    draw_archive(figure, objectives, measures, title, label)
    save_figure(figure, path)


def describe_filling(objectives: ArrayLike, title: str = "") -> str:
    """Write the heading of a heat map: the title, and the share of filled cells."""
    filled = np.isfinite(np.asarray(objectives, dtype=float))
    share = f"{filled.mean():.1%} of {filled.size:,} cells filled"
    return f"{title} ({share})" if title else share


_SIDE = 3.4  # inches of a panel
_ROOM = 0.04  # of a panel's range, beyond the outermost points
_POINT_COLOUR = "#0072b2"
_LINE_COLOUR = "#b5432d"


@styled
def draw_predictions(
    panels: Mapping[str, tuple[np.ndarray, np.ndarray, str]], title: str
) -> Figure:
    """Draw a panel for each number: every held-out elite, and the diagonal of perfect predictions.

    Args:
        panels: by the label of the number: true values, predicted values, what the title says.
        title: of the figure.
    """
    figure = new_figure(_SIDE * len(panels), _SIDE + 0.45)
    every: Sequence[Axes] = figure.subplots(1, len(panels), squeeze=False)[0]
    for axes, (label, (truth, predicted, said)) in zip(every, panels.items(), strict=True):
        both = np.concatenate([truth, predicted])
        room = _ROOM * max(float(np.ptp(both)), 1e-6)
        ends = (both.min() - room, both.max() + room)
        axes.plot(ends, ends, color=_LINE_COLOUR, linewidth=1, zorder=1)
        axes.scatter(truth, predicted, s=9, alpha=0.5, color=_POINT_COLOUR, linewidths=0, zorder=2)
        axes.set(xlim=ends, ylim=ends, aspect="equal", xlabel=f"true {label}")
        axes.set_title(said, fontsize=9)
        axes.grid(alpha=0.3)
    every[0].set_ylabel("predicted")
    figure.suptitle(title, fontsize=10)
    return figure
