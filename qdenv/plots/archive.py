"""The heat map of an archive: one coloured cell per elite."""

import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from qdenv.files import write_atomically
from qdenv.types import Array, InputError

COLOURS = "viridis"
EMPTY = "#f2f2f2"


def objective_grid(objectives: Array, measures: Sequence[Any]) -> np.ndarray:
    """Lay the objectives of all cells [C] out as a grid [cells_0, cells_1], NaN where empty.

    Args:
        objectives: float [C], row-major, not finite where a cell is empty.
        measures: one or two records with ``name, low, high, cells``.

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


def scatter_objectives(index: Array, objective: Array, measures: Sequence[Any]) -> np.ndarray:
    """Turn saved elites into the objectives of all cells, float [C], NaN where empty.

    Args:
        index: int [elites], their cells.
        objective: float [elites].
        measures: records with ``cells``.
    """
    objectives = np.full(int(np.prod([axis.cells for axis in measures])), np.nan)
    objectives[np.asarray(index)] = np.asarray(objective)
    return objectives


def draw_heatmap(
    axes: Any,
    objectives: Array,
    measures: Sequence[Any],
    low: float | None = None,
    high: float | None = None,
) -> Any:
    """Draw the heat map into matplotlib `axes`; give the image, for a colour bar.

    The first measure runs to the right, the second upwards.

    Args:
        axes: matplotlib axes.
        objectives: float [C], row-major, not finite where a cell is empty.
        measures: one or two records with ``name, low, high, cells``.
        low: objective of the darkest colour; the least by default.
        high: objective of the brightest colour; the greatest by default.
    """
    grid = objective_grid(objectives, measures)
    first, second = measures[0], measures[1] if len(measures) == 2 else None
    bottom, top = (second.low, second.high) if second else (0, 1)
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
    axes.set_facecolor(EMPTY)
    axes.set_xlabel(first.name)
    if second:
        axes.set_ylabel(second.name)
    else:
        axes.set_yticks([])
    return image


def save_heatmap(
    path: str | os.PathLike,
    objectives: Array,
    measures: Sequence[Any],
    title: str = "",
    label: str = "objective",
    low: float | None = None,
    high: float | None = None,
) -> None:
    """Save the heat map of an archive as an image, atomically.

    Args:
        path: where; the suffix decides the format (png, pdf, svg).
        objectives: float [C], row-major, not finite where a cell is empty.
        measures: one or two records with ``name, low, high, cells``.
        title: printed above, beside the share of filled cells.
        label: what the colours mean.
        low: objective of the darkest colour.
        high: objective of the brightest colour.

    Raises:
        InputError: the objectives do not fit the grid.
    """
    figure = Figure(figsize=(6, 4.8), dpi=150, layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.add_subplot()
    image = draw_heatmap(axes, objectives, measures, low, high)
    figure.colorbar(image, ax=axes, label=label)
    finite = np.isfinite(np.asarray(objectives, dtype=float))
    share = f"{finite.mean():.1%} of {finite.size:,} cells filled"
    axes.set_title(f"{title} ({share})" if title else share, fontsize="medium")
    suffix = Path(path).suffix.lstrip(".") or "png"
    write_atomically(Path(path), lambda file: figure.savefig(file, format=suffix))
