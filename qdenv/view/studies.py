"""Pictures of studies: layouts side by side over numbers of agents, and up to their peaks."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.container import ErrorbarContainer
from matplotlib.figure import Figure
from matplotlib.ticker import PercentFormatter

from qdenv.stats import Difference, Sample, margin
from qdenv.study.table import Peak, Row, differences
from qdenv.view.style import (
    GREY,
    MARKERS,
    PALETTE,
    SMALL,
    WARNING,
    add_legend,
    name_of,
    paper_figure,
    save_figure,
    styled,
)
from qdenv.view.widths import PAGE

THROUGHPUT = "throughput [tasks / timestep]"
SUCCESS = "never congested"
MEANING = "error bars: standard error over {runs} runs above, 95 % Wilson interval below"
AGAINST = "\nper cent: against the first layout, over all runs, with 95 % interval"
SPREAD = 0.02  # of the axis: how far lines that would hide one another are moved apart
BAR_COLOUR = "#cfd8e3"
TALL = 0.66  # of the width: the height of layouts side by side
FLAT = 0.48  # likewise of one panel alone
LOWEST = 4.0  # inches of its height
ABREAST = 5.0  # inches from which two panels stand side by side


def save_comparison(path: str | Path, rows: Sequence[Row], width: float = PAGE) -> None:
    """Save what `draw_comparison` draws; the ending of `path` chooses the format.

    Raises:
        InputError: the place cannot be written to.
    """
    save_figure(draw_comparison(rows, width), path)


@styled
def draw_comparison(rows: Sequence[Row], width: float = PAGE) -> Figure:
    """Draw layouts side by side: throughput of successful runs above, success rates below.

    A line per layout over numbers of agents (Figure 22); bars where there is only
    one number of agents.

    Args:
        rows: of all layouts.
        width: in inches.
    """
    figure = paper_figure(width, max(TALL * width, LOWEST))
    above, below = figure.subplots(2, 1, sharex=True, height_ratios=(2, 1))
    layouts = _by_layout(rows)
    names = [own[0].layout for own in layouts]
    bars, against = len({row.agents for row in rows}) == 1, differences(rows)
    for place, own in enumerate(layouts):
        if bars:
            _draw_bar(above, place, own[0], against[rows.index(own[0])])
        else:
            _draw_line(above, own, place)
        moved = (place - (len(names) - 1) / 2) * SPREAD * max(row.agents for row in rows)
        places = [place] if bars else [row.agents + moved for row in own]
        _draw_success(below, places, own, place)
    if bars:
        below.set_xticks(range(len(names)), map(name_of, names), rotation=20, ha="right")
        above.set_title(f"{rows[0].agents} agents, {rows[0].runs} runs each")
    else:
        below.set(xlabel="agents", xlim=(0, 1.05 * max(row.agents for row in rows)))
        add_legend(figure, *above.get_legend_handles_labels())
    above.set(ylabel=THROUGHPUT, ylim=(0, None))
    below.set(ylabel=SUCCESS, ylim=(-0.05, 1.05))
    below.yaxis.set_major_formatter(PercentFormatter(1.0))
    meaning = MEANING.format(runs=rows[0].runs) + (AGAINST if bars and len(names) > 1 else "")
    if width < ABREAST:
        meaning = meaning.replace(" above, ", " above,\n").replace(", over all", ",\nover all")
    figure.supxlabel(meaning, fontsize=SMALL, color=GREY)
    for axes in (above, below):
        axes.grid()
    return figure


def _draw_bar(axes: Axes, place: int, row: Row, against: Difference) -> None:
    """Draw one layout's throughput as a bar with its standard error, and the numbers in it."""
    congested = np.isnan(row.throughput)  # no run to average over
    height, error = np.nan_to_num([row.throughput, row.standard_error])
    axes.bar([place], [height], 0.6, yerr=error, color=_colour(place))
    text = "every run congested" if congested else f"{row.throughput:.2f}"
    if not congested and not np.isnan(against.low):
        text += f"\n{against.percent:+.1f} %\n({against.low:+.1f} to {against.high:+.1f})"
    colour = "black" if congested else "white"
    axes.annotate(text, (place, height / 2), ha="center", va="center", color=colour, fontsize=SMALL)


def _colour(place: int) -> str:
    return PALETTE[place % len(PALETTE)]


def _draw_line(axes: Axes, rows: Sequence[Row], place: int) -> None:
    """Draw one layout's throughput over agents with its standard errors."""
    error = np.nan_to_num([row.standard_error for row in rows])
    agents, means = [row.agents for row in rows], [row.throughput for row in rows]
    _with_bars(axes, agents, means, error, rows[0].layout, place)


def _draw_success(axes: Axes, places: Sequence[float], rows: Sequence[Row], place: int) -> None:
    """Draw one layout's success rates with their Wilson intervals."""
    rate = np.array([row.success_rate for row in rows])
    low = rate - [row.success_low for row in rows]
    high = np.array([row.success_high for row in rows]) - rate
    # Rounding may put an end of the interval a hair beyond the rate.
    interval = np.maximum([low, high], 0)
    _with_bars(axes, places, rate, interval, rows[0].layout, place)


def _with_bars(
    axes: Axes,
    places: Sequence[float],
    values: Sequence[float] | np.ndarray,
    error: np.ndarray,
    layout: str,
    place: int,
) -> ErrorbarContainer:
    """Draw points with error bars in the look of the layout at this place."""
    look: Any = {"color": _colour(place), "marker": MARKERS[place % len(MARKERS)]}
    return axes.errorbar(places, values, error, label=name_of(layout), elinewidth=0.8, **look)


@styled
def draw_throughput(rows: Sequence[Row], width: float = PAGE) -> Figure:
    """Draw the mean throughput of all runs over agents, with its 95 % interval (Student's t).

    Args:
        rows: of all layouts.
        width: in inches.
    """
    figure, axes = _over_agents(rows, width)
    for place, own in enumerate(_by_layout(rows)):
        means = [row.mean_of_all for row in own]
        halves = [margin(Sample(row.mean_of_all, row.error_of_all, row.runs)) for row in own]
        agents = [row.agents for row in own]
        _with_bars(axes, agents, means, np.nan_to_num(halves), own[0].layout, place)
    axes.set(ylabel=THROUGHPUT, ylim=(0, None))
    if len(axes.containers) > 1:
        add_legend(figure, *axes.get_legend_handles_labels())
    return figure


@styled
def draw_success(rows: Sequence[Row], width: float = PAGE) -> Figure:
    """Draw the share of runs that never congested over agents, with its 95 % Wilson interval.

    Args:
        rows: of all layouts.
        width: in inches.
    """
    figure, axes = _over_agents(rows, width)
    layouts = _by_layout(rows)
    for place, own in enumerate(layouts):
        moved = (place - (len(layouts) - 1) / 2) * SPREAD * max(row.agents for row in rows)
        _draw_success(axes, [row.agents + moved for row in own], own, place)
    axes.set(ylabel=SUCCESS, ylim=(-0.05, 1.05))
    axes.yaxis.set_major_formatter(PercentFormatter(1.0))
    if len(layouts) > 1:
        add_legend(figure, *axes.get_legend_handles_labels())
    return figure


def _over_agents(rows: Sequence[Row], width: float) -> tuple[Figure, Axes]:
    figure = paper_figure(width, FLAT * width)
    axes = figure.subplots()
    axes.set(xlabel="robots", xlim=(0, 1.05 * max(row.agents for row in rows)))
    axes.grid()
    return figure, axes


def _by_layout(rows: Sequence[Row]) -> list[list[Row]]:
    names = dict.fromkeys(row.layout for row in rows)
    return [[row for row in rows if row.layout == name] for name in names]


def save_peaks(
    path: str | Path, rows: Sequence[Row], peaks: Sequence[Peak], width: float = PAGE
) -> None:
    """Save what `draw_peaks` draws; the ending of `path` chooses the format.

    Raises:
        InputError: the place cannot be written to.
    """
    save_figure(draw_peaks(rows, peaks, width), path)


@styled
def draw_peaks(rows: Sequence[Row], peaks: Sequence[Peak], width: float = PAGE) -> Figure:
    """Draw how layouts scale (Figure 18): throughput over agents, and the peaks over sizes.

    Args:
        rows: of all layouts.
        peaks: one of each layout.
        width: in inches; on narrow paper one panel stands below the other.
    """
    abreast = width >= ABREAST
    figure = paper_figure(width, 0.48 * width if abreast else 1.6 * width)
    left, right = figure.subplots(*((1, 2) if abreast else (2, 1)))
    for place, peak in enumerate(peaks):
        own = [row for row in rows if row.layout == peak.layout]
        agents, means = [row.agents for row in own], [row.mean_of_all for row in own]
        look = {"color": _colour(place), "marker": MARKERS[place % len(MARKERS)]}
        left.plot(agents, means, label=name_of(peak.layout), **look)
        left.plot(peak.agents, peak.throughput, "*", markersize=11, color=_colour(place))
    left.set(xlabel="agents", ylabel=f"mean {THROUGHPUT}", ylim=(0, None), xlim=(0, None))
    left.set_title(f"all of {rows[0].runs} runs each; a star is a peak")
    left.grid()
    add_legend(figure, *left.get_legend_handles_labels())
    ordered = sorted(peaks, key=lambda peak: peak.rows * peak.cols)
    places = range(len(ordered))
    right.bar(places, [peak.agents for peak in ordered], 0.6, color=BAR_COLOUR)
    right.set_ylabel("agents at the peak (bars)")
    labels = [f"{name_of(peak.layout)}\n{peak.rows}x{peak.cols}" for peak in ordered]
    right.set_xticks(places, labels, rotation=30, ha="right")
    twin = right.twinx()
    twin.plot(places, [peak.throughput for peak in ordered], "o-", color=WARNING)
    twin.set_ylabel(f"mean {THROUGHPUT} at the peak", color=WARNING)
    twin.set_ylim(0, None)
    twin.spines["right"].set_visible(True)
    return figure
