"""Pictures inside of notebooks: HTML that holds them whole."""

import base64
import io
from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.figure import Figure

from qdenv.types import Measure
from qdenv.view.archive import draw_archive, scatter_objectives
from qdenv.view.layouts import draw_layout
from qdenv.view.style import new_figure

_DPI = 80  # pixels per inch: these are looked at beside text


def _figure_html(figure: Figure) -> str:
    """Turn a figure into an <img> with its pixels inside."""
    content = io.BytesIO()
    figure.savefig(content, format="png", dpi=_DPI, bbox_inches="tight")
    return f'<img src="data:image/png;base64,{base64.b64encode(content.getvalue()).decode()}">'


def layout_html(layout: np.ndarray, tiles: str, names: Mapping[str, str]) -> str:
    """Draw a layout (int8 [H, W]) for a notebook; `names` are the legend's."""
    # The axes' figure lives no longer than somebody holds it.
    axes = draw_layout(layout, tiles, names=names)
    figure = axes.get_figure()
    assert isinstance(figure, Figure)
    return _figure_html(figure)


def archive_html(
    index: np.ndarray, objective: np.ndarray, measures: Sequence[Measure], label: str
) -> str:
    """Draw the heat map of saved elites for a notebook; nothing for more than two measures."""
    if len(measures) > 2:
        return ""
    figure = new_figure(6, 4.8)
    draw_archive(figure, scatter_objectives(index, objective, measures), measures, label=label)
    return _figure_html(figure)
