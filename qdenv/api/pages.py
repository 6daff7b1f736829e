"""Functions that give pages: they show themselves in a notebook and save as one file."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from qdenv.training.records import RunDirectory

if TYPE_CHECKING:
    from qdenv.pages.page import Page


def explore(run: RunDirectory | str | Path, growth: int | None = None) -> Page:
    """Make a page on which a run's archive can be touched: layouts, numbers, growth.

    Args:
        run: the run, or its folder, or ``zoo:DOMAIN/NAME``.
        growth: how many elites the page shows growing; unless given as many as fit into 12 MB.

    Returns:
        the page; `Page.save` writes it as one file that needs no network.

    Raises:
        InputError: there is no elite, there are more than two measures, or a package is missing.
    """
    from qdenv.pages.explorer import make_explorer

    opened = run if isinstance(run, RunDirectory) else RunDirectory.open(run)
    return make_explorer(opened, growth)[0]
