"""The explorer: a page on which a run's archive can be touched, its numbers, layouts and growth."""

import dataclasses
import itertools
import shlex
from typing import Any

import numpy as np
from matplotlib import colormaps
from matplotlib.colors import to_hex

from qdenv.domains.base import Domain, make_domain
from qdenv.guidance import preferences
from qdenv.progress import Progress, silent
from qdenv.ranges import NonNegativeInt, check_range
from qdenv.run.archive import SavedArchive
from qdenv.run.directory import RunDirectory
from qdenv.stats import Sample, margin, wilson_interval
from qdenv.study.elites import CostsDrawer, Grower, make_costs_drawer, make_grower, spread
from qdenv.types import InputError, require_package
from qdenv.view.archive import COLOURS as SCALE
from qdenv.view.guidance import ARROWS, pack_arrows
from qdenv.view.layouts import CHANGED, COLOURS, UNKNOWN
from qdenv.view.page import Page, make_page, pack

# Labels of an archive's columns, and how their values are written.
_LABELS = {
    "similarity": ("similarity before and after repair [0 to 1]", "number"),
    "throughput": ("throughput [tasks per timestep]", "number"),
    "waiting": ("time that robots wait", "share"),
    "path_length": ("moves per task", "number"),
    "length": ("steps of the agent", "number"),
    "shortest": ("shortest path [steps]", "number"),
}
# Shown in another way, or of no interest to those who look at layouts.
_HIDDEN = {"index", "solution", "objective", "measures", "threshold", "status"}
_HIDDEN |= {"repaired", "unrepaired", "congested", "success", "end_timestep"}
_ALIKE = 1e-4  # relative; columns that differ by less are shown once
_LAYOUTS = 256  # elites in a chunk of layouts
_GROWN = 16  # elites in a chunk of growth
_AT_ONCE = 64  # elites grown by one call
_BUDGET = 12_000_000  # bytes of growth after which none is added, unless a number is given
_SHADES = 12  # of the colour scale, with straight lines between
_SCRIPTS = "data tiles sketch place map pointer table cards growth start"


def make_explorer(
    run: RunDirectory, growth: int | None = None, progress: Progress = silent
) -> Page:
    """Make the explorer of a run's archive; its facts are a summary.

    `growth` is the number of elites that the page shows growing, evenly spread over the archive,
    the best among them; unless given as many as take about 12 MB. Raises InputError if there is no
    elite, there are more than two measures, `growth` is negative, or a package is not installed.
    """
    check_range("growth", growth, NonNegativeInt | None)
    if len(run.measures) > 2:
        cure = f"`qdenv export {shlex.quote(str(run))}` writes a table of all"
        shown = f"an explorer shows one or two measures, not {len(run.measures)}"
        raise InputError(f"{run}: {shown}: {cure}")
    archive, config = run.archive, run.config.evaluation
    assert archive.best  # refuses an empty archive
    require_package("explorers", "plotly")
    from plotly.offline import get_plotlyjs

    domain = make_domain(config.domain)
    bits = next(bits for bits in (1, 2, 4, 8) if len(domain.tiles) <= 2**bits)  # of a tile
    grown, chunks = _pack_growth(archive, *make_grower(config, domain), bits, growth, progress)
    progress("writing", -1, "")
    described, numbers = _pack_columns(archive, domain)
    facts, scripts = _facts(run, archive, domain), [f"explorer_{name}" for name in _SCRIPTS.split()]
    draw = make_costs_drawer(config, domain)
    if draw is not None:
        facts["arrows"] = ARROWS
        scripts[-1:-1] = ["arrows", "explorer_arrows"]
    page = make_page(
        "explorer",
        f"{domain.name}: {len(archive):,} layout{'s' * (len(archive) != 1)}",
        scripts,
        facts | described | {"growth": grown, "bits": bits},
        {
            "plotly": get_plotlyjs().encode(),
            "cells": archive.columns["index"].astype("<i4"),
            **numbers,
            **_pack_layouts(archive, domain, bits, draw),
            **chunks,
        },
        archive=archive,
        cells=int(np.prod(archive.shape)),
    )
    summary = {
        "domain": domain.name,
        "elites": len(archive),
        "growth": len(grown["rows"]),
        "growth_differing": len(grown["differing"]),
        "megabytes": len(page.html.encode()) / 1e6,
    }
    return dataclasses.replace(page, facts=summary)


def _facts(run: RunDirectory, archive: SavedArchive, domain: Domain) -> dict[str, Any]:
    """Return facts on the run and its layouts, JSON-ready; rows are those of archive.npz."""
    rows, cols = archive.columns["repaired"].shape[1:]
    tiles = archive.schema.tiles
    # Elites that have names, the run's own first.
    named = {"best": archive.best.cell}
    if run.shipped is not None:
        shipped = run.shipped.collection.generators
        named = {one.name: one.cell for one in (run.shipped.generator, *shipped)}
    row_of = {tuple(cell): row for row, cell in enumerate(archive.cells.tolist())}
    return {
        "run": str(run),
        "command": f"qdenv generate {shlex.quote(str(run))} --elite ",
        "enlarge": f"qdenv explore {shlex.quote(str(run))} --growth {len(archive)}",
        "details": domain.details,
        "tiles": tiles,
        "tile_names": [domain.names.get(tile, tile) for tile in tiles],
        "colours": [COLOURS.get(tile, UNKNOWN) for tile in tiles],
        "mark": CHANGED,
        "scale": [to_hex(colormaps[SCALE](shade)) for shade in np.linspace(0, 1, _SHADES)],
        "rows": rows,
        "cols": cols,
        "chunk": _LAYOUTS,
        "repairs": domain.rules is not None and "unrepaired" in archive.columns,
        "axes": [
            {"name": axis.name, "low": axis.low, "high": axis.high, "cells": axis.cells}
            for axis in archive.schema.measures
        ],
        "elites": len(archive),
        "named": [{"name": k, "row": row_of[cell]} for k, cell in named.items() if cell in row_of],
    }


def _pack_columns(
    archive: SavedArchive, domain: Domain
) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
    """Return the facts and the values of what is known of each elite, its measures first."""
    data, repairs = archive.columns, domain.rules is not None
    # Key, label, form and values of each.
    columns: list[tuple[str, str, str, np.ndarray]] = [
        (f"measure{number}", axis.name, "number", data["measures"][:, number])
        for number, axis in enumerate(archive.schema.measures)
    ]
    columns.append(("objective", archive.schema.objective, "number", data["objective"]))
    success = None  # bool [elites, S]
    if "congested" in data:
        success = ~data["congested"].astype(bool)
        columns.append(("success", "runs without congestion", "share", success.mean(axis=1)))
    elif "success" in data:
        success = data["success"].astype(bool)
        columns.append(("success", "runs that reach the goal", "share", success.mean(axis=1)))
    if repairs and "unrepaired" in data:
        changed = (data["repaired"] != data["unrepaired"]).sum(axis=(1, 2))
        columns.append(("changed", "cells changed by the repair", "whole", changed))
    others = set(data) - _HIDDEN - (set() if repairs else {"similarity"})
    for name in sorted(others, key=[*_LABELS, *sorted(others)].index):
        label, form = _LABELS.get(name, (name.replace("_", " "), "number"))
        means = data[name].astype(np.float64).reshape(len(archive), -1).mean(axis=1)
        shown = any(np.allclose(means, one, _ALIKE) for *_, one in columns)
        if data[name].ndim <= 2 and not shown:
            columns.append((name, label, form, means))
    finite = [_finite(one) for *_, one in columns]
    # The map is first coloured by the first column that is not the same nearly everywhere.
    first = len(archive.schema.measures)
    ends = [np.nanquantile(one, (0.02, 0.98)) for one in finite[first:]]
    colour = next((first + k for k, (low, high) in enumerate(ends) if low < high), first)
    simulations = 0 if success is None else success.shape[1]
    described = [{"key": key, "label": label, "form": form} for key, label, form, _ in columns]
    facts: dict[str, Any] = {"columns": described, "colour": colour, "runs": None}
    # The interval of the rate for each number of runs that went well.
    facts["wilson"] = [
        wilson_interval(good, simulations) for good in range(simulations + 1) if simulations
    ]
    packed = {"values": np.stack(finite)}
    # The first of these columns that has a number for each simulation is shown run by run.
    for name in ("throughput", "length"):
        if name in data and data[name].ndim == 2 and facts["runs"] is None:
            count = data[name].shape[1]
            # Times the standard deviation: half of a 95 % interval of the mean; 0 for one run.
            factor = margin(Sample(0.0, 1 / np.sqrt(count), count)) if count > 1 else 0.0
            facts["runs"] = {"label": _LABELS[name][0], "count": count, "factor": factor}
            packed["runs"] = _finite(data[name])
    return facts, packed


def _finite(values: np.ndarray) -> np.ndarray:
    """Turn numbers into single precision, infinity into NaN."""
    return np.where(np.isfinite(values), values, np.nan).astype("<f4")


def _pack_layouts(
    archive: SavedArchive, domain: Domain, bits: int, draw: CostsDrawer | None
) -> dict[str, str]:
    """Pack all layouts in chunks, where the repair changed them, and the arrows of their costs."""
    repaired = archive.columns["repaired"]
    # Most tiles stay: the difference compresses far better than the tiles themselves.
    change = (archive.columns.get("unrepaired", repaired) - repaired) % len(archive.schema.tiles)
    packed = {}
    for number, start in enumerate(range(0, len(archive), _LAYOUTS)):
        part = slice(start, start + _LAYOUTS)
        tiles = np.stack([repaired[part], change[part]]).astype(np.uint8)
        both = [pack_bits(one.reshape(len(one), -1), bits) for one in tiles]
        packed[f"layouts-{number}"] = pack(np.stack(both))
        if draw is not None:
            costs = draw(archive.columns["solution"][part], repaired[part])
            each = zip(costs, domain.drivable(repaired[part]), strict=True)
            arrows = [pack_arrows(preferences(*one)) for one in each]
            packed[f"arrows-{number}"] = pack(np.stack(arrows))
    return packed


def _pack_growth(
    archive: SavedArchive,
    steps: int,
    grow: Grower,
    bits: int,
    limit: int | None,
    progress: Progress,
) -> tuple[dict[str, Any], dict[str, str]]:
    """Grow elites again, evenly spread over the archive, the best first; return facts and chunks.

    `limit` is the number of elites, or None for as many as take the usual bytes.
    """
    rows: list[int] = []  # of the archive, in the order of the chunks
    # Cells in which an elite that grew here differs from what the run drew, by row; 0 is left out.
    differing: dict[int, int] = {}
    chunks: dict[str, str] = {}
    best = int(np.flatnonzero((archive.cells == archive.best.cell).all(axis=1))[0])
    order, size = spread(archive.cells, best), 0
    drawn = archive.columns.get("unrepaired")
    while steps and (size < _BUDGET if limit is None else len(rows) < limit):
        left = _AT_ONCE if limit is None else min(_AT_ONCE, limit - len(rows))
        batch = list(itertools.islice(order, left))
        if not batch:
            break
        solutions = archive.columns["solution"][batch]
        # Filled up to the size that is compiled: another one would be compiled again.
        frames = grow(np.pad(solutions, ((0, _AT_ONCE - len(batch)), (0, 0))))
        for row, layouts in zip(batch, frames, strict=False):
            differ = 0 if drawn is None else int((layouts[-1] != drawn[row]).sum())
            if differ:
                differing[row] = differ
        for start in range(0, len(batch), _GROWN):
            part = frames[start : min(start + _GROWN, len(batch))].astype(np.uint8)
            chunk = pack(pack_bits(part.reshape(len(part), -1), bits))
            chunks[f"growth-{len(chunks)}"] = chunk
            size += len(chunk)
        rows.extend(batch)
        done = len(rows) / min(len(archive), limit or len(archive))
        progress("growing", max(done, size / _BUDGET if limit is None else 0), "")
    return {"steps": steps, "rows": rows, "chunk": _GROWN, "differing": differing}, chunks


def pack_bits(tiles: np.ndarray, bits: int) -> np.ndarray:
    """Put several tiles into a byte, the first into the lowest bits.

    `tiles` is uint8 [n, cells]; the result uint8 [n, bytes], each row filled up with zeros.
    """
    lowest = np.unpackbits(tiles[:, :, None], axis=2, count=bits, bitorder="little")
    return np.packbits(lowest.reshape(len(tiles), bits * tiles.shape[1]), axis=1, bitorder="little")
