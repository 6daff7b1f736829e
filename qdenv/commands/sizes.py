"""Commands about other sizes and the baselines: layouts by hand and tiled, series."""

from collections.abc import Collection, Mapping
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
import tyro

from qdenv.commands import output
from qdenv.commands.choices import DomainName, LayoutFile, ManyNumbers, Numbers, RunFolder, names_of
from qdenv.domains.base import DOMAINS, Domain, find_domain, make_domain
from qdenv.io.layouts import check_size, endings_for, write_layout
from qdenv.repair.settings import RepairConfig
from qdenv.run.directory import RunDirectory
from qdenv.study.options import describe_growth
from qdenv.study.plans import USUAL, read_plan
from qdenv.types import InputError

Seed = Annotated[int, tyro.conf.arg(aliases=("--repair-seed",))]


def layout_human(
    rows: int,
    cols: int,
    domain: Annotated[str, tyro.conf.arg(metavar=names_of(DOMAINS))] = USUAL,
    out: Path | None = None,
) -> None:
    """Draw a layout as people design it by hand, at any size.

    Args:
        rows: rows of the layout, frame included.
        cols: columns of the layout, frame included.
        domain: whose layouts.
        out: layout file to write (.json, .txt, .csv), a picture is drawn beside it; layout.json
            unless given.
    """
    check_size(rows, cols)
    from qdenv.study import sizes  # here: takes long to import, and who is refused need not wait

    found = find_domain(domain).resized(rows, cols)
    place = output.place(out, "layout.json", endings_for(found.tiles, found.meanings))
    layout = sizes.human_layout(found)
    leave(place, layout, found, {"domain": found.name, "design": "human"})
    counts = ", ".join(
        f"{(layout == k).sum()} {found.names.get(tile, repr(tile))}"
        for k, tile in enumerate(found.tiles)
    )
    print(f"{place}: {rows} x {cols}, {counts}")
    for name, number in found.numbers.items():
        drawn = found.fitted(layout).numbers[name]
        if found.known.get((rows, cols)) and drawn != number:
            print(
                f"generated layouts of this size have {number} {name} unless stated, this {drawn}"
            )


def layout_tile(
    layout: LayoutFile,
    rows: int,
    cols: int,
    numbers: Numbers,
    domain: DomainName = None,
    seed: Seed = 0,
    polish: Literal["none", "quick", "full"] = "quick",
    out: Path | None = None,
) -> None:
    """Repeat a small layout until it fills a larger one, and repair that (section E.4).

    Args:
        layout: layout file to repeat.
        rows: rows of the larger layout, frame included.
        cols: columns of the larger layout, frame included.
        numbers: exact numbers of tiles; unless given what is known of the size, or else scaled with
            the area.
        domain: whose layouts; what the file says, or its tiles tell, unless given.
        seed: other seeds give other, equally good repairs.
        polish: how hard to repair.
        out: layout file to write (.json, .txt, .csv), a picture is drawn beside it;
            LAYOUT_tiled.json unless given.
    """
    check_size(rows, cols)
    from qdenv.study import sizes  # here: takes long to import, and who is refused need not wait

    plan = read_plan(layout, domain)
    if rows < plan.layout.shape[0] or cols < plan.layout.shape[1]:
        size = "{} x {}".format(*plan.layout.shape)
        raise InputError(f"{rows} x {cols} is smaller than the layout it repeats, {size}")
    found, config = plan.domain, RepairConfig(polish=polish)
    endings = endings_for(found.tiles, found.meanings)
    place = output.place(out, f"{layout.stem}_tiled.json", endings, [layout])
    tiled = sizes.tile(found, plan.layout, (rows, cols), numbers.given(), config, seed)
    say_known(found, (rows, cols), ["steps", *numbers.given()])
    details = sizes.details(tiled) | {"domain": found.name, "tiled_from": layout.name}
    leave(place, tiled.layout, found, details)
    print(f"{place}: " + ", ".join(f"{name} {value}" for name, value in details.items()))


def series(
    run_dir: RunFolder,
    numbers: ManyNumbers,
    elite: str = "best",
    sizes_: Annotated[tuple[str, ...], tyro.conf.arg(name="sizes")] = (),
    steps: tuple[int, ...] = (),
    seed: Annotated[int | None, tyro.conf.arg(aliases=("--repair-seed",))] = None,
    human: bool = False,
    out: Path | None = None,
) -> None:
    """Grow one elite at many sizes: those of Figure 18 unless others are given.

    Args:
        run_dir: the run directory.
        numbers: exact numbers of tiles for each size; unless given what is known of it, or else
            scaled with the area.
        elite: "best", or the archive cell's indices like 12,40.
        sizes_: rows and columns of each layout, like 33x36 57x58; seven sizes from 33x36 to
            101x102 unless given.
        steps: NCA steps for each size; likewise.
        seed: other seeds give other, equally good repairs; the run's own unless given.
        human: also draw what people design at each size.
        out: folder for the layouts, their pictures and series.csv; series unless given.
    """
    run = RunDirectory.open(run_dir)
    domain = make_domain(run.config.evaluation.domain)
    from qdenv.study import sizes  # here: takes long to import, and who is refused need not wait

    shapes = [sizes.parse_size(text) for text in sizes_] or list(sizes.SIZES)
    for shape in shapes:
        check_size(*shape)
    folder = out or output.place(None, "series").path
    if folder.is_file():
        raise InputError(f"{folder}: that is a file: name a folder")
    grown = []
    for item in sizes.grow_sizes(run, elite, shapes, steps, numbers.given(), seed):
        rows, cols = item.layout.shape
        say_known(domain, (rows, cols), [*numbers.given(), *(["steps"] if steps else [])])
        place = place_in(folder, f"nca_{rows}x{cols}.json")
        details = sizes.details(item) | {"domain": domain.name}
        leave(place, item.layout, domain, details)
        print(f"{place}: " + ", ".join(f"{name} {value}" for name, value in details.items()))
        grown.append(item)
        if human:
            layout_human(rows, cols, domain.name, folder / f"human_{rows}x{cols}.json")
    table = place_in(folder, "series.csv")
    sizes.write_series(table.path, grown)
    print(table)


def say_known(domain: Domain, shape: tuple[int, int], given: Collection[str]) -> None:
    """Print which numbers a size has by itself, where it has any."""
    if known := describe_growth(domain, shape, given):
        print(known)


def place_in(folder: Path, name: str) -> output.Place:
    """Choose the place of a result in a folder that the command line named."""
    return output.Place(folder / name, (folder / name).exists())


def leave(
    place: output.Place, layout: np.ndarray, domain: Domain, details: Mapping[str, Any]
) -> None:
    """Write a layout (int8 [H, W]) and a picture beside it, and say where that is."""
    # Only here: matplotlib takes half a second to import, and who is refused need not wait.
    from qdenv.view.layouts import save_layout

    write_layout(place.path, layout, domain.tiles, domain.meanings, **details)
    picture = place.beside(output.PICTURES[0])
    save_layout(picture.path, layout, domain.tiles, domain.names)
    print(picture)
