"""Pictures of layouts: one colour per tile, and what a repair changed."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import ListedColormap
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from qdenv.types import Array
from qdenv.view.style import SCREEN_DPI, new_figure, save_figure, styled

# Told apart by colour-blind eyes too, within each alphabet (tests measure it).
COLOURS = {
    ".": "#ffffff",
    "@": "#2b2b2b",
    "e": "#9dc3f2",
    "w": "#e69f00",
    "0": "#d55e00",
    "1": "#3b2a8c",
    "2": "#f2d64b",
    "X": "#8a8a8a",
    " ": "#ffffff",
}
UNKNOWN = "#b39ddb"  # tiles of a user's own domain
_LINES = "#d9d9d9"
CHANGED = "#e8108c"
_CELL = 0.16  # inches per cell, so that tiles are told apart at a glance
SMALLEST, LARGEST = 4.5, 12.0  # inches of the longer side of one layout
_FINE = 60  # rows or columns beyond which lines would hide the tiles
_LABELS = (1, 2, 5, 10, 20, 50, 100, 200)  # rows from one numbered row to the next
_LETTER = 0.52  # of a letter's height: its width
_NO_NAMES: Mapping[str, str] = MappingProxyType({})


@styled
def draw_layout(
    layout: Array, tiles: str, ax: Axes | None = None, names: Mapping[str, str] = _NO_NAMES
) -> Axes:
    """Draw a layout with a legend of the tiles it holds.

    Args:
        layout: int8 [H, W].
        tiles: the alphabet.
        ax: where to draw; a new figure unless given.
        names: how the legend calls the tiles, by their symbols.

    Returns:
        The axes; their figure is registered nowhere and vanishes with them.
    """
    layout = np.asarray(layout)
    ax = _new_figure(layout.shape, 1).axes[0] if ax is None else ax
    colours = ListedColormap([COLOURS.get(tile, UNKNOWN) for tile in tiles])
    ax.imshow(layout, cmap=colours, vmin=-0.5, vmax=len(tiles) - 0.5, interpolation="nearest")
    ax.spines[:].set_visible(True)
    rows, cols = layout.shape
    if max(rows, cols) <= _FINE:
        ax.set_xticks(np.arange(cols + 1) - 0.5, minor=True)
        ax.set_yticks(np.arange(rows + 1) - 0.5, minor=True)
        ax.grid(which="minor", color=_LINES, linewidth=0.4, alpha=1)  # on black shelves, too
    ax.tick_params(which="both", length=0, labelbottom=False, labelleft=False)
    counts = [int((layout == kind).sum()) for kind in range(len(tiles))]
    handles = [
        Patch(
            facecolor=COLOURS.get(tile, UNKNOWN),
            edgecolor="#999999",
            label=f"{names.get(tile, repr(tile))}: {count} cell{'s' * (count != 1)}",
        )
        for tile, count in zip(tiles, counts, strict=True)
        if count
    ]
    _add_legend(ax, handles)
    return ax


def _add_legend(ax: Axes, handles: list[Patch]) -> None:
    """Put a legend under a layout, in letters that grow with it and as wide as it is."""
    inches = ax.get_window_extent().width / ax.figure.dpi
    points = float(np.clip(1.6 * inches, 8, 14))
    longest = max(len(str(handle.get_label())) for handle in handles)
    entry = (longest * _LETTER + 3) * points / 72
    ax.legend(
        handles=handles,
        loc="upper center",
        bbox_to_anchor=(0.5, -0.01),
        ncols=int(np.clip(inches / entry, 1, len(handles))),
        frameon=False,
        fontsize=points,
        handlelength=1.0,
        columnspacing=1.2,
    )


def save_layout(
    path: str | Path, layout: Array, tiles: str, names: Mapping[str, str] = _NO_NAMES
) -> None:
    """Save a picture of `layout` (int8 [H, W]); the ending of `path` chooses the format.

    Rows and columns are numbered from 0, as messages number them; `names` are the legend's.

    Raises:
        InputError: the place cannot be written to.
    """
    save_figure(draw_plan(layout, tiles, names), path, crop=True)


@styled
def draw_plan(layout: Array, tiles: str, names: Mapping[str, str] = _NO_NAMES) -> Figure:
    """Draw a layout as `save_layout` does, to be cropped to what is drawn."""
    figure = _new_figure(np.shape(layout), 1)
    _number_cells(draw_layout(layout, tiles, figure.axes[0], names))
    return figure


@styled
def save_difference(
    path: str | Path, before: Array, after: Array, tiles: str, names: Mapping[str, str] = _NO_NAMES
) -> None:
    """Save `before` and `after` (int8 [H, W]) side by side, every changed cell framed.

    Raises:
        InputError: the place cannot be written to.
    """
    before, after = np.asarray(before), np.asarray(after)
    figure = _new_figure(before.shape, 2)
    changed = np.argwhere(before != after)
    for ax, layout, title in zip(figure.axes, (before, after), ("before", "after"), strict=True):
        _number_cells(draw_layout(layout, tiles, ax, names))
        ax.set_title(f"{title}, {len(changed)} cells changed" if title == "after" else title)
        row, col = changed.T if len(changed) else (np.zeros(0), np.zeros(0))
        side = 0.85 * 72 * _scale(before.shape, 2)
        ax.scatter(col, row, s=side**2, marker="s", facecolors="none", edgecolors=CHANGED, lw=1.2)
    save_figure(figure, path, crop=True)


def _number_cells(ax: Axes) -> None:
    """Number rows at the left and columns at the top, as many as can be read."""
    for axis, limits in ((ax.xaxis, ax.get_xlim()), (ax.yaxis, ax.get_ylim())):
        count = round(abs(limits[1] - limits[0]))
        step = next((step for step in _LABELS if count / step <= 12), _LABELS[-1])
        axis.set_ticks(np.arange(0, count, step))
    ax.tick_params(which="major", labeltop=True, labelleft=True, labelsize=8, labelcolor="#666666")


def draw_frames(layouts: Sequence[Array], steps: Sequence[int], tiles: str) -> Figure:
    """Draw how one layout grows, a panel for each number of NCA steps (Figure 6).

    Args:
        layouts: int8 [H, W] each, after the given numbers of steps.
        steps: numbers of NCA steps.
        tiles: the alphabet.
    """
    panels = [
        Picture(layout, tiles, _NO_NAMES, f"{number} steps", "")
        for layout, number in zip(layouts, steps, strict=True)
    ]
    return draw_sheet(panels, 6, 2.9)  # six side by side as in Figure 6


class Picture(NamedTuple):
    """One layout of a sheet."""

    layout: Array  # int8 [H, W]
    tiles: str  # its alphabet
    names: Mapping[str, str]  # how the legend calls the tiles
    title: str  # above it
    note: str  # below it


@styled
def draw_sheet(pictures: Sequence[Picture], across: int = 5, width: float = 2.6) -> Figure:
    """Draw layouts side by side.

    Args:
        pictures: at least one.
        across: the most in a row.
        width: of a layout in inches.
    """
    across = min(len(pictures), across)
    down = -(-len(pictures) // across)
    tallest = max(one.layout.shape[0] / one.layout.shape[1] for one in pictures)
    figure = new_figure(width * across, (width * tallest + 0.6) * down, dpi=SCREEN_DPI)
    panels = figure.subplots(down, across, squeeze=False).ravel()
    for axes, one in zip(panels, pictures, strict=False):
        draw_layout(one.layout, one.tiles, axes, one.names)
        axes.get_legend().remove()
        axes.set_title(one.title, fontsize=9)
        axes.set_xlabel(one.note, fontsize=7)
    for axes in panels[len(pictures) :]:
        axes.set_axis_off()
    return figure


def _scale(shape: tuple[int, ...], panels: int = 1) -> float:
    """Inches per cell of layouts of this shape, so many side by side."""
    longest = max(shape)
    return float(np.clip(_CELL * longest, SMALLEST, LARGEST / np.sqrt(panels))) / longest


def _new_figure(shape: tuple[int, ...], panels: int) -> Figure:
    """Make a figure with `panels` axes side by side, sized so that cells are square."""
    rows, cols = (side * _scale(shape, panels) for side in shape)
    gap = 0.45
    figure = new_figure(panels * (cols + gap), rows + 0.9, arrange=False, dpi=SCREEN_DPI)
    width, height = figure.get_size_inches()
    for panel in range(panels):
        left = (panel * (cols + gap) + gap) / width
        figure.add_axes((left, 0.45 / height, cols / width, rows / height))
    return figure
