"""Pictures of studies: layouts side by side over numbers of agents, and up to their peaks."""

from collections.abc import Callable, Sequence
from typing import Any, TypeAlias

import numpy as np
from matplotlib.axes import Axes
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
    new_figure,
    styled,
)
from qdenv.view.widths import PAGE

_THROUGHPUT = "throughput [tasks / timestep]"
_SUCCESS = "never congested"
_MEANING = "error bars: standard error over {runs} runs above, 95 % Wilson interval below"
_AGAINST = "\nper cent: against the first layout, over all runs, with 95 % interval"
_SPREAD = 0.02  # of the axis: how far lines that would hide one another are moved apart
_BAR_COLOUR = "#cfd8e3"
_TALL = 0.66  # of the width: the height of layouts side by side
_FLAT = 0.48  # of the width: the height of one panel alone
_LOWEST = 4.0  # inches of its height
_ABREAST = 5.0  # inches from which two panels stand side by side


@styled
def draw_comparison(rows: Sequence[Row], width: float = PAGE) -> Figure:
    """Draw layouts side by side: throughput of successful runs above, success rates below.

    A line per layout over numbers of agents (Figure 22); bars where there is only
    one number of agents.

    Args:
        rows: of all layouts.
        width: in inches.
    """
    figure = new_figure(width, max(_TALL * width, _LOWEST))
    above, below = figure.subplots(2, 1, sharex=True, height_ratios=(2, 1))
    layouts = _by_layout(rows)
    names = [own[0].layout for own in layouts]
    bars, against = len({row.agents for row in rows}) == 1, differences(rows)
    if bars:
        for place, own in enumerate(layouts):
            _draw_bar(above, place, own[0], against[rows.index(own[0])])
            _draw_points(below, [place], own, _success_of, place)
    else:
        _draw_lines(above, rows, _successful_throughput_of)
        _draw_lines(below, rows, _success_of, _SPREAD)
    if bars:
        below.set_xticks(range(len(names)), map(name_of, names), rotation=20, ha="right")
        above.set_title(f"{rows[0].agents} agents, {rows[0].runs} runs each")
    else:
        below.set_xlabel("agents")
        add_legend(figure, *above.get_legend_handles_labels())
    above.set(ylabel=_THROUGHPUT, ylim=(0, None))
    _set_rates(below)
    meaning = _MEANING.format(runs=rows[0].runs) + (_AGAINST if bars and len(names) > 1 else "")
    if width < _ABREAST:
        meaning = meaning.replace(" above, ", " above,\n").replace(", over all", ",\nover all")
    figure.supxlabel(meaning, fontsize=SMALL, color=GREY)
    for axes in (above, below):
        axes.grid()
    return figure


def _draw_bar(axes: Axes, place: int, row: Row, against: Difference) -> None:
    """Draw one layout's throughput as a bar with its standard error, and the numbers in it."""
    congested = np.isnan(row.throughput)  # no run to average over
    height, error = np.nan_to_num([row.throughput, row.standard_error])
    axes.bar([place], [height], 0.6, yerr=error, color=_look(place)["color"])
    text = "every run congested" if congested else f"{row.throughput:.2f}"
    if not congested and not np.isnan(against.low):
        text += f"\n{against.percent:+.1f} %\n({against.low:+.1f} to {against.high:+.1f})"
    colour = "black" if congested else "white"
    axes.annotate(text, (place, height / 2), ha="center", va="center", color=colour, fontsize=SMALL)


def _look(place: int) -> dict[str, Any]:
    return {"color": PALETTE[place % len(PALETTE)], "marker": MARKERS[place % len(MARKERS)]}


# Values [n] of the rows of a layout, and half the length of their error bars, [n] or [2, n].
_Measured: TypeAlias = Callable[[Sequence[Row]], tuple[Sequence[float], np.ndarray]]


def _successful_throughput_of(rows: Sequence[Row]) -> tuple[Sequence[float], np.ndarray]:
    """Return the throughput of runs that never congested, with standard errors."""
    errors = np.nan_to_num([row.standard_error for row in rows])
    return [row.throughput for row in rows], errors


def _mean_throughput_of(rows: Sequence[Row]) -> tuple[Sequence[float], np.ndarray]:
    """Return the throughput of all runs, with 95 % intervals (Student's t)."""
    halves = [margin(Sample(row.mean_of_all, row.error_of_all, row.runs)) for row in rows]
    return [row.mean_of_all for row in rows], np.nan_to_num(halves)


def _success_of(rows: Sequence[Row]) -> tuple[Sequence[float], np.ndarray]:
    """Return the share of runs that never congested, with 95 % Wilson intervals."""
    ends = [
        (row.success_rate - row.success_low, row.success_high - row.success_rate) for row in rows
    ]
    # Rounding may put an end of the interval a hair beyond the rate, which matplotlib refuses.
    return [row.success_rate for row in rows], np.maximum(np.transpose(ends), 0)


def _draw_lines(axes: Axes, rows: Sequence[Row], measured: _Measured, spread: float = 0.0) -> None:
    """Draw a line per layout over agents; `spread` moves lines apart that would hide another."""
    layouts, most = _by_layout(rows), max(row.agents for row in rows)
    for place, own in enumerate(layouts):
        moved = (place - (len(layouts) - 1) / 2) * spread * most
        _draw_points(axes, [row.agents + moved for row in own], own, measured, place)
    axes.set_xlim(0, 1.05 * most)


def _draw_points(
    axes: Axes, places: Sequence[float], rows: Sequence[Row], measured: _Measured, place: int
) -> None:
    """Draw points with error bars in the look of the layout at this place."""
    label = name_of(rows[0].layout)
    axes.errorbar(places, *measured(rows), label=label, elinewidth=0.8, **_look(place))


@styled
def draw_over_agents(rows: Sequence[Row], success: bool = False, width: float = PAGE) -> Figure:
    """Draw throughput or success rates of layouts over agents, with 95 % intervals.

    Args:
        rows: of all layouts.
        success: draw the share of runs that never congested (Wilson), in place of the mean
            throughput of all runs (Student's t).
        width: in inches.
    """
    figure = new_figure(width, _FLAT * width)
    axes = figure.subplots()
    if success:
        _draw_lines(axes, rows, _success_of, _SPREAD)
        _set_rates(axes)
    else:
        _draw_lines(axes, rows, _mean_throughput_of)
        axes.set(ylabel=_THROUGHPUT, ylim=(0, None))
    axes.set(xlabel="robots")
    axes.grid()
    if len(axes.containers) > 1:
        add_legend(figure, *axes.get_legend_handles_labels())
    return figure


def _set_rates(axes: Axes) -> None:
    axes.set(ylabel=_SUCCESS, ylim=(-0.05, 1.05))
    axes.yaxis.set_major_formatter(PercentFormatter(1.0))


def _by_layout(rows: Sequence[Row]) -> list[list[Row]]:
    names = dict.fromkeys(row.layout for row in rows)
    return [[row for row in rows if row.layout == name] for name in names]


@styled
def draw_peaks(rows: Sequence[Row], peaks: Sequence[Peak], width: float = PAGE) -> Figure:
    """Draw how layouts scale (Figure 18): throughput over agents, and the peaks over sizes.

    Args:
        rows: of all layouts.
        peaks: one of each layout.
        width: in inches; on narrow paper one panel stands below the other.
    """
    abreast = width >= _ABREAST
    figure = new_figure(width, 0.48 * width if abreast else 1.6 * width)
    left, right = figure.subplots(*((1, 2) if abreast else (2, 1)))
    for place, peak in enumerate(peaks):
        own = [row for row in rows if row.layout == peak.layout]
        agents, means = [row.agents for row in own], [row.mean_of_all for row in own]
        look = _look(place)
        left.plot(agents, means, label=name_of(peak.layout), **look)
        left.plot(peak.agents, peak.throughput, **look | {"marker": "*", "markersize": 11})
    left.set(xlabel="agents", ylabel=f"mean {_THROUGHPUT}", ylim=(0, None), xlim=(0, None))
    left.set_title(f"all of {rows[0].runs} runs each; a star is a peak")
    left.grid()
    add_legend(figure, *left.get_legend_handles_labels())
    ordered = sorted(peaks, key=lambda peak: peak.rows * peak.cols)
    places = range(len(ordered))
    right.bar(places, [peak.agents for peak in ordered], 0.6, color=_BAR_COLOUR)
    right.set_ylabel("agents at the peak (bars)")
    labels = [f"{name_of(peak.layout)}\n{peak.rows}x{peak.cols}" for peak in ordered]
    right.set_xticks(places, labels, rotation=30, ha="right")
    twin = right.twinx()
    twin.plot(places, [peak.throughput for peak in ordered], "o-", color=WARNING)
    twin.set_ylabel(f"mean {_THROUGHPUT} at the peak", color=WARNING)
    twin.set_ylim(0, None)
    twin.spines["right"].set_visible(True)
    return figure
