"""Figures 7, 9 to 15 and 23: layouts side by side, and what their repairs changed."""

from collections.abc import Sequence
from typing import NamedTuple

from matplotlib.axes import Axes

from experiments.archives import note
from experiments.layouts import MAZE_S, MAZE_S_EVAL, S_EVAL, S, SavedLayout
from experiments.maze_success import PIECES as MAZES
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
    pieces = tuple(dict.fromkeys(panel.saved for panel in panels))

    def draw(folders: Folders) -> Drawn:
        figure, grid = new_grid(len(panels), 3, (4.2, 4.4), dpi=100)
        for axes, panel in zip(grid, panels, strict=True):
            show_layout(axes, panel.saved, folders, panel.title, panel.unrepaired)
        rows = []
        for saved in (piece for piece in pieces if piece.done(folders)):
            made = saved.read(folders)
            size, steps = "{} x {}".format(*made.layout.shape), made.facts["steps"] or ""
            share = f"{made.facts['changed'] / made.layout.size:.1%}" if steps else ""
            rows.append((saved.domain, saved.maker, size, steps, made.facts["changed"], share))
        head = ("domain", "maker", "size", "steps of growth", "cells the repair changed", "share")
        solved = [
            f"The agent arrives in {row.successes} of {row.runs} runs in random maze {row.maze}."
            for piece in MAZES
            for row in piece.read(folders)
            if SavedLayout("maze-walls", f"random-{row.maze}", piece.layout.shape) in pieces
        ]
        return Drawn(figure, (*table(head, rows), *[""] * bool(solved), *solved))

    return Experiment(shows, pieces, draw)


def show_layout(
    axes: Axes, saved: SavedLayout, folders: Folders, title: str, unrepaired: bool = False
) -> None:
    """Draw a layout, or leave a note that it is not made yet."""
    if not saved.done(folders):
        note(axes, f"{saved.stem}\nnot made yet")
        return
    made = saved.read(folders)
    shown = made.unrepaired if unrepaired else made.layout
    draw_layout(shown, made.domain.tiles, axes, made.domain.names)
    axes.set_title(title, fontsize="small")


# Of both domains and every alpha, by size.
_WAREHOUSES = {
    shape: [
        Panel(f"{kind}, alpha = {alpha}", SavedLayout(f"warehouse-{kind}", maker, shape))
        for kind in ("even", "uneven")
        for alpha, maker in {0: "a0", 1: "a1", 5: "cma-mae-2"}.items()
    ]
    for shape in (S, S_EVAL)
}
_PANELS: dict[str, tuple] = {
    "figure_09": (
        "what automata grow from",
        Panel("warehouse", SavedLayout("warehouse-even", "seed")),
        Panel("manufacturing", SavedLayout("manufacturing", "seed")),
        Panel("maze", SavedLayout("maze-walls", "seed", MAZE_S)),
    ),
    "figure_07": (
        "example layouts of size S",
        Panel("warehouse", SavedLayout("warehouse-even", "nca")),
        Panel("manufacturing", SavedLayout("manufacturing", "nca")),
        Panel("maze", SavedLayout("maze-walls", "nca", MAZE_S)),
    ),
    "figure_10": (
        "warehouses of size S",
        Panel("designed by hand", SavedLayout("warehouse-even", "human")),
        Panel("even, DSAGE", SavedLayout("warehouse-even", "dsage")),
        Panel("uneven, DSAGE", SavedLayout("warehouse-uneven", "dsage")),
        *_WAREHOUSES[S],
    ),
    "figure_11": (
        "factories of size S",
        Panel("designed by hand", SavedLayout("manufacturing", "human")),
        Panel("DSAGE", SavedLayout("manufacturing", "dsage")),
        Panel("grown and repaired", SavedLayout("manufacturing", "nca")),
        Panel("as it was grown", SavedLayout("manufacturing", "nca"), unrepaired=True),
    ),
    "figure_12": ("grown warehouses of size S_eval", *_WAREHOUSES[S_EVAL]),
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
