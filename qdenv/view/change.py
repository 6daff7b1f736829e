"""Marks on layouts: what a change removed and placed, with its traffic; what a check found."""

from collections.abc import Mapping, Sequence
from textwrap import wrap
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import PatchCollection
from matplotlib.figure import Figure
from matplotlib.patches import Patch, Rectangle

from qdenv.guidance import preferences
from qdenv.repairs.audit import Violation
from qdenv.study.diagnosis import Remark
from qdenv.study.plans import Plan
from qdenv.types import Array, InputError
from qdenv.view import style
from qdenv.view.guidance import STRONGEST, draw_arrows
from qdenv.view.layouts import CHANGED, draw_layout, draw_plan, number_cells, side_of
from qdenv.view.traffic import draw_map, top_of

_FRAMED = 0.4  # share of the cells beyond which a change is a new floor: frames would hide it

# The broad marks first: the small ones are drawn over them.
_LOOKS = {
    "narrow": ("#f0e442", "", 0.6, 0.0),  # colour, hatch, opacity, points of the frame
    "dead ends": (style.PALETTE[3], "////", 0.9, 0.6),
    "stations": (style.PALETTE[2], "", 0.0, 1.6),
    "cuts": (style.PALETTE[4], "xxxx", 0.9, 0.9),
    "broken": (style.WARNING, "", 0.0, 2.0),
}
_LETTERS = 42  # of a line of the legend


@style.styled
def draw_change(
    before: Plan,
    after: Plan,
    usages: tuple[Array, Array] | None = None,
    names: tuple[str, str] = ("before", "after"),
    width: float | None = None,
) -> Figure:
    """Draw two layouts side by side: what was removed is framed at the left, what was placed right.

    Arrows lie on those whose moves have costs. The `usages` of both (`recordings.Maps.usage`) are
    drawn below them on one colour scale. The figure, as wide as its cells need unless `width`
    inches are given, is to be cropped when it is saved. Raises InputError if the sizes differ.
    """
    rows, cols = before.layout.shape
    if after.layout.shape != (rows, cols):
        theirs = "{} x {}".format(*after.layout.shape)
        raise InputError(f"{names[0]} is {rows} x {cols} and {names[1]} {theirs}: nothing to match")
    width = width or 2 * side_of((rows, cols), 2) * cols / max(rows, cols) + 0.9
    # Of a panel's width, labels and colour bars take a part; titles and legends stand around it.
    side = 0.5 * width - (0.4 if usages is None else 1.2)  # inches of a layout
    high, lines = side * rows / cols, 1 if usages is None else 2
    figure = style.new_figure(width, lines * (high + 0.7) + 0.8, dpi=style.SCREEN_DPI)
    panels = figure.subplots(lines, 2, squeeze=False)
    changed = before.layout != after.layout
    for axes, plan, verb, name in zip(
        panels[0], (before, after), ("removed", "placed"), names, strict=True
    ):
        number_cells(draw_layout(plan.layout, plan.domain.tiles, axes, plan.domain.names))
        if plan.costs is not None:
            free = plan.domain.drivable(plan.layout)
            draw_arrows(axes, preferences(plan.costs, free) / STRONGEST).set_gid(f"{verb}-guidance")
        _frame(axes, plan, changed, (name, verb), max(0.7, min(1.2, 20 * side / cols)))
    if usages is not None:
        top = top_of(np.stack(usages))
        for axes, plan, usage in zip(panels[1], (before, after), usages, strict=True):
            free, label = plan.domain.drivable(plan.layout), "share of time in which one is here"
            draw_map(axes, free, np.asarray(usage), "usage", label, "where robots are", top)
    return figure


@style.styled
def draw_racks_moved(found: Mapping[str, tuple[Array, Array]], agents: int, plan: float) -> Figure:
    """Draw what moving racks brings: tasks per timestep over shelves moved, a point a layout.

    `found` holds both of the layouts of each search (int [N], float [N]), `plan` is what the plan
    itself moves.
    """
    figure = style.new_figure(6.0, 3.0)
    axes = figure.subplots()
    for (name, (moved, throughput)), colour, marker in zip(
        found.items(), style.PALETTE, style.MARKERS, strict=False
    ):
        axes.plot(moved, throughput, marker, color=colour, label=name, alpha=0.7, mew=0)
    axes.axhline(plan, color=style.GREY, ls="--", lw=1)
    look: Any = {"textcoords": "offset points", "va": "top", "color": style.GREY}
    axes.annotate("the plan", (0, plan), (2, -3), **look)
    title = f"what moving racks brings, {agents} robots in the searches' short runs"
    axes.set(xlabel="shelves moved", ylabel="tasks per timestep", title=title)
    axes.grid()
    style.add_legend(figure, axes)
    return figure


def _frame(
    axes: Axes, plan: Plan, changed: np.ndarray, title: tuple[str, str], points: float
) -> None:
    """Frame the changed cells that are no bare floor, and count them by tile in the title."""
    name, verb = title
    kinds = plan.layout[changed]
    counts = [
        f"{plan.domain.names.get(tile, repr(tile))} {(kinds == kind).sum()}"
        for kind, tile in enumerate(plan.domain.tiles)
        if kind and (kinds == kind).any()
    ]
    lanes = "" if plan.costs is None else "lanes: arrows point the cheaper way"
    text = f"{verb}: {', '.join(counts)}" if counts else lanes or f"nothing {verb}"
    axes.set_title(f"{name}\n{text}")
    if changed.mean() <= _FRAMED:
        cells = np.argwhere(changed & (plan.layout > 0))
        frames = [Rectangle((column - 0.42, row - 0.42), 0.84, 0.84) for row, column in cells]
        look = PatchCollection(frames, facecolor="none", edgecolor=CHANGED, linewidth=points)
        axes.add_collection(look)


@style.styled
def draw_diagnosis(plan: Plan, broken: Sequence[Violation], remarks: Sequence[Remark]) -> Figure:
    """Draw a layout with its marks, and a legend at the right that says what each one is.

    The figure is to be cropped when it is saved.
    """
    figure = draw_plan(plan.layout, plan.domain.tiles, plan.domain.names)
    axes, handles = figure.axes[0], []
    found = [*(Remark("broken", one.message, one.cells) for one in broken), *remarks]
    for kind, (colour, hatch, opacity, points) in _LOOKS.items():
        filled = (colour, opacity) if opacity and not hatch else "none"
        look: Any = {"facecolor": filled, "edgecolor": colour, "linewidth": points}
        for one in (one for one in found if one.kind == kind):
            squares = [Rectangle((col - 0.45, row - 0.45), 0.9, 0.9) for row, col in one.cells]
            axes.add_collection(PatchCollection(squares, hatch=hatch, **look))
            text = "\n".join(wrap(one.message, _LETTERS))
            handles.append(Patch(hatch=hatch, label=text, **look))
    # Broken rules first; the legend of the axes counts the tiles.
    figure.legend(
        handles=handles[::-1] or [Patch(facecolor="none", label="nothing to remark")],
        loc="upper left",
        bbox_to_anchor=(1.02, 1.0),
        bbox_transform=axes.transAxes,
        labelspacing=1.0,
        fontsize=9,
    )
    return figure
