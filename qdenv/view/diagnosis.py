"""The picture of a check: which cells break a rule, and what else makes a layout risky."""

from __future__ import annotations

from collections.abc import Sequence
from textwrap import wrap
from typing import Any

from matplotlib.collections import PatchCollection
from matplotlib.figure import Figure
from matplotlib.patches import Patch, Rectangle

from qdenv.repairs.audit import Violation
from qdenv.study.diagnosis import Remark
from qdenv.study.plans import Plan
from qdenv.view.layouts import draw_plan
from qdenv.view.style import PALETTE, WARNING, styled

# The broad marks first: the small ones are drawn over them.
_LOOKS = {
    "narrow": ("#f0e442", "", 0.6, 0.0),  # colour, hatch, opacity, points of the frame
    "dead ends": (PALETTE[3], "////", 0.9, 0.6),
    "stations": (PALETTE[2], "", 0.0, 1.6),
    "cuts": (PALETTE[4], "xxxx", 0.9, 0.9),
    "broken": (WARNING, "", 0.0, 2.0),
}
_LETTERS = 42  # of a line of the legend


@styled
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
        frameon=False,
    )
    return figure
