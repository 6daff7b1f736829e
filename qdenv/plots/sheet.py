"""A sheet of layouts: small pictures side by side, each with its name and a line below it."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

from matplotlib.figure import Figure

from qdenv.plots.figure import new_figure, save_figure
from qdenv.plots.layouts import draw_layout
from qdenv.types import Array

PANEL = 2.6  # inches of a layout's width
ACROSS = 5


class Picture(NamedTuple):
    """One layout of a sheet."""

    layout: Array  # int8 [H, W]
    tiles: str  # its alphabet
    names: Mapping[str, str]  # how the legend calls the tiles
    title: str  # above it
    note: str  # below it


def draw_sheet(pictures: Sequence[Picture]) -> Figure:
    """Draw layouts side by side, five in a row."""
    down = -(-len(pictures) // ACROSS)
    across = min(len(pictures), ACROSS)
    tallest = max(one.layout.shape[0] / one.layout.shape[1] for one in pictures)
    figure = new_figure(PANEL * across, (PANEL * tallest + 0.6) * down)
    panels = figure.subplots(down, across, squeeze=False).ravel()
    for axes, one in zip(panels, pictures, strict=False):
        draw_layout(one.layout, one.tiles, axes, one.names)
        axes.get_legend().remove()
        axes.set_title(one.title, fontsize=9)
        axes.set_xlabel(one.note, fontsize=7)
    for axes in panels[len(pictures) :]:
        axes.set_axis_off()
    return figure


def save_sheet(path: str | Path, pictures: Sequence[Picture]) -> None:
    """Save layouts side by side; the ending of `path` chooses the format.

    Raises:
        InputError: the place cannot be written to.
    """
    save_figure(draw_sheet(pictures), path)
