"""The explorer: the archive of a run as a map that one can touch, in one file."""

from __future__ import annotations

import shlex
from typing import Any

import numpy as np
from matplotlib import colormaps
from matplotlib.colors import to_hex

from qdenv.domains.base import Domain, make_domain
from qdenv.pages.explorer_layouts import (
    GROWN,
    LAYOUTS,
    Growth,
    bits_of,
    grow_elites,
    pack_layouts,
)
from qdenv.pages.explorer_numbers import columns_of, facts_of_columns, runs_of
from qdenv.pages.page import Page, make_page, missing
from qdenv.plots.archive import COLOURS as SCALE
from qdenv.plots.layouts import CHANGED, COLOURS, UNKNOWN
from qdenv.progress import Progress, silent
from qdenv.ranges import NonNegativeInt, check_range
from qdenv.run.archive import Archive
from qdenv.run.directory import RunDirectory
from qdenv.study.elites import make_grower
from qdenv.types import InputError

SHADES = 12  # of the colour scale, with straight lines between
SCRIPTS = (
    "data",
    "tiles",
    "sketch",
    "place",
    "map",
    "pointer",
    "table",
    "cards",
    "growth",
    "start",
)


def read_archive(run: RunDirectory, growth: int | None = None) -> Archive:
    """Read the archive of a run, and refuse what no explorer shows.

    Raises:
        InputError: there is no elite, there are more than two measures, or the number of elites
            whose growth is shown is negative.
    """
    check_range("growth", growth, NonNegativeInt | None)
    measures = run.measures
    if len(measures) > 2:
        raise InputError(
            f"{run}: an explorer shows one or two measures, not {len(measures)}: "
            f"`qdenv export {run}` writes a table of all"
        )
    archive = run.archive
    assert archive.best  # refuses an empty one
    return archive


def make_explorer(
    run: RunDirectory, growth: int | None = None, progress: Progress = silent
) -> tuple[Page, dict[str, Any]]:
    """Make the explorer of a run's archive.

    Args:
        run: a run that has saved an archive.
        growth: how many elites the page shows growing, evenly spread over the archive, the best
            among them; unless given as many as fit into 12 MB.
        progress: told how far it is.

    Returns:
        the page, and its facts in brief.

    Raises:
        InputError: as in `read_archive`, or a package is not installed.
    """
    archive, config = read_archive(run, growth), run.config.evaluation
    try:
        from plotly.offline import get_plotlyjs
    except ImportError as error:
        raise missing("explorers", "plotly") from error
    domain = make_domain(config.domain)
    grown = grow_elites(archive, *make_grower(config, domain), growth, progress)
    progress("writing", -1, "")
    columns, runs = columns_of(archive, domain), runs_of(archive.columns)
    packed: dict[str, np.ndarray | bytes | str] = {
        "plotly": get_plotlyjs().encode(),
        "cells": archive.columns["index"].astype("<i4"),
        "values": np.stack([one.values for one in columns]),
    }
    if runs is not None:
        packed["runs"] = runs.values
    packed |= pack_layouts(archive, bits_of(domain.tiles)) | grown.packed
    facts = _facts(run, archive, domain, grown) | facts_of_columns(archive, columns, runs)
    title = f"{domain.name}: {len(archive):,} layout{'s' * (len(archive) != 1)}"
    scripts = [f"explorer_{name}" for name in SCRIPTS]
    words = {"head": _head(run, archive), "mark": CHANGED}
    words |= {name: facts[name] for name in ("rows", "cols")}
    page = make_page("explorer", title, scripts, facts, packed, **words)
    return page, {
        "domain": domain.name,
        "elites": len(archive),
        "growth": len(grown.rows),
        "growth_differing": len(grown.differing),
        "megabytes": len(page.html.encode()) / 1e6,
    }


def _head(run: RunDirectory, archive: Archive) -> str:
    """Say in a line what the archive is worth."""
    cells = int(np.prod(archive.shape))
    return (
        f"{run}: {len(archive):,} of {cells:,} cells filled ({archive.coverage:.1%}), "
        f"best {archive.meaning.objective} {archive.best.objective:.4g}, "
        f"QD-score {archive.qd_score:,.1f}"
    )


def _facts(run: RunDirectory, archive: Archive, domain: Domain, grown: Growth) -> dict[str, Any]:
    """Say what the page shows, JSON-ready; rows are those of archive.npz."""
    rows, cols = archive.columns["repaired"].shape[1:]
    tiles = archive.meaning.tiles
    return {
        "run": str(run),
        "command": f"qdenv generate {shlex.quote(str(run))} --elite ",
        "enlarge": f"qdenv explore {shlex.quote(str(run))} --growth {len(archive)}",
        "details": domain.details,
        "tiles": tiles,
        "tile_names": [domain.names.get(tile, tile) for tile in tiles],
        "colours": [COLOURS.get(tile, UNKNOWN) for tile in tiles],
        "mark": CHANGED,
        "scale": [to_hex(colormaps[SCALE](shade)) for shade in np.linspace(0, 1, SHADES)],
        "rows": rows,
        "cols": cols,
        "bits": bits_of(tiles),
        "chunk": LAYOUTS,
        "repairs": domain.rules is not None and "unrepaired" in archive.columns,
        "axes": [
            {"name": axis.name, "low": axis.low, "high": axis.high, "cells": axis.cells}
            for axis in archive.meaning.measures
        ],
        "elites": len(archive),
        "named": _named(run, archive),
        "growth": {
            "steps": grown.steps,
            "rows": grown.rows,
            "chunk": GROWN,
            "differing": grown.differing,
        },
    }


def _named(run: RunDirectory, archive: Archive) -> list[dict[str, Any]]:
    """List the elites that have names, the best or what was asked for first."""
    cells = {"best": archive.best.cell}
    if run.shipped is not None:
        own = run.shipped.name
        every = {one.name: one.cell for one in run.shipped.collection.generators.values()}
        cells = {own: every[own]} | every
    found = {tuple(cell): row for row, cell in enumerate(archive.cells.tolist())}
    return [{"name": name, "row": found[cell]} for name, cell in cells.items() if cell in found]
