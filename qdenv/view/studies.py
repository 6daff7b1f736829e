"""Pictures of studies: layouts side by side over numbers of agents, and up to their peaks."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import PercentFormatter

from qdenv.stats import margin
from qdenv.study.table import Peak, Row, differences
from qdenv.view import PAGE, style

_THROUGHPUT = "throughput [tasks / timestep]"


@style.styled
def draw_comparison(rows: Sequence[Row], width: float = PAGE) -> Figure:
    """Draw layouts side by side: throughput of successful runs above, success rates below.

    A line per layout over numbers of agents (Figure 22); bars if there is only one number.
    """
    figure = style.new_figure(width, max(0.66 * width, 4.0))
    above, below = figure.subplots(2, 1, sharex=True, height_ratios=(2, 1))
    layouts = _by_layout(rows)
    meaning = f"error bars: standard error over {rows[0].runs} runs above, "
    meaning += "95 % Wilson interval below"
    if len({row.agents for row in rows}) == 1:
        _draw_bars(above, rows)
        for place, own in enumerate(layouts):
            _draw_points(below, [place], own, "success", place)
        names = [style.format_name(own[0].name) for own in layouts]
        below.set_xticks(range(len(names)), names, rotation=20, ha="right")
        above.set_title(f"{rows[0].agents} agents, {rows[0].runs} runs each")
        if len(names) > 1:
            kind = "planner" if rows[0].planner else "layout"
            meaning += f"\nper cent: against the first {kind}, over all runs, with 95 % interval"
    else:
        _draw_lines(above, rows, "smooth")
        _draw_lines(below, rows, "success")
        below.set_xlabel("agents")
        style.add_legend(figure, above)
    above.set(ylabel=_THROUGHPUT, ylim=(0, None))
    if width < style.ABREAST:
        meaning = meaning.replace(" above, ", " above,\n").replace(", over all", ",\nover all")
    figure.supxlabel(meaning, fontsize=style.SMALL, color=style.GREY)
    for axes in (above, below):
        axes.grid()
    return figure


def _draw_bars(axes: Axes, rows: Sequence[Row]) -> None:
    """Draw each layout's throughput as a bar with its standard error, and the numbers in it."""
    for place, (row, against) in enumerate(zip(rows, differences(rows), strict=True)):
        congested = np.isnan(row.throughput)  # no run to average over
        # At NaN, the text that explains it would be drawn nowhere.
        height, error = np.nan_to_num([row.throughput, row.standard_error])
        axes.bar([place], [height], 0.6, yerr=error, color=style.colour(place))
        text = "every run congested" if congested else f"{row.throughput:.2f}"
        if not congested and not np.isnan(against.low):
            text += f"\n{against.percent:+.1f} %\n({against.low:+.1f} to {against.high:+.1f})"
        look: Any = {"ha": "center", "va": "center", "fontsize": style.SMALL}
        axes.annotate(text, (place, height / 2), color="black" if congested else "white", **look)


@style.styled
def draw_over_agents(rows: Sequence[Row], success: bool = False, width: float = PAGE) -> Figure:
    """Draw the mean throughput of all runs over agents, with 95 % intervals (Student's t).

    Or, with `success`, the share of runs that never congested (Wilson).
    """
    figure = style.new_figure(width, 0.48 * width)
    axes = figure.subplots()
    _draw_lines(axes, rows, "success" if success else "mean")
    if not success:
        axes.set(ylabel=_THROUGHPUT, ylim=(0, None))
    axes.set(xlabel="robots")
    axes.grid()
    if len(axes.containers) > 1:
        style.add_legend(figure, axes)
    return figure


def _draw_lines(axes: Axes, rows: Sequence[Row], kind: str) -> None:
    """Draw a line per layout over agents; `kind` as in `_draw_points`."""
    layouts, most = _by_layout(rows), max(row.agents for row in rows)
    # Success rates are often all 1: lines that would hide one another are moved apart.
    spread = 0.02 * most if kind == "success" else 0.0
    for place, own in enumerate(layouts):
        moved = (place - (len(layouts) - 1) / 2) * spread
        _draw_points(axes, [row.agents + moved for row in own], own, kind, place)
    axes.set_xlim(0, 1.05 * most)


def _draw_points(
    axes: Axes, places: Sequence[float], rows: Sequence[Row], kind: str, number: int
) -> None:
    """Draw points with error bars in the look of the layout of this number.

    Kinds are "smooth" (throughput of runs that never congested, with standard errors), "mean"
    (throughput of all runs, with 95 % intervals) and "success" (rates, with 95 % intervals).
    """
    if kind == "smooth":
        values = [row.throughput for row in rows]
        errors = np.nan_to_num([row.standard_error for row in rows])
    elif kind == "mean":
        values = [row.mean_of_all for row in rows]
        errors = np.nan_to_num([margin(row.sample_of_all) for row in rows])
    else:
        values = [row.success_rate for row in rows]
        low = [row.success_rate - row.success_low for row in rows]
        high = [row.success_high - row.success_rate for row in rows]
        # Rounding may put an end of the interval a hair beyond the rate, which matplotlib refuses.
        errors = np.maximum([low, high], 0)
        axes.set(ylabel="never congested", ylim=(-0.05, 1.05))
        axes.yaxis.set_major_formatter(PercentFormatter(1.0))
    label, look = style.format_name(rows[0].name), _look(number)
    axes.errorbar(places, values, errors, label=label, elinewidth=0.8, **look)


def _look(number: int) -> dict[str, Any]:
    """Return colour and marker of a layout."""
    return {"color": style.colour(number), "marker": style.MARKERS[number % len(style.MARKERS)]}


def _by_layout(rows: Sequence[Row]) -> list[list[Row]]:
    names = dict.fromkeys(row.name for row in rows)
    return [[row for row in rows if row.name == name] for name in names]


@style.styled
def draw_peaks(rows: Sequence[Row], peaks: Sequence[Peak], width: float = PAGE) -> Figure:
    """Draw how layouts scale (Figure 18): throughput over agents, and the peaks over sizes.

    There is one peak for each layout; on narrow paper one panel stands below the other.
    """
    abreast = width >= style.ABREAST
    figure = style.new_figure(width, 0.48 * width if abreast else 1.6 * width)
    left, right = figure.subplots(*((1, 2) if abreast else (2, 1)))
    for place, peak in enumerate(peaks):
        own = [row for row in rows if row.layout == peak.layout]
        agents, means = [row.agents for row in own], [row.mean_of_all for row in own]
        look = _look(place)
        left.plot(agents, means, label=style.format_name(peak.layout), **look)
        left.plot(peak.agents, peak.throughput, **look | {"marker": "*", "markersize": 11})
    left.set(xlabel="agents", ylabel=f"mean {_THROUGHPUT}", ylim=(0, None), xlim=(0, None))
    left.set_title(f"all of {rows[0].runs} runs each; a star is a peak")
    left.grid()
    style.add_legend(figure, left)
    ordered = sorted(peaks, key=lambda peak: peak.rows * peak.cols)
    places = range(len(ordered))
    right.bar(places, [peak.agents for peak in ordered], 0.6, color="#cfd8e3")
    right.set_ylabel("agents at the peak (bars)")
    labels = [f"{style.format_name(peak.layout)}\n{peak.rows}x{peak.cols}" for peak in ordered]
    right.set_xticks(places, labels, rotation=30, ha="right")
    # Agents and throughput have units of their own: one axis at each side.
    twin = right.twinx()
    twin.plot(places, [peak.throughput for peak in ordered], "o-", color=style.WARNING)
    twin.set_ylabel(f"mean {_THROUGHPUT} at the peak", color=style.WARNING)
    twin.set_ylim(0, None)
    twin.spines["right"].set_visible(True)
    return figure
