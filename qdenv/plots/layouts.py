"""Pictures of layouts: one colour per tile, and what a repair changed."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import ListedColormap
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from qdenv.plots.figure import new_figure, save_figure
from qdenv.types import Array

COLOURS = {
    ".": "#ffffff",
    "@": "#2b2b2b",
    "e": "#9dc3f2",
    "w": "#f4a6c8",
    "0": "#d64545",
    "1": "#4aa564",
    "2": "#f2c94c",
    "X": "#8a8a8a",
    " ": "#ffffff",
}
NAMES = {
    ".": "empty",
    "@": "shelf",
    "e": "endpoint",
    "w": "workstation",
    "0": "station 0",
    "1": "station 1",
    "2": "station 2",
    "X": "wall",
    " ": "empty",
}
UNKNOWN = "#b39ddb"  # tiles of a user's own domain
LINES = "#d9d9d9"
CHANGED = "#e8590c"
CELL = 0.14  # inches per cell, so that the tiles of a 33 x 36 layout are told apart at a glance
LARGEST = 14.0  # inches
LEGEND_ENTRY = 1.15  # inches that an entry of the legend takes
PANEL = 2.9  # inches of a panel of a series
PANELS = 6  # side by side, as in Figure 6


def draw_layout(layout: Array, tiles: str, ax: Axes | None = None) -> Axes:
    """Draw a layout with a legend of the tiles it holds.

    Args:
        layout: int8 [H, W].
        tiles: the alphabet.
        ax: where to draw; a new figure unless given.

    Returns:
        The axes; their figure is registered nowhere and vanishes with them.
    """
    layout = np.asarray(layout)
    ax = _new_figure(layout.shape, 1).axes[0] if ax is None else ax
    colours = ListedColormap([COLOURS.get(tile, UNKNOWN) for tile in tiles])
    ax.imshow(layout, cmap=colours, vmin=-0.5, vmax=len(tiles) - 0.5, interpolation="nearest")
    rows, cols = layout.shape
    if max(rows, cols) <= 60:  # finer than this, lines hide the tiles
        ax.set_xticks(np.arange(cols + 1) - 0.5, minor=True)
        ax.set_yticks(np.arange(rows + 1) - 0.5, minor=True)
        ax.grid(which="minor", color=LINES, linewidth=0.4)
    ax.tick_params(which="both", length=0, labelbottom=False, labelleft=False)
    present = [kind for kind in range(len(tiles)) if (layout == kind).any()]
    handles = [
        Patch(
            facecolor=COLOURS.get(tiles[kind], UNKNOWN),
            edgecolor="#999999",
            label=f"{NAMES.get(tiles[kind], repr(tiles[kind]))} {np.sum(layout == kind)}",
        )
        for kind in present
    ]
    inches = ax.get_window_extent().width / ax.figure.dpi
    ax.legend(
        handles=handles,
        loc="upper center",
        bbox_to_anchor=(0.5, -0.01),
        ncols=max(1, min(len(handles), int(inches / LEGEND_ENTRY))),
        frameon=False,
        fontsize=8,
        handlelength=1.0,
        columnspacing=1.2,
    )
    return ax


def save_layout(path: str | Path, layout: Array, tiles: str) -> None:
    """Save a picture of `layout` (int8 [H, W]); the ending of `path` chooses the format.

    Raises:
        InputError: the place cannot be written to.
    """
    figure = _new_figure(np.shape(layout), 1)
    draw_layout(layout, tiles, figure.axes[0])
    save_figure(figure, path, crop=True)


def save_difference(path: str | Path, before: Array, after: Array, tiles: str) -> None:
    """Save `before` and `after` (int8 [H, W]) side by side, every changed cell framed.

    Raises:
        InputError: the place cannot be written to.
    """
    before, after = np.asarray(before), np.asarray(after)
    figure = _new_figure(before.shape, 2)
    changed = np.argwhere(before != after)
    for ax, layout, title in zip(figure.axes, (before, after), ("before", "after"), strict=True):
        draw_layout(layout, tiles, ax)
        ax.set_title(f"{title}, {len(changed)} cells changed" if title == "after" else title)
        row, col = changed.T if len(changed) else (np.zeros(0), np.zeros(0))
        side = 0.85 * 72 * _scale(before.shape)
        ax.scatter(col, row, s=side**2, marker="s", facecolors="none", edgecolors=CHANGED, lw=0.9)
    save_figure(figure, path, crop=True)


def save_frames(
    path: str | Path, layouts: Sequence[Array], steps: Sequence[int], tiles: str
) -> None:
    """Save how one layout grows, a panel for each number of NCA steps (Figure 6).

    Args:
        path: the picture; its ending chooses the format.
        layouts: int8 [H, W] each, after so many steps.
        steps: numbers of NCA steps.
        tiles: the alphabet.

    Raises:
        InputError: the place cannot be written to.
    """
    rows, cols = layouts[0].shape
    across = min(len(layouts), PANELS)
    down = -(-len(layouts) // across)
    figure = new_figure(PANEL * across, (PANEL * rows / cols + 0.6) * down)
    panels = figure.subplots(down, across, squeeze=False).ravel()
    for ax, layout, number in zip(panels, layouts, steps, strict=False):
        draw_layout(layout, tiles, ax)
        ax.get_legend().remove()
        ax.set_title(f"{number} steps", fontsize=9)
    for ax in panels[len(layouts) :]:
        ax.set_axis_off()
    save_figure(figure, path)


def _scale(shape: tuple[int, ...]) -> float:
    """Inches per cell of a layout of this shape."""
    return min(CELL, LARGEST / max(shape))


def _new_figure(shape: tuple[int, ...], panels: int) -> Figure:
    """Make a figure with `panels` axes side by side, sized so that cells are square."""
    rows, cols = (side * _scale(shape) for side in shape)
    figure = new_figure(panels * (cols + 0.3), rows + 0.75, arrange=False)
    width, height = figure.get_size_inches()
    for panel in range(panels):
        left = (panel * (cols + 0.3) + 0.15) / width
        figure.add_axes((left, 0.42 / height, cols / width, rows / height))
    return figure
