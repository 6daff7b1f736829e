"""Figures without a window system, and the one way to save them."""

from pathlib import Path

from matplotlib.figure import Figure

from qdenv.files import write_atomically

DPI = 150


def new_figure(width: float, height: float, arrange: bool = True, dpi: int = DPI) -> Figure:
    """Make an empty figure.

    Built without pyplot, which would keep every figure alive and pick a window system.

    Args:
        width: in inches.
        height: in inches.
        arrange: let matplotlib place the axes so that no labels overlap; else by hand.
        dpi: pixels per inch.
    """
    figure = Figure(figsize=(width, height), dpi=dpi)
    figure.set_layout_engine("constrained" if arrange else "none")
    return figure


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
    write_atomically(target, lambda file: figure.savefig(file, format=form, bbox_inches=box))
