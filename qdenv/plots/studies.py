"""Pictures of studies: layouts side by side over numbers of agents, and up to their peaks."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import PercentFormatter

from qdenv.plots.figure import new_figure, save_figure
from qdenv.study.table import Peak, Row

THROUGHPUT = "throughput [tasks / timestep]"
SUCCESS = "never congested"
MEANING = "bars: +- standard error over {runs} runs above, 95 % Wilson interval below"
SPREAD = 0.02  # of the axis: how far lines that would hide one another are moved apart
MARKERS = "osD^v"
PEAK_COLOUR = "#b5432d"
BAR_COLOUR = "#cfd8e3"


def save_comparison(path: str | Path, rows: Sequence[Row]) -> None:
    """Save what `draw_comparison` draws; the ending of `path` chooses the format.

    Raises:
        InputError: the place cannot be written to.
    """
    save_figure(draw_comparison(rows), path)


def draw_comparison(rows: Sequence[Row]) -> Figure:
    """Draw layouts side by side: throughput of successful runs above, success rates below.

    A line per layout over numbers of agents (Figure 22); bars where there is only
    one number of agents.
    """
    figure = new_figure(7, 5.5)
    above, below = figure.subplots(2, 1, sharex=True, height_ratios=(2, 1))
    names = list(dict.fromkeys(row.layout for row in rows))
    bars = len({row.agents for row in rows}) == 1
    for place, name in enumerate(names):
        own = [row for row in rows if row.layout == name]
        if bars:
            _draw_bar(above, place, own[0])
        else:
            _draw_line(above, own, MARKERS[place % len(MARKERS)])
        moved = (place - (len(names) - 1) / 2) * SPREAD * max(row.agents for row in rows)
        places = [place] if bars else [row.agents + moved for row in own]
        _draw_success(below, places, own, MARKERS[0 if bars else place % len(MARKERS)])
    if bars:
        below.set_xticks(range(len(names)), names, rotation=20, ha="right")
        above.set_title(f"{rows[0].agents} agents, {rows[0].runs} runs each")
    else:
        below.set(xlabel="agents", xlim=(0, 1.05 * max(row.agents for row in rows)))
        above.legend(frameon=False)
    above.set(ylabel=THROUGHPUT, ylim=(0, None))
    below.set(ylabel=SUCCESS, ylim=(-0.05, 1.05))
    below.yaxis.set_major_formatter(PercentFormatter(1.0))
    figure.supxlabel(MEANING.format(runs=rows[0].runs), fontsize=7, color="dimgray")
    for axes in (above, below):
        axes.grid(alpha=0.3)
        axes.set_axisbelow(True)
    return figure


def _draw_bar(axes: Axes, place: float, row: Row) -> None:
    """Draw one layout's throughput as a bar with its standard error, and the number in it."""
    congested = np.isnan(row.throughput)  # no run to average over
    height, error = np.nan_to_num([row.throughput, row.standard_error])
    axes.bar([place], [height], 0.6, yerr=error, capsize=3)
    text = "every run congested" if congested else f"{row.throughput:.2f}"
    colour = "black" if congested else "white"
    axes.annotate(text, (place, height / 2), ha="center", color=colour)


def _draw_line(axes: Axes, rows: Sequence[Row], marker: str) -> None:
    """Draw one layout's throughput over agents with its standard errors."""
    error = np.nan_to_num([row.standard_error for row in rows])
    agents, means = [row.agents for row in rows], [row.throughput for row in rows]
    axes.errorbar(agents, means, error, marker=marker, capsize=3, label=rows[0].layout)


def _draw_success(axes: Axes, places: Sequence[float], rows: Sequence[Row], marker: str) -> None:
    """Draw one layout's success rates with their Wilson intervals."""
    rate = np.array([row.success_rate for row in rows])
    low = rate - [row.success_low for row in rows]
    high = np.array([row.success_high for row in rows]) - rate
    # Rounding may put an end of the interval a hair beyond the rate.
    interval = np.maximum([low, high], 0)
    axes.errorbar(places, rate, interval, marker=marker, capsize=3, label=rows[0].layout)


def save_peaks(path: str | Path, rows: Sequence[Row], peaks: Sequence[Peak]) -> None:
    """Save what `draw_peaks` draws; the ending of `path` chooses the format.

    Raises:
        InputError: the place cannot be written to.
    """
    save_figure(draw_peaks(rows, peaks), path)


def draw_peaks(rows: Sequence[Row], peaks: Sequence[Peak]) -> Figure:
    """Draw how layouts scale (Figure 18): throughput over agents, and the peaks over sizes.

    Args:
        rows: of all layouts.
        peaks: one of each layout.
    """
    figure = new_figure(11, 4.5)
    left, right = figure.subplots(1, 2)
    for peak in peaks:
        own = [row for row in rows if row.layout == peak.layout]
        agents, means = [row.agents for row in own], [row.mean_of_all for row in own]
        (line,) = left.plot(agents, means, marker="o", label=peak.layout)
        left.plot(peak.agents, peak.throughput, "*", markersize=15, color=line.get_color())
    left.set(xlabel="agents", ylabel=f"mean {THROUGHPUT}", ylim=(0, None), xlim=(0, None))
    left.set_title(f"all of {rows[0].runs} runs each; a star is a peak", fontsize=9)
    left.legend(frameon=False, fontsize=8)
    left.grid(alpha=0.3)
    ordered = sorted(peaks, key=lambda peak: peak.rows * peak.cols)
    places = range(len(ordered))
    right.bar(places, [peak.agents for peak in ordered], 0.6, color=BAR_COLOUR)
    right.set_ylabel("agents at the peak")
    labels = [f"{peak.layout}\n{peak.rows}x{peak.cols}" for peak in ordered]
    right.set_xticks(places, labels, rotation=30, ha="right", fontsize=8)
    twin = right.twinx()
    twin.plot(places, [peak.throughput for peak in ordered], "o-", color=PEAK_COLOUR)
    twin.set_ylabel(f"mean {THROUGHPUT} at the peak", color=PEAK_COLOUR)
    twin.set_ylim(0, None)
    return figure
