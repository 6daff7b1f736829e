"""Figures without a window system: one style for screen and paper, and what a figure becomes.

Letters keep their size at every width, as journals demand; what does not fit side by side is
stacked. Legends stand outside of what they explain.
"""

import base64
import io
import re
from pathlib import Path
from typing import Any

from cycler import cycler
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from qdenv.io.files import write_atomically

_DPI = 220  # journals ask for 200 at least
SCREEN_DPI = 150  # of pictures that are larger than paper
_NOTEBOOK_DPI = 80  # of pictures that are read beside text

# Okabe and Ito 2008, without the yellow that is lost on white: told apart by colour-blind eyes.
PALETTE = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#000000", "#56b4e9", "#e69f00")
MARKERS = "osD^vPX"
GREY = "#6b7280"
WARNING = "#d55e00"

_LETTERS = 8  # points
SMALL = 7  # of numbers along axes
_KEYS = 7.5  # of legends
ABREAST = 5.0  # inches of a figure from which its panels stand side by side
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
    "text.parse_math": False,  # a $ in a file's name is a $
}
# TrueType in PDF, which journals ask for and editors of pictures read; text stays text in SVG.
_FONTS: Any = {
    "pdf.fonttype": 42,
    "ps.fonttype": 42,
    "svg.fonttype": "none",
    "svg.hashsalt": "qdenv",  # the same figure gets the same identifiers
}


def colour(number: int) -> str:
    """Return the colour of the thing of this number among several in one figure."""
    return PALETTE[number % len(PALETTE)]


# Draws in the style of this module and leaves the session's own as it is: `@styled`.
styled = rc_context(_STYLE)


class _StyledFigure(Figure):
    """A figure in this style: ticks, made only when it is drawn, read the style then."""

    def draw(self, renderer: Any) -> None:
        """Draw with this style, whatever the style of the session is."""
        with rc_context(_STYLE):
            super().draw(renderer)


def new_figure(width: float, height: float, arrange: bool = True, dpi: int = _DPI) -> Figure:
    """Make an empty figure of this size (inches), for functions that are `styled`.

    Made without pyplot, which would keep every figure alive and pick a window system. With
    `arrange`, matplotlib places the axes so that no labels overlap; else the caller does.
    """
    figure = _StyledFigure(figsize=(width, height), dpi=dpi)
    figure.set_layout_engine("constrained" if arrange else "none")
    return figure


def new_grid(
    count: int,
    across: int,
    size: tuple[float, float],
    extra: tuple[float, float] = (0.0, 0.0),
    dpi: int = _DPI,
) -> tuple[Figure, list[Axes]]:
    """Make a figure of `count` panels, at most `across` in a row, as `new_figure` makes it.

    `size` is that of a panel, `extra` what the figure has beyond its panels (inches).
    """
    across = min(count, across)
    down = -(-count // across)
    figure = new_figure(size[0] * across + extra[0], size[1] * down + extra[1], dpi=dpi)
    panels: list[Axes] = figure.subplots(down, across, squeeze=False).ravel().tolist()
    for spare in panels[count:]:
        spare.remove()
    return figure, panels[:count]


def format_name(layout: str) -> str:
    """Write a layout's name for a legend: ``warehouse_human`` is "warehouse human"."""
    name = layout.replace("_", " ").strip() or layout
    return name if len(name) <= 28 else f"...{name[-28:]}"  # the end of a path says most


def add_legend(figure: Figure, axes: Axes) -> None:
    """Put a legend of what `axes` show above all axes of a figure, where it covers nothing."""
    handles, labels = axes.get_legend_handles_labels()
    if not handles:
        return
    # A letter is about 0.56 of its height wide; the key and the gap behind it take 3.5 letters.
    entry = (max(map(len, labels)) * 0.56 + 3.5) * _KEYS / 72  # inches
    rows = -(-len(handles) // max(1, int(figure.get_figwidth() / entry)))
    figure.legend(
        handles,
        labels,
        loc="outside upper center",
        ncols=-(-len(handles) // rows),  # rows of equal length
        handlelength=2.2,
        columnspacing=1.4,
    )


def save_figure(figure: Figure, path: str | Path, crop: bool = False) -> None:
    """Write a figure in one step: a reader never sees half a file.

    The ending of `path` decides the format (png, pdf, svg), png without one; `crop` cuts the
    picture to what is drawn, labels outside the figure included. Raises InputError if the place
    cannot be written to.
    """
    target = Path(path)
    form = target.suffix.lstrip(".") or "png"
    box = "tight" if crop else None
    with rc_context(_FONTS):
        write_atomically(target, lambda file: figure.savefig(file, format=form, bbox_inches=box))


def to_svg(figure: Figure, name: str, crop: bool = False) -> str:
    """Return a figure as an SVG element; `name` begins its identifiers, unique within a page."""
    content = io.StringIO()
    box = "tight" if crop else None
    with rc_context(_FONTS):
        figure.savefig(content, format="svg", bbox_inches=box, metadata={"Date": None})
    svg = content.getvalue()
    svg = svg[svg.index("<svg") :]
    svg = re.sub(r'(\bid="|url\(#|href="#)', rf"\g<1>{name}-", svg)
    return re.sub(r"<metadata>.*?</metadata>", "", svg, flags=re.DOTALL)


def to_html(figure: Figure) -> str:
    """Return a figure as an <img> element that holds its pixels, for notebooks."""
    content = io.BytesIO()
    figure.savefig(content, format="png", dpi=_NOTEBOOK_DPI, bbox_inches="tight")
    return f'<img src="data:image/png;base64,{base64.b64encode(content.getvalue()).decode()}">'
