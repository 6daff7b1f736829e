"""The operation zoo: the generators that ship, and how good they are."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import tyro

from qdenv.ops.options import Picture
from qdenv.ops.output import PICTURES, format_table, place, say
from qdenv.ops.results import Facts
from qdenv.run.directory import RunDirectory
from qdenv.zoo import (
    PREFIX,
    Collection,
    Driven,
    Grown,
    Origin,
    Shipped,
    named,
    names,
    to_json,
)

PLANNERS = {"high": "high effort", "published": "PBS", "agent": "the agent"}
Name = Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="[DOMAIN[/NAME]]")]


def zoo(name: Name = "", plot: Picture = None) -> Facts:
    """List the trained generators that ship, with what their floor plans are worth.

    Every command that takes a run takes zoo:DOMAIN/NAME as well.

    Args:
        name: only those of a domain, or all about one, like warehouse-even/best.
        plot: picture of their layouts at the trained size to write; zoo.png unless named.

    Raises:
        InputError: there is no such domain or generator.
    """
    text = name.removeprefix(PREFIX)
    found = [named(one).collection for one in ([text] if text else names())]
    only = named(text) if "/" in text else None
    picture = plot and place(plot, "zoo.png", PICTURES)
    if only:
        say(*_describe(only))
    else:
        for number, one in enumerate(found):
            say(*[""] * (number > 0), *_table_of(one))
    if picture:
        _draw(picture.path, found, only)
        say(picture)
    domains = [
        to_json(one.domain, one.origin, [only.generator] if only else [*one.generators.values()])
        for one in found
    ]
    return Facts({"domains": domains, "settings": {"name": text}})


def _table_of(collection: Collection) -> list[str]:
    """Put the generators of a domain into a table, a line each."""
    generators, origin = list(collection.generators.values()), collection.origin
    cases = [(size, row) for size in generators[0].sizes for row in size.driven]
    columns = [f"{size.rows} x {size.cols}, {PLANNERS[row.planner]}" for size, row in cases]
    lines = [["generator", *columns, "what it is"]]
    for one in generators:
        cells = [_figure(row) for size in one.sizes for row in size.driven]
        lines.append([f"{PREFIX}{collection.domain}/{one.name}", *cells, one.about])
    runs = [f"{column}: {_runs(row)}" for column, (_, row) in zip(columns, cases, strict=True)]
    return [
        f"{collection.domain}: from {_search(origin)}; {origin.counted}, "
        "+- standard error, (share of the runs that succeed)",
        "; ".join(runs),
        *format_table(lines),
    ]


def _runs(row: Driven) -> str:
    return f"{_count(row.agents, 'agent')}, {row.timesteps} timesteps, {_count(row.runs, 'run')}"


def _count(number: int, noun: str) -> str:
    return f"{number} {noun}{'s' * (number != 1)}"


def _search(origin: Origin) -> str:
    """Describe in a clause the runs that the generators of a domain come from."""
    further = f", {origin.further:,} more from its elites" if origin.further else ""
    return (
        f"{origin.evaluations:,} evaluations of {origin.run}, {origin.algorithm}, "
        f"seed {origin.seed}{further}, qdenv {origin.qdenv}"
    )


def _figure(row: Driven) -> str:
    error = "" if row.error is None else f" +- {row.error:.3f}"
    return f"{row.mean:.3f}{error} ({row.success:.0%})"


def _describe(shipped: Shipped) -> list[str]:
    """Describe one generator, line by line."""
    one, origin = shipped.generator, shipped.collection.origin
    return [
        f"{shipped}: {one.about}",
        f"from         {_search(origin)}, begun {origin.created}",
        f"elite        {','.join(map(str, one.cell))}, objective {one.objective:.4g}",
        *(line for size in one.sizes for line in _describe_size(size, origin.counted)),
        f"grow it      qdenv generate {shipped} --rows {one.sizes[-1].rows} "
        f"--cols {one.sizes[-1].cols}",
    ]


def _describe_size(size: Grown, counted: str) -> list[str]:
    """Describe a generator's layout of one size."""
    numbers = "".join(f", {value} {name}" for name, value in size.numbers.items())
    measures = "".join(f", {name} {value:.4g}" for name, value in size.measures.items())
    repair = "" if size.repair == "none" else f", repair changed {size.changed} cells"
    shape = f"{size.rows} x {size.cols}"
    return [f"{shape:12} {size.steps} steps of growth{numbers}{repair}{measures}"] + [
        f"             {PLANNERS[row.planner]}, {_runs(row)}: {_figure(row)} {counted}"
        for row in size.driven
    ]


def _draw(path: Path, collections: Sequence[Collection], only: Shipped | None) -> None:
    """Draw the layouts of generators at their trained size."""
    from qdenv.view.layouts import Picture as Panel  # imports matplotlib
    from qdenv.view.layouts import draw_sheet
    from qdenv.view.style import save_figure

    panels = []
    for collection in collections:
        for one in collection.generators.values():
            if only and one.name != only.name:
                continue
            title = f"{collection.domain}/{one.name}"
            run = RunDirectory.open(f"{PREFIX}{title}")
            best, schema = run.best, run.schema
            text = "\n".join(
                f"{size.rows} x {size.cols}: {_figure(size.driven[0])}" for size in one.sizes
            )
            title = title if len(collections) > 1 else one.name
            panels.append(Panel(best.layout, schema.tiles, schema.names, title, text))
    save_figure(draw_sheet(panels), path)
