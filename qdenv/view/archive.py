"""The heat map of an archive, one coloured cell per elite; predictions of its numbers."""

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.image import AxesImage
from matplotlib.patches import Patch
from numpy.typing import ArrayLike

from qdenv.types import InputError, Measure
from qdenv.view.style import new_figure, styled, to_html

COLOURS = "viridis"
WIDTH, TALL = 6.0, 0.8  # inches of a picture, and its height as a share of that


def scatter_objectives(columns: Mapping[str, ArrayLike], measures: Sequence[Measure]) -> np.ndarray:
    """Return the objectives of all cells of a saved archive, float [C], NaN where empty."""
    objectives = np.full(int(np.prod([axis.cells for axis in measures])), np.nan)
    objectives[np.asarray(columns["index"])] = np.asarray(columns["objective"])
    return objectives


def draw_heatmap(
    axes: Axes,
    objectives: ArrayLike,
    measures: Sequence[Measure],
    low: float | None = None,
    high: float | None = None,
) -> AxesImage:
    """Draw the heat map of one or two measures, and return the image, for a colour bar.

    The first measure runs to the right, the second upwards. The objectives are float [C],
    row-major, not finite where a cell is empty; `low` and `high` are those of the darkest and the
    brightest colour, the least and the greatest by default. Raises InputError if there are more
    than two measures, or the number of cells differs.
    """
    if len(measures) not in (1, 2):
        raise InputError(f"a heat map shows one or two measures, not {len(measures)}")
    shape = tuple(int(axis.cells) for axis in measures)
    values = np.asarray(objectives, dtype=float).reshape(-1)
    if values.size != np.prod(shape):
        raise InputError(f"{values.size} objectives do not fill a grid of {shape} cells")
    # NaN is drawn as no colour, so that the axes' ground shows through.
    grid = np.where(np.isfinite(values), values, np.nan).reshape(shape[0], -1)
    first, second = measures[0], measures[1] if len(measures) == 2 else None
    bottom, top = (second.low, second.high) if second else (0.0, 1.0)
    filled = np.isfinite(grid).any()  # else matplotlib has no range of colours
    image = axes.imshow(
        grid.T,
        origin="lower",  # the second measure grows upwards
        extent=(first.low, first.high, bottom, top),
        aspect="auto",
        interpolation="nearest",
        cmap=COLOURS,
        vmin=low if low is not None or filled else 0,
        vmax=high if high is not None or filled else 1,
    )
    axes.set_facecolor("#f2f2f2")  # of empty cells
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
) -> Figure:
    """Draw a heat map into an empty figure, with its colour bar and the share of filled cells.

    `label` is what the colours mean; the rest, and the errors, are those of `draw_heatmap`.
    """
    axes = figure.add_subplot()
    image = draw_heatmap(axes, objectives, measures)
    values = np.asarray(objectives, dtype=float)
    filled = np.isfinite(values)
    share = f"{filled.mean():.1%} of {filled.size:,} cells filled"
    axes.set_title(f"{title} ({share})" if title else share, fontsize="medium")
    values = values[filled]
    if len(values) and values.min() == values.max():
        # A scale of one colour says nothing; matplotlib would invent a range around it.
        red, green, blue, _ = (float(part) for part in image.to_rgba(values[0]))
        text = f"{label}: {values[0]:g} in every filled cell"
        patch = Patch(facecolor=(red, green, blue), label=text)
        figure.legend(handles=[patch], loc="outside lower center")
    else:
        figure.colorbar(image, ax=axes, label=label)
    return figure


def archive_html(columns: Mapping[str, ArrayLike], measures: Sequence[Measure], label: str) -> str:
    """Return the heat map of a saved archive for a notebook; "" for more than two measures."""
    if len(measures) > 2:
        return ""
    figure, objectives = new_figure(WIDTH, TALL * WIDTH), scatter_objectives(columns, measures)
    return to_html(draw_archive(figure, objectives, measures, label=label))


@styled
def draw_predictions(
    true: np.ndarray, guessed: np.ndarray, panels: Mapping[str, str], title: str
) -> Figure:
    """Draw predicted over true numbers of held-out elites (float [n, panels]), and the diagonal.

    `panels` are their headings by the label of each number.
    """
    side = 3.4  # inches
    figure = new_figure(side * len(panels), side + 0.45)
    row: Sequence[Axes] = figure.subplots(1, len(panels), squeeze=False)[0]
    columns = zip(row, panels.items(), true.T, guessed.T, strict=True)
    for axes, (label, heading), truth, predicted in columns:
        both = np.concatenate([truth, predicted])
        margin = 0.04 * max(float(np.ptp(both)), 1e-6)  # beyond the outermost points
        ends = (both.min() - margin, both.max() + margin)
        axes.plot(ends, ends, color="#b5432d", linewidth=1, zorder=1)
        axes.scatter(truth, predicted, s=9, alpha=0.5, color="#0072b2", linewidths=0, zorder=2)
        axes.set(xlim=ends, ylim=ends, aspect="equal", xlabel=f"true {label}")
        axes.set_title(heading, fontsize=9)
        axes.grid(alpha=0.3)
    row[0].set_ylabel("predicted")
    figure.suptitle(title, fontsize=10)
    return figure
