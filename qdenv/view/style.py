"""Figures without a window system: one style for screen and paper, and the one way to save them.

Letters keep their size at every width, as journals want it; what does not fit side by side stands
one below the other. Legends stand outside of what they explain.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from cycler import cycler
from matplotlib import rc_context
from matplotlib.artist import Artist
from matplotlib.figure import Figure
from matplotlib.legend import Legend

from qdenv.io.files import write_atomically

_DPI = 220  # journals ask for 200 at least
SCREEN_DPI = 150  # of pictures that are larger than paper

# Okabe and Ito 2008, without the yellow that is lost on white: told apart by colour-blind eyes.
PALETTE = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#000000", "#56b4e9", "#e69f00")
MARKERS = "osD^vPX"
DASHES = ("-", "--", ":", "-.")  # of lines beyond the colours
GREY = "#6b7280"
WARNING = "#d55e00"

_LETTERS = 8  # points
SMALL = 7  # of numbers along axes
_KEYS = 7.5  # of legends
# Typed by matplotlib as literals of its own.
_STYLE: Any = {
    "font.size": _LETTERS,
    "axes.titlesize": _LETTERS + 1,
    "axes.labelsize": _LETTERS,
    "figure.titlesize": _LETTERS + 1.5,
    "xtick.labelsize": SMALL,
    "ytick.labelsize": SMALL,
    "legend.fontsize": _KEYS,
    "legend.frameon": False,
    "axes.prop_cycle": cycler(color=PALETTE),
    "axes.linewidth": 0.6,
    "axes.axisbelow": True,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "grid.alpha": 0.3,
    "grid.linewidth": 0.5,
    "xtick.major.width": 0.6,
    "ytick.major.width": 0.6,
    "lines.linewidth": 1.4,
    "lines.markersize": 4,
    "errorbar.capsize": 2,
    "image.composite_image": False,
}
# TrueType in PDF, which journals ask for and editors of pictures read; text stays text in SVG.
FONTS: Any = {
    "pdf.fonttype": 42,
    "ps.fonttype": 42,
    "svg.fonttype": "none",
    "svg.hashsalt": "qdenv",
}
_LETTER = 0.56  # of a letter's height: its width
_LONGEST = 28  # letters of a layout's name; those of long paths are cut at the left
_KEY = 3.5  # letters that a legend's key and the gap behind it take

# Draws in the style of this module and leaves the session's own as it is: `@styled`.
styled = rc_context(_STYLE)


class _StyledFigure(Figure):
    """A figure in the style of this module: ticks, made only when it is drawn, read it then."""

    def draw(self, renderer: Any) -> None:
        """Draw with this style, whatever the style of the session is."""
        with rc_context(_STYLE):
            super().draw(renderer)


def new_figure(width: float, height: float, arrange: bool = True, dpi: int = _DPI) -> Figure:
    """Make an empty figure, for functions that are `styled`.

    Built without pyplot, which would keep every figure alive and pick a window system.

    Args:
        width: in inches, on paper.
        height: in inches.
        arrange: let matplotlib place the axes so that no labels overlap; else by hand.
        dpi: pixels per inch.
    """
    figure = _StyledFigure(figsize=(width, height), dpi=dpi)
    figure.set_layout_engine("constrained" if arrange else "none")
    return figure


def name_of(layout: str) -> str:
    """Write a layout's name as words: ``warehouse_human`` is "warehouse human"."""
    words = layout.replace("_", " ").strip() or layout
    return words if len(words) <= _LONGEST else f"...{words[-_LONGEST:]}"


def add_legend(figure: Figure, handles: Sequence[Artist], labels: Sequence[str]) -> Legend | None:
    """Put a legend above all axes of a figure, where it covers nothing; None for no entries."""
    if not handles:
        return None
    entry = (max(map(len, labels)) * _LETTER + _KEY) * _KEYS / 72  # inches
    rows = -(-len(handles) // max(1, int(figure.get_figwidth() / entry)))
    return figure.legend(
        handles,
        labels,
        loc="outside upper center",  # matplotlib's stubs lack it
        ncols=-(-len(handles) // rows),  # rows of equal length
        handlelength=2.2,
        columnspacing=1.4,
    )


def save_figure(figure: Figure, path: str | Path, crop: bool = False) -> None:
    """Write a figure in one step: a reader never sees half a file.

    Args:
        figure: what to write.
        path: where; the ending chooses the format (png, pdf, svg), png without one.
        crop: cut the picture to what is drawn, labels outside the figure included.

    Raises:
        InputError: the place cannot be written to.
    """
    target = Path(path)
    form = target.suffix.lstrip(".") or "png"
    box = "tight" if crop else None
    with rc_context(FONTS):
        write_atomically(target, lambda file: figure.savefig(file, format=form, bbox_inches=box))
