"""Pictures of searches: progress with its interval, archives side by side on one colour scale."""

from collections.abc import Sequence
from textwrap import wrap
from typing import Any, NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import PercentFormatter, StrMethodFormatter

from qdenv.plots.archive import draw_heatmap
from qdenv.plots.figure import (
    DASHES,
    GREY,
    PALETTE,
    SMALL,
    add_legend,
    paper_figure,
    styled,
)
from qdenv.plots.widths import PAGE
from qdenv.study.groups import CURVES, Group, band_of
from qdenv.types import Measure

NARROWEST = 1.65  # inches of one archive
ABREAST = 5.0  # inches from which the panels of progress stand side by side
TALL = 0.85  # of its width: the height of a panel
FLAT = 0.5  # likewise of one in a column
TITLES = 0.55  # inches above and below it
LETTERS_PER_INCH = 12  # of a label
MEANING = "lines: mean over runs, bands: its 95 % interval"


class Shown(NamedTuple):
    """One archive."""

    title: str  # whose
    objectives: np.ndarray  # float [C], row-major, not finite where a cell is empty
    measures: Sequence[Measure]  # its axes


@styled
def draw_progress(groups: Sequence[Group], objective: str, width: float = PAGE) -> Figure:
    """Draw QD-score, coverage and best objective over evaluations (Figure 20).

    A line for each group, the mean of its runs, with a band where there are several.

    Args:
        groups: of runs.
        objective: what is maximised, with its unit.
        width: in inches; on narrow paper the panels stand one below the other.
    """
    shape = (1, 3) if width >= ABREAST else (3, 1)
    tall = TALL if shape[0] == 1 else FLAT
    figure = paper_figure(width, shape[0] * (tall * width / shape[1] + TITLES))
    panels = figure.subplots(*shape, sharex=True).ravel()
    for axes, (name, title) in zip(panels, CURVES.items(), strict=True):
        for place, group in enumerate(groups):
            _draw_curve(axes, group, name, place)
        axes.set(title=title, ymargin=0.1)
        if name != "best_objective":  # which hardly moves, seen from zero
            lowest = min(float(group.curves[name].min()) for group in groups)
            axes.set_ylim(bottom=min(0.0, lowest))
        axes.grid()
        if name == "coverage":
            axes.yaxis.set_major_formatter(PercentFormatter(1.0))
        axes.locator_params(axis="x", nbins=4)
        axes.xaxis.set_major_formatter(StrMethodFormatter("{x:,.0f}"))
    panels[-1].set_ylabel(objective, fontsize=SMALL)
    for axes in panels if shape[0] == 1 else panels[-1:]:
        axes.set_xlabel("evaluations")
    if len(groups) > 1:
        add_legend(figure, *panels[0].get_legend_handles_labels())
    if any(len(group.runs) > 1 for group in groups):
        figure.supxlabel(MEANING, fontsize=SMALL, color=GREY)
    return figure


def _draw_curve(axes: Axes, group: Group, name: str, place: int) -> None:
    """Draw the mean of a group's runs, and its interval where it has one."""
    band, colour = band_of(group.curves[name]), PALETTE[place % len(PALETTE)]
    dashes = DASHES[place // len(PALETTE) % len(DASHES)]
    # A line through one point is nothing: the last point is marked.
    look: Any = {"marker": "o", "markevery": [len(band.mean) - 1], "linestyle": dashes}
    axes.plot(group.evaluations, band.mean, color=colour, label=group.title, **look)
    if len(group.runs) > 1:
        low, high = band.mean - band.half, band.mean + band.half
        axes.fill_between(group.evaluations, low, high, color=colour, alpha=0.2, lw=0)


@styled
def draw_archives(shown: Sequence[Shown], objective: str, width: float = PAGE) -> Figure:
    """Draw archives side by side, all on one colour scale.

    Args:
        shown: of one objective.
        objective: what the colours mean, with its unit.
        width: in inches.
    """
    across = min(len(shown), max(1, int(width / NARROWEST)))
    down = -(-len(shown) // across)
    figure = paper_figure(width, down * (TALL * width / across + TITLES) + TITLES)
    panels = figure.subplots(down, across, squeeze=False).ravel()
    filled = np.concatenate([one.objectives[np.isfinite(one.objectives)] for one in shown])
    low, high = (filled.min(), filled.max()) if len(filled) else (0.0, 1.0)
    image = None
    for place, (axes, one) in enumerate(zip(panels, shown, strict=False)):
        image = draw_heatmap(axes, one.objectives, one.measures, low, high)
        share = np.isfinite(one.objectives).mean()
        letters = int(LETTERS_PER_INCH * width / across)
        title = "\n".join([*wrap(one.title, letters), f"{share:.1%} filled"])
        axes.set_title(title, fontsize=SMALL + 0.5)
        axes.set_xlabel("\n".join(wrap(axes.get_xlabel(), letters)))
        if place % across and one.measures[1:] == shown[place - 1].measures[1:]:
            axes.set_ylabel("")
    for axes in panels[len(shown) :]:
        axes.set_axis_off()
    assert image is not None
    bar = figure.colorbar(
        image, ax=list(panels), location="bottom", shrink=0.6, aspect=40, label=objective
    )
    bar.outline.set_linewidth(0.4)
    return figure
