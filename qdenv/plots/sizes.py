"""Pictures about sizes: layouts as they grow, side by side, and up to their peaks."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from qdenv.files import write_atomically
from qdenv.plots.layouts import draw_layout

PANEL = 2.9  # inches
PANELS = 6  # side by side, as in Figure 6
THROUGHPUT = "throughput [tasks / timestep]"
LIMITS = ("low", "high")


def save_frames(
    path: str | Path, layouts: Sequence[np.ndarray], steps: Sequence[int], tiles: str
) -> None:
    """Write how one layout grows, a panel for each number of NCA steps.

    Args:
        path: the picture; its ending chooses the format.
        layouts: int8 [H, W] each, after so many steps.
        steps: numbers of NCA steps.
        tiles: the alphabet.
    """
    rows, cols = layouts[0].shape
    across = min(len(layouts), PANELS)
    down = -(-len(layouts) // across)
    height = PANEL * rows / cols + 0.6
    figure = Figure(figsize=(PANEL * across, height * down), layout="constrained")
    panels = figure.subplots(down, across, squeeze=False).ravel()
    for ax, layout, number in zip(panels, layouts, steps, strict=False):
        draw_layout(layout, tiles, ax)
        ax.get_legend().remove()
        ax.set_title(f"{number} steps", fontsize=9)
    for ax in panels[len(layouts) :]:
        ax.set_axis_off()
    write_figure(figure, Path(path))


def save_comparison(path: str | Path, rows: Sequence[Any]) -> None:
    """Draw layouts side by side: throughput of successful runs above, success rates below.

    Bars at one number of agents, a line per layout over several (Figure 22).

    Args:
        path: the picture; its ending chooses the format.
        rows: `qdenv.study.compare.Compared` records.
    """
    figure = Figure(figsize=(7, 5.5), layout="constrained")
    above, below = figure.subplots(2, 1, sharex=True, height_ratios=(2, 1))
    names = list(dict.fromkeys(row.layout for row in rows))
    counts = sorted({row.traffic.agents for row in rows})
    for position, name in enumerate(names):
        own = [row.traffic for row in rows if row.layout == name]
        places = [position] if len(counts) == 1 else [row.agents for row in own]
        draw_rates(above, below, places, own, name, bars=len(counts) == 1)
    if len(counts) == 1:
        below.set_xticks(range(len(names)), names, rotation=20, ha="right")
        above.set_title(f"{counts[0]} agents, {rows[0].traffic.runs} runs each")
    else:
        below.set_xlabel("agents")
        above.legend(frameon=False)
    above.set(ylabel=THROUGHPUT, ylim=(0, None))
    below.set(ylabel="success rate", ylim=(-0.05, 1.05))
    write_figure(figure, Path(path))


def draw_rates(
    above: Axes, below: Axes, places: Sequence[float], rows: Sequence[Any], name: str, bars: bool
) -> None:
    """Draw one layout's throughput with its standard error, and success with its interval."""
    mean = np.array([row.throughput for row in rows])
    error = np.nan_to_num([row.standard_error for row in rows])
    rate = np.array([row.success_rate for row in rows])
    low, high = (np.array([getattr(row, f"success_{end}") for row in rows]) for end in LIMITS)
    if bars:
        above.bar(places, np.nan_to_num(mean), 0.6, yerr=error, capsize=3)
        for place, value in zip(places, mean, strict=True):
            text = "every run congested" if np.isnan(value) else f"{value:.2f}"
            colour = "black" if np.isnan(value) else "white"
            above.annotate(text, (place, np.nan_to_num(value) / 2), ha="center", color=colour)
    else:
        above.errorbar(places, mean, error, marker="o", capsize=3, label=name)
    interval = np.maximum([rate - low, high - rate], 0)
    below.errorbar(places, rate, interval, marker="o", capsize=3, label=name)
    for axes in (above, below):
        axes.grid(alpha=0.3)
        axes.set_axisbelow(True)


def save_peaks(path: str | Path, rows: Sequence[Any], peaks: Sequence[Any]) -> None:
    """Draw how layouts scale (Figure 18): throughput over agents, and the peaks over sizes.

    Args:
        path: the picture; its ending chooses the format.
        rows: `qdenv.study.compare.Compared` records of all layouts.
        peaks: a `qdenv.study.compare.Peak` of each layout.
    """
    figure = Figure(figsize=(11, 4.5), layout="constrained")
    left, right = figure.subplots(1, 2)
    for peak in peaks:
        own = [row.traffic for row in rows if row.layout == peak.layout]
        way = [(row.agents, row.mean_of_all) for row in own]
        (line,) = left.plot(*zip(*way, strict=True), marker="o", label=peak.layout)
        left.plot(peak.agents, peak.throughput, "*", markersize=15, color=line.get_color())
    left.set(xlabel="agents", ylabel=f"mean {THROUGHPUT}", ylim=(0, None))
    left.legend(frameon=False, fontsize=8)
    ordered = sorted(peaks, key=lambda peak: peak.rows * peak.cols)
    places = range(len(ordered))
    right.bar(places, [peak.agents for peak in ordered], 0.6, color="#cfd8e3")
    right.set_ylabel("agents at the peak")
    labels = [f"{peak.layout}\n{peak.rows}x{peak.cols}" for peak in ordered]
    right.set_xticks(places, labels, rotation=30, ha="right", fontsize=8)
    twin = right.twinx()
    twin.plot(places, [peak.throughput for peak in ordered], "o-", color="#b5432d")
    twin.set_ylabel(f"mean {THROUGHPUT} at the peak", color="#b5432d")
    twin.set_ylim(0, None)
    left.grid(alpha=0.3)
    write_figure(figure, Path(path))


def write_figure(figure: Figure, path: Path) -> None:
    """Write the figure in one step: a reader never sees half a file."""
    form = path.suffix.lstrip(".") or "png"
    write_atomically(path, lambda file: figure.savefig(file, format=form, dpi=150))
