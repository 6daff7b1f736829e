"""What the explorer says of each elite in numbers: columns in people's words."""

from __future__ import annotations

import itertools
import shlex
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from matplotlib import colormaps
from matplotlib.colors import to_hex

from qdenv.domains.base import Domain, make_domain
from qdenv.progress import Progress, silent
from qdenv.ranges import NonNegativeInt, check_range
from qdenv.run.archive import SavedArchive
from qdenv.run.directory import RunDirectory
from qdenv.stats import Sample, margin, wilson_interval
from qdenv.study.elites import Grower, make_grower, spread
from qdenv.types import InputError
from qdenv.view.archive import COLOURS as SCALE
from qdenv.view.layouts import CHANGED, COLOURS, UNKNOWN
from qdenv.view.page import Page, make_page, missing, pack

NUMBER, SHARE, WHOLE = "number", "share", "whole"
# Columns of an archive: what they are called, and how they are written.
_WORDS = {
    "similarity": ("similarity before and after repair [0 to 1]", NUMBER),
    "throughput": ("throughput [tasks per timestep]", NUMBER),
    "waiting": ("time that robots wait", SHARE),
    "path_length": ("moves per task", NUMBER),
    "length": ("steps of the agent", NUMBER),
    "shortest": ("shortest path [steps]", NUMBER),
}
# Told in another way, or of no interest to whoever looks at layouts.
_UNTOLD = {"index", "solution", "objective", "measures", "threshold", "status"}
_UNTOLD |= {"repaired", "unrepaired", "congested", "success", "end_timestep"}
_RUNS = ("throughput", "length")  # the first there is is shown run by run
_ALIKE = 1e-4  # relative; columns that differ by less are told once


class _Column(NamedTuple):
    """A number of each elite."""

    key: str  # a name for scripts
    label: str  # in words, with the unit
    form: str  # how it is written: a number, a share in per cent, or a whole number
    values: np.ndarray  # float32 [elites]; NaN where there is none


class _Runs(NamedTuple):
    """What was counted in each simulation of each elite."""

    label: str  # in words, with the unit
    values: np.ndarray  # float32 [elites, S]
    # times the standard deviation: half of a 95 % interval of the mean; 0 for one run
    factor: float


def _columns_of(archive: SavedArchive, domain: Domain) -> list[_Column]:
    """List what is known of each elite: its measures first, then what the map can show."""
    data, repairs = archive.columns, domain.rules is not None
    found = [
        _Column(f"measure{number}", axis.name, NUMBER, data["measures"][:, number])
        for number, axis in enumerate(archive.schema.measures)
    ]
    found.append(_Column("objective", archive.schema.objective, NUMBER, data["objective"]))
    if (success := _success_of(data)) is not None:
        label = "runs without congestion" if "congested" in data else "runs that reach the goal"
        found.append(_Column("success", label, SHARE, success.mean(axis=1)))
    if repairs and "unrepaired" in data:
        changed = (data["repaired"] != data["unrepaired"]).sum(axis=(1, 2))
        found.append(_Column("changed", "cells changed by the repair", WHOLE, changed))
    others = set(data) - _UNTOLD - (set() if repairs else {"similarity"})
    for name in sorted(others, key=[*_WORDS, *sorted(others)].index):
        label, form = _WORDS.get(name, (name.replace("_", " "), NUMBER))
        values = data[name].astype(np.float64).reshape(len(archive), -1).mean(axis=1)
        if data[name].ndim <= 2 and not any(
            np.allclose(values, one.values, _ALIKE) for one in found
        ):
            found.append(_Column(name, label, form, values))
    return [one._replace(values=_finite(one.values)) for one in found]


def _finite(values: np.ndarray) -> np.ndarray:
    """Turn numbers into single precision, and what is none into NaN."""
    return np.where(np.isfinite(values), values, np.nan).astype("<f4")


def _success_of(columns: Mapping[str, np.ndarray]) -> np.ndarray | None:
    """Tell which simulations went well, bool [elites, S]; None if not counted."""
    if "congested" in columns:
        return ~columns["congested"].astype(bool)
    return columns["success"].astype(bool) if "success" in columns else None


def _runs_of(columns: Mapping[str, np.ndarray]) -> _Runs | None:
    """Find what is shown simulation by simulation; None where nothing was counted so."""
    name = next((name for name in _RUNS if name in columns and columns[name].ndim == 2), None)
    if name is None:
        return None
    count = columns[name].shape[1]
    factor = margin(Sample(0.0, 1 / np.sqrt(count), count)) if count > 1 else 0.0
    return _Runs(_WORDS[name][0], _finite(columns[name]), factor)


def _colour_first(columns: list[_Column]) -> int:
    """Choose what colours the map at first: the first that is not the same nearly everywhere."""
    shown = [number for number, one in enumerate(columns) if not one.key.startswith("measure")]
    ends = {number: np.nanquantile(columns[number].values, (0.02, 0.98)) for number in shown}
    return next((number for number, (low, high) in ends.items() if low < high), shown[0])


def _facts_of_columns(
    archive: SavedArchive, columns: list[_Column], runs: _Runs | None
) -> dict[str, Any]:
    """Say what the packed numbers are, JSON-ready."""
    success = _success_of(archive.columns)
    simulations = 0 if success is None else success.shape[1]
    return {
        "columns": [{"key": one.key, "label": one.label, "form": one.form} for one in columns],
        "colour": _colour_first(columns),
        "runs": None
        if runs is None
        else {"label": runs.label, "count": runs.values.shape[1], "factor": runs.factor},
        # An interval of the rate for each number of runs that went well.
        "wilson": [wilson_interval(good, simulations) for good in range(simulations + 1)]
        if simulations
        else [],
    }


_LAYOUTS = 256  # elites in a chunk of layouts
_GROWN = 16  # elites in a chunk of growth
_AT_ONCE = 64  # elites grown by one call
_ROOM = 12_000_000  # bytes that growth may take in a file unless more is asked for


class _Growth(NamedTuple):
    """How elites grow."""

    steps: int  # of growth; 0 where nothing grows
    rows: list[int]  # of the archive's elites whose growth is here, in the order of the chunks
    # cells in which an elite that grew here differs from what the run drew, by row; those of no
    # difference are left out
    differing: dict[int, int]
    packed: dict[str, str]  # chunks by name


def _bits_of(tiles: str) -> int:
    """Say how many bits hold a tile of an alphabet: 1, 2, 4 or 8."""
    return next(bits for bits in (1, 2, 4, 8) if len(tiles) <= 2**bits)


def pack_bits(tiles: np.ndarray, bits: int) -> np.ndarray:
    """Put several tiles into a byte, the first into the lowest bits.

    Args:
        tiles: uint8 [n, cells].
        bits: of a tile.

    Returns:
        uint8 [n, bytes]; the last byte of a row is filled up with zeros.
    """
    each = 8 // bits
    padded = np.pad(tiles, ((0, 0), (0, -tiles.shape[1] % each)))
    parts = (padded[:, part::each] << (bits * part) for part in range(each))
    return sum(parts, np.zeros((len(tiles), padded.shape[1] // each), np.uint8))


def _pack_layouts(archive: SavedArchive, bits: int) -> dict[str, str]:
    """Pack all layouts, and in which tiles they differ from what was drawn before the repair."""
    kinds, cells = len(archive.schema.tiles), archive.columns["repaired"][0].size
    repaired = archive.columns["repaired"].reshape(-1, cells)
    drawn = archive.columns.get("unrepaired", archive.columns["repaired"]).reshape(-1, cells)
    change = (drawn - repaired) % kinds
    packed = {}
    for number, start in enumerate(range(0, len(archive), _LAYOUTS)):
        part = slice(start, start + _LAYOUTS)
        both = [pack_bits(one[part].astype(np.uint8), bits) for one in (repaired, change)]
        packed[f"layouts-{number}"] = pack(np.stack(both))
    return packed


def _grow_elites(
    archive: SavedArchive, steps: int, grow: Grower, wanted: int | None, progress: Progress
) -> _Growth:
    """Grow elites again, evenly spread over the archive, the best first.

    Args:
        archive: of a run.
        steps: of growth.
        grow: their generator, as `make_grower` makes it.
        wanted: how many; None for as many as the usual room holds.
        progress: called with the progress.
    """
    growth = _Growth(steps, [], {}, {})
    if not steps or wanted == 0:
        return growth
    best = int(np.flatnonzero((archive.cells == archive.best.cell).all(axis=1))[0])
    rows, size = spread(archive.cells, best), 0
    while size < _ROOM or wanted is not None:
        left = _AT_ONCE if wanted is None else min(_AT_ONCE, wanted - len(growth.rows))
        batch = list(itertools.islice(rows, left))
        if not batch:
            break
        size += _add(growth, archive, batch, grow(_filled(archive.columns["solution"][batch])))
        done = len(growth.rows) / min(len(archive), wanted or len(archive))
        progress("growing", max(done, size / _ROOM if wanted is None else 0), "")
    return growth


def _filled(solutions: np.ndarray) -> np.ndarray:
    """Fill a batch up to the size that is compiled."""
    return np.pad(solutions, ((0, _AT_ONCE - len(solutions)), (0, 0)))


def _add(growth: _Growth, archive: SavedArchive, batch: list[int], frames: np.ndarray) -> int:
    """Add a batch and say how many bytes it takes."""
    bits, size = _bits_of(archive.schema.tiles), 0
    for row, layouts in zip(batch, frames, strict=False):
        drawn = archive.columns.get("unrepaired")
        differing = 0 if drawn is None else int((layouts[-1] != drawn[row]).sum())
        if differing:
            growth.differing[row] = differing
    for start in range(0, len(batch), _GROWN):
        part = frames[start : min(start + _GROWN, len(batch))].astype(np.uint8)
        name = f"growth-{len(growth.packed)}"
        growth.packed[name] = pack(pack_bits(part.reshape(len(part), -1), bits))
        size += len(growth.packed[name])
    growth.rows.extend(batch)
    return size


_SHADES = 12  # of the colour scale, with straight lines between
_SCRIPTS = (
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


def _read_archive(run: RunDirectory, growth: int | None = None) -> SavedArchive:
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
        progress: called with the progress.

    Returns:
        the page, and its facts in brief.

    Raises:
        InputError: as in `_read_archive`, or a package is not installed.
    """
    archive, config = _read_archive(run, growth), run.config.evaluation
    try:
        from plotly.offline import get_plotlyjs
    except ImportError as error:
        raise missing("explorers", "plotly") from error
    domain = make_domain(config.domain)
    grown = _grow_elites(archive, *make_grower(config, domain), growth, progress)
    progress("writing", -1, "")
    columns, runs = _columns_of(archive, domain), _runs_of(archive.columns)
    packed: dict[str, np.ndarray | bytes | str] = {
        "plotly": get_plotlyjs().encode(),
        "cells": archive.columns["index"].astype("<i4"),
        "values": np.stack([one.values for one in columns]),
    }
    if runs is not None:
        packed["runs"] = runs.values
    packed |= _pack_layouts(archive, _bits_of(domain.tiles)) | grown.packed
    facts = _facts(run, archive, domain, grown) | _facts_of_columns(archive, columns, runs)
    title = f"{domain.name}: {len(archive):,} layout{'s' * (len(archive) != 1)}"
    scripts = [f"explorer_{name}" for name in _SCRIPTS]
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


def _head(run: RunDirectory, archive: SavedArchive) -> str:
    """Say in a line what the archive is worth."""
    cells = int(np.prod(archive.shape))
    return (
        f"{run}: {len(archive):,} of {cells:,} cells filled ({archive.coverage:.1%}), "
        f"best {archive.schema.objective} {archive.best.objective:.4g}, "
        f"QD-score {archive.qd_score:,.1f}"
    )


def _facts(
    run: RunDirectory, archive: SavedArchive, domain: Domain, grown: _Growth
) -> dict[str, Any]:
    """Say what the page shows, JSON-ready; rows are those of archive.npz."""
    rows, cols = archive.columns["repaired"].shape[1:]
    tiles = archive.schema.tiles
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
        "bits": _bits_of(tiles),
        "chunk": _LAYOUTS,
        "repairs": domain.rules is not None and "unrepaired" in archive.columns,
        "axes": [
            {"name": axis.name, "low": axis.low, "high": axis.high, "cells": axis.cells}
            for axis in archive.schema.measures
        ],
        "elites": len(archive),
        "named": _named(run, archive),
        "growth": {
            "steps": grown.steps,
            "rows": grown.rows,
            "chunk": _GROWN,
            "differing": grown.differing,
        },
    }


def _named(run: RunDirectory, archive: SavedArchive) -> list[dict[str, Any]]:
    """List the elites that have names, the best or what was asked for first."""
    cells = {"best": archive.best.cell}
    if run.shipped is not None:
        own, every = run.shipped.generator, run.shipped.collection.generators
        cells = {one.name: one.cell for one in (own, *every)}
    found = {tuple(cell): row for row, cell in enumerate(archive.cells.tolist())}
    return [{"name": name, "row": found[cell]} for name, cell in cells.items() if cell in found]
