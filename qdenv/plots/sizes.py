"""Pictures about sizes: a layout as it grows (Figure 6)."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from qdenv.files import write_atomically
from qdenv.plots.layouts import draw_layout

PANEL = 2.9  # inches
PANELS = 6  # side by side, as in Figure 6


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


def write_figure(figure: Figure, path: Path) -> None:
    """Write the figure in one step: a reader never sees half a file."""
    form = path.suffix.lstrip(".") or "png"
    write_atomically(path, lambda file: figure.savefig(file, format=form, dpi=150))
