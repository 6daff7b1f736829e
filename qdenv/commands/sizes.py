"""Commands about other sizes and the baselines: layouts by hand and tiled, series."""

from pathlib import Path
from typing import Annotated, Literal

import tyro

from qdenv.commands.choices import ManyNumbers, Numbers
from qdenv.domains.base import find_domain, make_domain
from qdenv.formats.layouts import read_layout, write_layout
from qdenv.plots.layouts import save_layout
from qdenv.repair.settings import RepairConfig
from qdenv.study import sizes
from qdenv.study.plans import USUAL
from qdenv.training.records import RunDirectory

FIGURE_18 = tuple(f"{rows}x{cols}" for rows, cols in sizes.SIZES)


def layout_human(
    rows: int,
    cols: int,
    domain: str = USUAL,
    out: Path = Path("layout.json"),
) -> None:
    """Draw a layout as people design it by hand, at any size.

    Args:
        rows: rows of the layout, frame included.
        cols: columns of the layout, frame included.
        domain: whose layouts.
        out: layout file to write; a picture is drawn beside it.
    """
    found = find_domain(domain).resized(rows, cols)
    layout = sizes.human_layout(found)
    write_layout(out, layout, found.tiles, domain=found.name, design="human")
    save_layout(out.with_suffix(".png"), layout, found.tiles)
    counts = ", ".join(f"{(layout == k).sum()} {tile!r}" for k, tile in enumerate(found.tiles))
    print(f"{out}: {rows} x {cols}, {counts}")


def layout_tile(
    layout: tyro.conf.Positional[Path],
    rows: int,
    cols: int,
    numbers: Numbers,
    domain: str = USUAL,
    repair_seed: int = 0,
    polish: Literal["none", "quick", "full"] = "quick",
    out: Path = Path("layout.json"),
) -> None:
    """Repeat a small layout until it fills a larger one, and repair that (section E.4).

    Args:
        layout: layout file to repeat.
        rows: rows of the larger layout, frame included.
        cols: columns of the larger layout, frame included.
        numbers: exact numbers of tiles; scaled with the area unless given.
        domain: whose layouts.
        repair_seed: other seeds give other, equally good repairs.
        polish: how hard to repair.
        out: layout file to write; a picture is drawn beside it.
    """
    found = find_domain(domain)
    small = read_layout(layout, found.tiles)
    config = RepairConfig(polish=polish)
    tiled = sizes.tile(found, small, (rows, cols), numbers.given(), config, repair_seed)
    details = sizes.details(tiled) | {"domain": found.name, "tiled_from": layout.name}
    write_layout(out, tiled.layout, found.tiles, **details)
    save_layout(out.with_suffix(".png"), tiled.layout, found.tiles)
    print(f"{out}: " + ", ".join(f"{name} {value}" for name, value in details.items()))


def series(
    run_dir: tyro.conf.Positional[Path],
    numbers: ManyNumbers,
    elite: str = "best",
    sizes_: Annotated[tuple[str, ...], tyro.conf.arg(name="sizes")] = FIGURE_18,
    steps: tuple[int, ...] = (),
    repair_seed: int | None = None,
    human: bool = False,
    out: Path = Path("series"),
) -> None:
    """Grow one elite at many sizes: those of Figure 18 unless others are given.

    Args:
        run_dir: the run directory.
        numbers: exact numbers of tiles for each size; scaled with the area unless given.
        elite: "best", or the archive cell's indices like 12,40.
        sizes_: rows and columns of each layout, like 33x36 57x58.
        steps: NCA steps for each size; scaled with the size unless given.
        repair_seed: other seeds give other, equally good repairs; the run's own unless given.
        human: also draw what people design at each size.
        out: folder for the layouts, their pictures and series.csv.
    """
    run = RunDirectory.open(run_dir)
    domain = make_domain(run.config.evaluation.domain)
    shapes = [sizes.parse_size(text) for text in sizes_]
    grown = []
    for item in sizes.grow_sizes(run, elite, shapes, steps, numbers.given(), repair_seed):
        rows, cols = item.layout.shape
        path = out / f"nca_{rows}x{cols}.json"
        details = sizes.details(item) | {"domain": domain.name}
        write_layout(path, item.layout, domain.tiles, **details)
        save_layout(path.with_suffix(".png"), item.layout, domain.tiles)
        print(f"{path}: " + ", ".join(f"{name} {value}" for name, value in details.items()))
        grown.append(item)
        if human:
            path = out / f"human_{rows}x{cols}.json"
            layout_human(rows, cols, domain.name, path)
    sizes.write_series(out / "series.csv", grown)
