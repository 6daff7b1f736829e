"""The picture of a surrogate: what it predicts of held-out elites over what is true."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from qdenv.plots.figure import new_figure, save_figure

SIDE = 3.4  # inches of a panel
ROOM = 0.04  # of a panel's range, beyond the outermost points
POINT_COLOUR = "#0072b2"
LINE_COLOUR = "#b5432d"


def save_predictions(
    path: str | Path, panels: Mapping[str, tuple[np.ndarray, np.ndarray, str]], title: str
) -> None:
    """Save what `draw_predictions` draws; the ending of `path` chooses the format.

    Raises:
        InputError: the place cannot be written to.
    """
    save_figure(draw_predictions(panels, title), path)


def draw_predictions(
    panels: Mapping[str, tuple[np.ndarray, np.ndarray, str]], title: str
) -> Figure:
    """Draw a panel for each number: every held-out elite, and the diagonal of perfect predictions.

    Args:
        panels: by the label of the number: true values, predicted values, what the title says.
        title: of the figure.
    """
    figure = new_figure(SIDE * len(panels), SIDE + 0.45)
    every: Sequence[Axes] = figure.subplots(1, len(panels), squeeze=False)[0]
    for axes, (label, (truth, predicted, said)) in zip(every, panels.items(), strict=True):
        both = np.concatenate([truth, predicted])
        room = ROOM * max(float(np.ptp(both)), 1e-6)
        ends = (both.min() - room, both.max() + room)
        axes.plot(ends, ends, color=LINE_COLOUR, linewidth=1, zorder=1)
        axes.scatter(truth, predicted, s=9, alpha=0.5, color=POINT_COLOUR, linewidths=0, zorder=2)
        axes.set(xlim=ends, ylim=ends, aspect="equal", xlabel=f"true {label}")
        axes.set_title(said, fontsize=9)
        axes.grid(alpha=0.3)
    every[0].set_ylabel("predicted")
    figure.suptitle(title, fontsize=10)
    return figure
