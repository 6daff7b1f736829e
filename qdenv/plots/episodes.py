"""Pictures of many episodes of the agent in a maze: where it walks, how soon it is there."""

from collections.abc import Mapping

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import PercentFormatter

from qdenv.plots.figure import PALETTE, add_legend, paper_figure, styled
from qdenv.plots.traffic import BESIDE, TITLES, add_bar, draw_map
from qdenv.plots.widths import PAGE

FLAT = 0.48  # of the width: the height of the curves


@styled
def draw_walks(free: np.ndarray, usage: np.ndarray, width: float) -> Figure:
    """Draw where the agent walks.

    Args:
        free: bool [H, W].
        usage: float [H, W], share of its actions that it takes on each cell.
        width: in inches.
    """
    rows, cols = free.shape
    figure = paper_figure(width, (width - BESIDE) * rows / cols + TITLES)
    axes = figure.subplots()
    draw_map(axes, free, usage, "usage")
    add_bar(axes, usage, "share of the actions taken here", percent=True)
    return figure


@styled
def draw_arrivals(arrivals: Mapping[str, np.ndarray], most: int, width: float = PAGE) -> Figure:
    """Draw the share of episodes that have reached the goal over the actions taken.

    Args:
        arrivals: by the maze's name: float [episodes], actions to the goal, NaN for none.
        most: actions after which an episode fails.
        width: in inches.
    """
    figure = paper_figure(width, FLAT * width)
    axes = figure.subplots()
    for place, (name, actions) in enumerate(arrivals.items()):
        reached = np.sort(actions[np.isfinite(actions)])
        steps = np.concatenate([[0], reached, [most]])
        share = np.concatenate([[0], np.arange(1, len(reached) + 1), [len(reached)]]) / len(actions)
        axes.step(steps, share, where="post", label=name, color=PALETTE[place % len(PALETTE)])
    axes.set(xlabel="actions", ylabel="episodes at the goal", xlim=(0, most), ylim=(0, 1.02))
    axes.yaxis.set_major_formatter(PercentFormatter(1.0))
    axes.grid()
    if len(arrivals) > 1:
        add_legend(figure, *axes.get_legend_handles_labels())
    return figure
