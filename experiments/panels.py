"""Figures of layouts side by side, and what their repairs changed."""

from collections.abc import Sequence
from typing import NamedTuple

from matplotlib.figure import Figure

from experiments.archives import note
from experiments.layouts import SavedLayout
from experiments.pieces import Drawn, Experiment, Folders, table
from qdenv.view.layouts import draw_layout
from qdenv.view.style import new_figure

COLUMNS = 3  # panels side by side


class Panel(NamedTuple):
    """One layout of a figure."""

    title: str  # above it
    saved: SavedLayout  # which
    unrepaired: bool = False  # show what it was before its repair


def panels_of(shows: str, panels: Sequence[Panel]) -> Experiment:
    """Make an experiment that shows layouts side by side, and says what the repair changed."""

    def draw_all(folders: Folders) -> Drawn:
        rows = []
        for saved in dict.fromkeys(panel.saved for panel in panels if panel.saved.done(folders)):
            made = saved.read(folders)
            size, steps = "{} x {}".format(*made.layout.shape), made.facts["steps"] or ""
            share = f"{made.facts['changed'] / made.layout.size:.1%}" if steps else ""
            rows.append((saved.domain, saved.maker, size, steps, made.facts["changed"], share))
        head = ("domain", "maker", "size", "steps of growth", "cells the repair changed", "share")
        return Drawn(draw_panels(panels, folders), table(head, rows))

    pieces = tuple(dict.fromkeys(panel.saved for panel in panels))
    return Experiment(shows, pieces, draw_all)


def draw_panels(panels: Sequence[Panel], folders: Folders) -> Figure:
    """Draw those layouts that are saved side by side; the others leave a note."""
    columns = min(COLUMNS, len(panels))
    rows = -(-len(panels) // columns)
    figure = new_figure(4.2 * columns, 4.4 * rows, dpi=100)
    axes = figure.subplots(rows, columns, squeeze=False).ravel()
    for place, panel in zip(axes, panels, strict=False):
        if not panel.saved.done(folders):
            note(place, f"{panel.saved.stem}\nnot made yet")
            continue
        made = panel.saved.read(folders)
        shown = made.unrepaired if panel.unrepaired else made.layout
        draw_layout(shown, made.domain.tiles, place, made.domain.names)
        place.set_title(panel.title, fontsize="small")
    for place in axes[len(panels) :]:
        place.remove()
    return figure
