"""Figures 7, 10 to 15 and 23: layouts side by side, and what their repairs changed."""

from collections.abc import Sequence
from typing import NamedTuple

from matplotlib.figure import Figure

from experiments.archives import note
from experiments.layouts import MAZE_S, MAZE_S_EVAL, S_EVAL, SavedLayout
from experiments.pieces import Drawn, Experiment, Folders, table
from qdenv.view.layouts import draw_layout
from qdenv.view.style import new_grid


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
    figure, grid = new_grid(len(panels), 3, (4.2, 4.4), dpi=100)
    for place, panel in zip(grid, panels, strict=True):
        if not panel.saved.done(folders):
            note(place, f"{panel.saved.stem}\nnot made yet")
            continue
        made = panel.saved.read(folders)
        shown = made.unrepaired if panel.unrepaired else made.layout
        draw_layout(shown, made.domain.tiles, place, made.domain.names)
        place.set_title(panel.title, fontsize="small")
    return figure


_PANELS: dict[str, tuple] = {
    "figure_07": (
        "example layouts of size S",
        Panel("warehouse", SavedLayout("warehouse-even", "nca")),
        Panel("manufacturing", SavedLayout("manufacturing", "nca")),
        Panel("maze", SavedLayout("maze-walls", "nca", MAZE_S)),
    ),
    "figure_10": (
        "warehouses of size S",
        Panel("designed by hand", SavedLayout("warehouse-even", "human")),
        Panel("even, alpha = 0", SavedLayout("warehouse-even", "a0")),
        Panel("even, alpha = 1", SavedLayout("warehouse-even", "a1")),
        Panel("even, alpha = 5", SavedLayout("warehouse-even", "nca")),
        Panel("uneven, alpha = 0", SavedLayout("warehouse-uneven", "a0")),
        Panel("uneven, alpha = 1", SavedLayout("warehouse-uneven", "a1")),
        Panel("uneven, alpha = 5", SavedLayout("warehouse-uneven", "nca")),
    ),
    "figure_11": (
        "factories of size S",
        Panel("designed by hand", SavedLayout("manufacturing", "human")),
        Panel("grown and repaired", SavedLayout("manufacturing", "nca")),
        Panel("as it was grown", SavedLayout("manufacturing", "nca"), unrepaired=True),
    ),
    "figure_12": (
        "grown warehouses of size S_eval",
        Panel("even, alpha = 0", SavedLayout("warehouse-even", "a0", S_EVAL)),
        Panel("even, alpha = 1", SavedLayout("warehouse-even", "a1", S_EVAL)),
        Panel("even, alpha = 5", SavedLayout("warehouse-even", "nca", S_EVAL)),
        Panel("uneven, alpha = 0", SavedLayout("warehouse-uneven", "a0", S_EVAL)),
        Panel("uneven, alpha = 1", SavedLayout("warehouse-uneven", "a1", S_EVAL)),
        Panel("uneven, alpha = 5", SavedLayout("warehouse-uneven", "nca", S_EVAL)),
    ),
    "figure_13": (
        "a grown factory of size S_eval",
        Panel("as it was grown", SavedLayout("manufacturing", "nca", S_EVAL), unrepaired=True),
        Panel("repaired", SavedLayout("manufacturing", "nca", S_EVAL)),
    ),
    "figure_14": (
        "layouts designed by hand, of size S_eval",
        Panel("warehouse", SavedLayout("warehouse-even", "human", S_EVAL)),
        Panel("factory", SavedLayout("manufacturing", "human", S_EVAL)),
    ),
    "figure_15": (
        "random mazes like a grown one",
        Panel("grown", SavedLayout("maze-walls", "nca", MAZE_S_EVAL)),
        Panel("random", SavedLayout("maze-walls", "random-0", MAZE_S_EVAL)),
        Panel("random", SavedLayout("maze-walls", "random-1", MAZE_S_EVAL)),
    ),
    "figure_23": (
        "what CMA-ES' automata grow at size S_eval",
        Panel("warehouse (even)", SavedLayout("warehouse-even", "cma-es", S_EVAL), unrepaired=True),
        Panel("manufacturing", SavedLayout("manufacturing", "cma-es", S_EVAL), unrepaired=True),
    ),
}
FIGURES = {name: panels_of(shows, panels) for name, (shows, *panels) in _PANELS.items()}
