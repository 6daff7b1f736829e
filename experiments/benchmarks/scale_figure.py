"""The picture of size: what each step of the loop costs over the cells of a layout."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from matplotlib.figure import Figure

from qdenv.view.style import new_figure, save_figure

# Column of a row, what it is called, its colour (told apart by colour-blind people) and marker.
STEPS = (
    ("growth", "growth", "#0072b2", "o"),
    ("repair", "repair", "#d55e00", "s"),
    ("distances", "first distances", "#009e73", "^"),
    ("window", "a window of the fleet", "#cc79a7", "D"),
)


def save_scale(
    path: str | Path, rows: Sequence[Mapping[str, Any]], slopes: Mapping[str, float]
) -> None:
    """Save what `draw_scale` draws; the ending of `path` chooses the format.

    Raises:
        InputError: the place cannot be written to.
    """
    save_figure(draw_scale(rows, slopes), path)


def draw_scale(rows: Sequence[Mapping[str, Any]], slopes: Mapping[str, float]) -> Figure:
    """Draw CPU seconds over cells, log over log, with the slope of every line in the legend."""
    figure = new_figure(6, 4.5)
    axes = figure.subplots()
    cells = [row["cells"] for row in rows]
    for name, label, colour, marker in STEPS:
        legend = f"{label}, slope {slopes[name]:.2f}" if name in slopes else label
        costs = [row[name] or float("nan") for row in rows]
        axes.plot(cells, costs, color=colour, marker=marker, label=legend)
    axes.set(xscale="log", yscale="log", xlabel="cells of the layout", ylabel="CPU seconds")
    axes.set_xticks(cells, [f"{row['rows']}x{row['cols']}" for row in rows])
    axes.minorticks_off()
    axes.grid(alpha=0.3)
    axes.legend(frameon=False, loc="lower right")
    first, last = rows[0], rows[-1]
    axes.set_title(f"{first['agents']} to {last['agents']} agents, one per equal area")
    return figure
