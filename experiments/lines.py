"""Lines and bands of figures, told apart in colour and in grey."""

from collections.abc import Sequence
from typing import NamedTuple, TypeAlias

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from qdenv.study.groups import band_of
from qdenv.view.style import new_figure

Values: TypeAlias = Sequence[float] | np.ndarray


class Look(NamedTuple):
    """How the layouts of one maker are drawn; colours of Okabe and Ito 2008."""

    label: str  # in the legend
    colour: str  # of line and band
    style: str  # of the line
    marker: str  # of its points


LOOKS = {
    "nca": Look("CMA-MAE + NCA, first zoo", "#0072B2", "-", "o"),
    "nca-s": Look("CMA-MAE + NCA, first zoo's best at S", "#56B4E9", "-", "D"),
    "zoo": Look("CMA-MAE + NCA, zoo", "#56B4E9", ":", "o"),
    "cma-mae": Look("CMA-MAE + NCA, seed 1", "#000000", "-", "x"),
    "cma-mae-2": Look("CMA-MAE + NCA, seed 2", "#000000", ":", "+"),
    "a1": Look("CMA-MAE + NCA, alpha = 1", "#999999", "--", "x"),
    "a0": Look("CMA-MAE + NCA, alpha = 0", "#999999", ":", "x"),
    "human": Look("hand-made", "#D55E00", "--", "s"),
    "cma-es": Look("CMA-ES + NCA", "#E69F00", "-.", "^"),
    "tiled": Look("tiled", "#009E73", ":", "v"),
}


def new_panels(rows: int, columns: int, crown: Sequence[str]) -> tuple[Figure, np.ndarray]:
    """Make panels with a title above each column (Axes [rows, columns])."""
    figure = new_figure(3.9 * columns, 3.1 * rows + 0.4, dpi=100)  # inches
    panels = figure.subplots(rows, columns, squeeze=False)
    for axes, title in zip(panels[0], crown, strict=True):
        axes.set_title(title)
    for axes in panels.flat:
        axes.grid(alpha=0.3)
    return figure, panels


def draw_line(axes: Axes, places: Values, mean: Values, half: Values, maker: str) -> None:
    """Draw a mean over places and its 95 % interval, of half that width (NaN for none)."""
    look, mean, half = LOOKS[maker], np.asarray(mean), np.nan_to_num(half)
    few = look.marker if len(places) < 20 else ""
    axes.fill_between(places, mean - half, mean + half, color=look.colour, alpha=0.25, lw=0)
    axes.plot(
        places, mean, ls=look.style, marker=few, ms=5, color=look.colour, label=look.label, lw=1.5
    )


def draw_band(
    axes: Axes, places: Values, values: np.ndarray, look: tuple[str, str], label: str
) -> None:
    """Draw the mean of runs (float [runs, places]) in a colour and style, its 95 % interval shaded.

    One run has no interval.
    """
    (colour, style), (mean, half) = look, band_of(values)
    axes.plot(places, mean, style, color=colour, label=label)
    if len(values) > 1:
        axes.fill_between(places, mean - half, mean + half, color=colour, alpha=0.2, linewidth=0)


def finish(figure: Figure, panels: np.ndarray) -> None:
    """Add one legend for all panels, and a note to those without lines."""
    named: dict[str, Artist] = {}
    for axes in panels.flat:
        handles, labels = axes.get_legend_handles_labels()
        named |= dict(zip(labels, handles, strict=True))
        if not handles:
            axes.text(0.5, 0.5, "not made yet", ha="center", va="center", transform=axes.transAxes)
            axes.set(xticks=[], yticks=[])
            continue
        axes.set_ylim(0, 1.05 * axes.get_ylim()[1])  # a margin even where all is one point
    if named:
        figure.legend([*named.values()], [*named], loc="outside lower center", ncols=len(named))
