"""Write layouts in the formats of other programs."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import numpy as np
from tyro.conf import Positional, arg

from qdenv.grid import draw
from qdenv.io.facts import write_facts
from qdenv.io.formats import FORMATS, find_writer, write_drawing
from qdenv.io.guidance import weights_of
from qdenv.io.layouts import Drawing, check_size, read_drawing
from qdenv.ops import options as args
from qdenv.ops.output import Result, place, say
from qdenv.ranges import PositiveFloat
from qdenv.study.plans import guide, read_plan
from qdenv.types import InputError, Tile

_READ = "{" + ",".join(name for name, one in FORMATS.items() if one.read) + "}"
_WRITTEN = "{" + ",".join(name for name, one in FORMATS.items() if one.write) + "}"


def convert(
    layout: args.Source,
    target: Annotated[str | Path, Positional, arg(metavar="FILE", constructor=Path)],
    format: Annotated[str | None, arg(metavar=_WRITTEN)] = None,
    input_format: Annotated[str | None, arg(metavar=_READ)] = None,
    domain: args.DomainName = None,
    guidance: args.Guidance = None,
    cell: PositiveFloat | None = None,
) -> Result:
    """Write a layout in another format, and name what that format cannot hold.

    Args:
        layout: layout file.
        target: file to write; its ending chooses the format.
        format: format of the file to write, if its ending has several.
        input_format: format of the layout file, if its ending has several.
        domain: domain of the layout; by default what the file states, or its tiles suggest.
        guidance: costs of moves, a name or a file; by default those in the layout file.
        cell: length of a cell's side in metres; by default what the layout file states, or 1.

    Returns:
        format, and what was left out in reading and in writing.

    Raises:
        InputError: it is not a layout, or the format or the place cannot hold it.

    Examples:
        ``qdenv convert plan.txt hall.lif``
    """
    name = args.name_of(layout)
    if isinstance(layout, str | Path):
        drawing = read_drawing(layout, input_format)  # once: it may be a pipe
        plan = read_plan(layout, domain, drawing)
    else:
        drawing, plan = Drawing([]), args.read_plan(layout, domain)
    chosen = find_writer(Path(target), format)
    files, endings = [Path(target)], FORMATS[chosen].beside.get(Path(target).suffix.lower(), ())
    files += [Path(target).with_suffix(ending) for ending in endings]
    places = (place(file, "", (file.suffix.lower(),), [layout, guidance]) for file in files)
    written, *beside = filter(None, places)
    if (taken := [one.path for one in beside if one.replaces]) and not written.replaces:
        raise InputError(f"{taken[0]}: {written} would replace it: choose another name")
    plan, found = guide(plan, guidance), plan.domain
    check_size(*plan.layout.shape)
    stated = {} if plan.assumed else {"domain": found.name}
    own, side = plan.details, {} if cell is None else {"cell": cell}
    own |= {"facts": own.get("facts", {}) | side} if side else {}
    details = {**drawing.details, **stated, **own, **side}
    if chosen in ("text", "csv"):
        say(*write_facts(written.path, {"domain": found.name, **own}, bool(own)))
        for fact in ("cell", "facts", "keep"):
            details.pop(fact, None)
    weights = None
    if plan.costs is not None:
        weights = weights_of(np.where(found.drivable(plan.layout), plan.costs, np.inf))
    meanings = {symbol: found.meanings.get(symbol, Tile(symbol)) for symbol in found.tiles}
    if tasks := found.simulator.tasks:  # what robots do not drive on is an obstacle
        meanings = {
            symbol: tile._replace(obstacle=symbol not in tasks.traversable)
            for symbol, tile in meanings.items()
        }
    rows = draw(plan.layout, found.tiles)
    drawing = drawing._replace(rows=rows, weights=weights, details=details)
    left_out = write_drawing(written.path, drawing, meanings, format)
    lost = [f"{name}: {what} left out" for what in drawing.lost] + left_out
    say(*lost, f"{written}: {chosen}, {len(rows)} x {len(rows[0])}, {plan.whose}", *beside)
    return Result(file=str(written.path), format=chosen, left_out=lost)
