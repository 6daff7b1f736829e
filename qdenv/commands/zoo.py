"""The command zoo: the generators that ship, and what they are worth."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import tyro

from qdenv.commands import output, words
from qdenv.run.directory import RunDirectory
from qdenv.zoo import (
    PREFIX,
    Collection,
    Driven,
    Generator,
    Grown,
    Origin,
    Shipped,
    named,
    names,
    to_json,
)

PLANNERS = {"high": "high effort", "published": "PBS", "agent": "the agent"}
Name = Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="[DOMAIN[/NAME]]")]


def zoo(
    name: Name = "",
    plot: words.Picture = None,
    json_file: output.JsonFile = None,
) -> None:
    """List the trained generators that ship, with what their floor plans are worth.

    Every command that takes a run takes zoo:DOMAIN/NAME as well.

    Args:
        name: only those of a domain, or all about one, like warehouse-even/best.
        plot: picture of their layouts at the trained size to write; zoo.png unless named.
        json_file: where to write the figures; - for standard output.
    """
    text = name.removeprefix(PREFIX)
    found = [named(one).collection for one in ([text] if text else names())]
    asked = named(text) if "/" in text else None
    picture = words.place_picture(plot, "zoo.png", [])
    if asked:
        print("\n".join(describe(asked)))
    else:
        print("\n\n".join("\n".join(table_of(one)) for one in found))
    if picture is not None:
        draw(picture.path, found, asked)
        print(picture)
    facts = [
        to_json(one.domain, one.origin, [asked.generator] if asked else [*one.generators.values()])
        for one in found
    ]
    output.write_facts(json_file, "zoo", {"domains": facts}, name=text)


def table_of(collection: Collection) -> list[str]:
    """Put the generators of a domain into a table, a line each."""
    generators = list(collection.generators.values())
    columns = [
        f"{size.rows} x {size.cols}, {PLANNERS[row.planner]}"
        for size in generators[0].sizes
        for row in size.driven
    ]
    lines = [["generator", *columns, "what it is"]]
    for one in generators:
        cells = [in_short(row) for size in one.sizes for row in size.driven]
        lines.append([f"{PREFIX}{collection.domain}/{one.name}", *cells, one.about])
    widths = [max(map(len, column)) for column in zip(*lines, strict=True)]
    told = (
        "  ".join(word.ljust(width) for word, width in zip(line, widths, strict=True)).rstrip()
        for line in lines
    )
    return [describe_origin(collection), describe_runs(generators[0]), *told]


def describe_runs(one: Generator) -> str:
    """Say in a line how much was simulated."""
    return "; ".join(
        f"{size.rows} x {size.cols}, {PLANNERS[row.planner]}: {count(row.agents, 'agent')}, "
        f"{row.timesteps} timesteps, {count(row.runs, 'run')}"
        for size in one.sizes
        for row in size.driven
    )


def count(number: int, noun: str) -> str:
    """Say how many of something there are."""
    return f"{number} {noun}{'s' * (number != 1)}"


def describe_origin(collection: Collection) -> str:
    """Say in a line what the generators come from and what their figures are."""
    origin = collection.origin
    return (
        f"{collection.domain}: from {describe_search(origin)}; {origin.counted}, "
        "+- standard error, (share of the runs that succeed)"
    )


def describe_search(origin: Origin) -> str:
    """Say in a clause which runs the generators of a domain come from."""
    further = f", {origin.further:,} more from its elites" if origin.further else ""
    return (
        f"{origin.evaluations:,} evaluations of {origin.run}, {origin.algorithm}, "
        f"seed {origin.seed}{further}, qdenv {origin.qdenv}"
    )


def in_short(row: Driven) -> str:
    """Say what simulations gave, in a table's cell."""
    error = "" if row.error is None else f" +- {row.error:.3f}"
    return f"{row.mean:.3f}{error} ({row.success:.0%})"


def describe(shipped: Shipped) -> list[str]:
    """Say all about one generator, line by line."""
    one, origin = shipped.generator, shipped.collection.origin
    return [
        f"{shipped}: {one.about}",
        f"from         {describe_search(origin)}, begun {origin.created}",
        f"elite        {','.join(map(str, one.cell))}, objective {one.objective:.4g}",
        *(line for size in one.sizes for line in describe_size(size, origin.counted)),
        f"grow it      qdenv generate {shipped} --rows {one.sizes[-1].rows} "
        f"--cols {one.sizes[-1].cols}",
    ]


def describe_size(size: Grown, counted: str) -> list[str]:
    """Say what is known of a generator's layout of one size."""
    numbers = "".join(f", {value} {name}" for name, value in size.numbers.items())
    measures = "".join(f", {name} {value:.4g}" for name, value in size.measures.items())
    repair = "" if size.repair == "none" else f", repair changed {size.changed} cells"
    place = f"{size.rows} x {size.cols}"
    return [f"{place:12} {size.steps} steps of growth{numbers}{repair}{measures}"] + [
        f"             {PLANNERS[row.planner]}, {count(row.agents, 'agent')}, {row.timesteps} "
        f"timesteps, {count(row.runs, 'run')}: {in_short(row)} {counted}"
        for row in size.driven
    ]


def draw(path: Path, collections: Sequence[Collection], only: Shipped | None) -> None:
    """Draw the layouts of generators at their trained size."""
    # Only here: matplotlib takes half a second to import.
    from qdenv.view.layouts import Picture, draw_sheet
    from qdenv.view.style import save_figure

    def picture(collection: Collection, one: Generator) -> Picture:
        run = RunDirectory.open(f"{PREFIX}{collection.domain}/{one.name}")
        best, meaning = run.best, run.schema
        said = "\n".join(
            f"{size.rows} x {size.cols}: {in_short(size.driven[0])}" for size in one.sizes
        )
        title = f"{collection.domain}/{one.name}" if len(collections) > 1 else one.name
        return Picture(best.layout, meaning.tiles, meaning.names, title, said)

    every = [
        picture(collection, one)
        for collection in collections
        for one in collection.generators.values()
        if only is None or one.name == only.name
    ]
    save_figure(draw_sheet(every), path)
