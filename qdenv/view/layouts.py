"""Pictures of layouts: one colour per tile, marked cells, many at once."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import ListedColormap
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from qdenv.io.images import COLOURS
from qdenv.types import Array
from qdenv.view.style import SCREEN_DPI, new_figure, new_grid, styled, to_html

if TYPE_CHECKING:
    from qdenv.agent.evaluate import Drawn

UNKNOWN = "#b39ddb"  # tiles of a user's own domain
CHANGED = "#e8108c"  # frames of cells that a change or a repair touched
# What films and pages draw over the tiles, told apart by colour-blind eyes, too.
MARKS = {
    "driving": "#1c4e9a",
    "waiting": "#c62f1d",
    "serving": "#00796b",
    "goal": "#00796b",
    "way": "#d6338a",
    "agent": "#f2b705",
    "start": "#3c6fb0",
    "reached": "#2e9e5b",
    "ink": "#1b1b1b",
}
_NAMED = "#e8590c"  # cells with a name beside them

_CELL = 0.16  # inches per cell, so that tiles differ at a glance
_SMALLEST, _LARGEST = 4.5, 12.0  # inches of the longer side of one layout
_FINE = 60  # rows or columns beyond which lines would hide the tiles
_LABELS = (1, 2, 5, 10, 20, 50, 100, 200)  # rows from one numbered row to the next
_NO_NAMES: Mapping[str, str] = MappingProxyType({})


@styled
def draw_layout(layout: Array, tiles: str, ax: Axes, names: Mapping[str, str] = _NO_NAMES) -> Axes:
    """Draw a layout (int8 [H, W]) on `ax`, which is returned, with a legend that counts its tiles.

    `tiles` is the alphabet, `names` what the legend calls its symbols.
    """
    layout = np.asarray(layout)
    colours = [COLOURS.get(tile, UNKNOWN) for tile in tiles]
    # Half a kind at each end: kind k is the middle of its colour.
    ax.imshow(
        layout,
        cmap=ListedColormap(colours),
        interpolation="nearest",
        vmin=-0.5,
        vmax=len(tiles) - 0.5,
    )
    # The style has no upper and right line: a plan without them would look open.
    ax.spines[:].set_visible(True)
    rows, cols = layout.shape
    if max(rows, cols) <= _FINE:
        ax.set_xticks(np.arange(cols + 1) - 0.5, minor=True)
        ax.set_yticks(np.arange(rows + 1) - 0.5, minor=True)
        ax.grid(which="minor", color="#d9d9d9", linewidth=0.4, alpha=1)  # seen on black shelves
    ax.tick_params(which="both", length=0, labelbottom=False, labelleft=False)
    handles = []
    for kind, (tile, colour) in enumerate(zip(tiles, colours, strict=True)):
        if count := int((layout == kind).sum()):
            label = f"{names.get(tile, repr(tile))}: {count} cell{'s' * (count != 1)}"
            handles.append(Patch(facecolor=colour, edgecolor="#999999", label=label))
    # Below the layout, in letters that grow with it and in as many columns as its width holds.
    inches = ax.get_window_extent().width / ax.figure.dpi
    points = float(np.clip(1.6 * inches, 8, 14))
    longest = max(len(str(handle.get_label())) for handle in handles)
    entry = (longest * 0.52 + 3) * points / 72  # inches: a letter is half as wide as high
    ax.legend(
        handles=handles,
        loc="upper center",
        bbox_to_anchor=(0.5, -0.01),
        ncols=int(np.clip(inches / entry, 1, len(handles))),
        fontsize=points,
        handlelength=1.0,
        columnspacing=1.2,
    )
    return ax


def layout_html(layout: np.ndarray, tiles: str, names: Mapping[str, str]) -> str:
    """Return a picture of a layout for a notebook."""
    return to_html(draw_plan(layout, tiles, names, numbered=False))


@styled
def draw_plan(
    layout: Array,
    tiles: str,
    names: Mapping[str, str] = _NO_NAMES,
    numbered: bool = True,
    side: float | None = None,
) -> Figure:
    """Draw a layout with its rows and columns numbered from 0, as messages number them.

    The longer side takes `side` inches, as many as its cells need unless given. The figure is to be
    cropped when it is saved.
    """
    shape, gap = np.shape(layout), 0.45
    side = side or side_of(shape)
    rows, cols = (cells * side / max(shape) for cells in shape)
    figure = new_figure(cols + gap, rows + 0.9, arrange=False, dpi=SCREEN_DPI)
    width, height = figure.get_size_inches()
    axes = figure.add_axes((gap / width, gap / height, cols / width, rows / height))
    draw_layout(layout, tiles, axes, names)
    if numbered:
        number_cells(axes)
    return figure


def number_cells(ax: Axes) -> None:
    """Number rows at the left and columns at the top, as many as can be read."""
    for axis, limits in ((ax.xaxis, ax.get_xlim()), (ax.yaxis, ax.get_ylim())):
        count = round(abs(limits[1] - limits[0]))
        step = next((step for step in _LABELS if count / step <= 12), _LABELS[-1])
        axis.set_ticks(np.arange(0, count, step))
    ax.tick_params(which="major", labeltop=True, labelleft=True, labelsize=8, labelcolor="#666666")


def side_of(shape: tuple[int, ...], panels: int = 1) -> float:
    """Return the inches of the longer side of a layout that is drawn among `panels`."""
    return float(np.clip(_CELL * max(shape), _SMALLEST, _LARGEST / np.sqrt(panels)))


def draw_marks(axes: Axes, marks: Mapping[str, tuple[int, int]]) -> None:
    """Mark named cells (row, column) on a drawn layout, with their names beside them."""
    rows, _ = axes.get_ylim()
    for name, (row, column) in marks.items():
        sign = {"start": "o", "goal": "*"}.get(name, "s")
        axes.scatter(column, row, s=42, color=_NAMED, marker=sign, edgecolors="white", lw=0.6)
        above = row > rows / 2  # where there is space for the name
        axes.annotate(
            name,
            (column, row),
            xytext=(0, 6 if above else -6),
            textcoords="offset points",
            ha="center",
            va="bottom" if above else "top",
            fontsize=7,
            color=_NAMED,
            # On any tile, the name can be read.
            bbox={"facecolor": "white", "edgecolor": "none", "pad": 0.6, "alpha": 0.85},
        )


@styled
def draw_sheet(
    pictures: Sequence[tuple[Array, str, str, str]], across: int = 5, width: float = 2.6
) -> Figure:
    """Draw layouts side by side, at most `across` in a row, each `width` inches wide.

    A picture is a layout (int8 [H, W]), its alphabet, its title and a note below it.
    """
    tallest = max(layout.shape[0] / layout.shape[1] for layout, *_ in pictures)
    figure, panels = new_grid(len(pictures), across, (width, width * tallest + 0.6), dpi=SCREEN_DPI)
    for axes, (layout, tiles, title, note) in zip(panels, pictures, strict=True):
        legend = draw_layout(layout, tiles, axes).get_legend()
        assert legend is not None
        legend.remove()
        axes.set_title(title, fontsize=9)
        axes.set_xlabel(note, fontsize=7)
    return figure


def draw_frames(layouts: Sequence[Array], steps: Sequence[int], tiles: str) -> Figure:
    """Draw how a layout grows, a panel for each number of NCA steps (Figure 6)."""
    numbered = zip(layouts, steps, strict=True)
    panels = [(layout, tiles, f"{number} steps", "") for layout, number in numbered]
    return draw_sheet(panels, across=6, width=2.9)  # six side by side, as in the paper


@styled
def draw_mazes(mazes: Sequence[Drawn], titles: Sequence[str]) -> Figure:
    """Draw a panel for each maze, its start blue and its goal green (Figure 15)."""
    figure, panels = new_grid(len(mazes), 6, (2.3, 2.55))
    colours = ListedColormap([COLOURS[" "], COLOURS["X"], MARKS["start"], MARKS["reached"]])
    for ax, maze, title in zip(panels, mazes, titles, strict=True):
        kinds = maze.layout.copy()
        kinds.flat[[maze.start, maze.goal]] = 2, 3
        ax.imshow(kinds, cmap=colours, vmin=-0.5, vmax=3.5, interpolation="nearest")
        ax.set_title(title, fontsize=7)
        ax.set(xticks=[], yticks=[])
        ax.spines[:].set_visible(True)
    return figure
