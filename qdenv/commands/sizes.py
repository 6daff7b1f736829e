"""Commands about other sizes and the baselines: layouts by hand and tiled, series, compare."""

from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
import tyro

from qdenv.domains import find_domain
from qdenv.domains.base import Domain
from qdenv.formats.layouts import read_layout, write_layout
from qdenv.plots.layouts import save_layout
from qdenv.plots.sizes import save_comparison, save_peaks
from qdenv.repair.recipe import RepairConfig
from qdenv.simulate.mapf.fleet import FleetConfig
from qdenv.simulate.mapf.negotiated.settings import EFFORTS
from qdenv.study import compare as comparing
from qdenv.study import sizes
from qdenv.study.sweep import parse_counts
from qdenv.study.traffic import parse_seeds
from qdenv.train.records import RunDirectory
from qdenv.types import InputError


def layout_human(
    rows: int,
    cols: int,
    domain: str = "warehouse-even",
    out: Path = Path("layout.json"),
) -> None:
    """Draw a layout as people design it by hand, at any size.

    Args:
        rows: rows of the layout, frame included.
        cols: columns of the layout, frame included.
        domain: whose layouts.
        out: layout file to write; a picture is drawn beside it.
    """
    found = find_domain(domain)
    layout = sizes.human_layout(found, rows, cols)
    write_layout(out, layout, found.tiles, domain=found.name, design="human")
    save_layout(out.with_suffix(".png"), layout, found.tiles)
    numbers = ", ".join(f"{(layout == k).sum()} {tile!r}" for k, tile in enumerate(found.tiles))
    print(f"{out}: {rows} x {cols}, {numbers}")


def layout_tile(
    layout: tyro.conf.Positional[Path],
    rows: int,
    cols: int,
    domain: str = "warehouse-even",
    shelves: int | None = None,
    repair_seed: int = 0,
    polish: Literal["none", "quick", "full"] = "quick",
    out: Path = Path("layout.json"),
) -> None:
    """Repeat a small layout until it fills a larger one, and repair that (section E.4).

    Args:
        layout: layout file to repeat.
        rows: rows of the larger layout, frame included.
        cols: columns of the larger layout, frame included.
        domain: whose layouts.
        shelves: number of shelves; scaled with the area unless given.
        repair_seed: other seeds give other, equally good repairs.
        polish: how hard to repair.
        out: layout file to write; a picture is drawn beside it.
    """
    found = find_domain(domain)
    small = read_layout(layout, found.tiles)
    config = RepairConfig(polish=polish)
    tiled = sizes.tile(found, small, (rows, cols), shelves, config, repair_seed)
    details = sizes.details(tiled) | {"domain": found.name, "tiled_from": layout.name}
    write_layout(out, tiled.layout, found.tiles, **details)
    save_layout(out.with_suffix(".png"), tiled.layout, found.tiles)
    print(f"{out}: " + ", ".join(f"{name} {value}" for name, value in details.items()))


def series(
    run_dir: tyro.conf.Positional[Path],
    elite: str = "best",
    sizes_: Annotated[tuple[str, ...], tyro.conf.arg(name="sizes")] = tuple(
        f"{rows}x{cols}" for rows, cols in sizes.SIZES
    ),
    steps: tuple[int, ...] = (),
    shelves: tuple[int, ...] = (),
    repair_seed: int | None = None,
    human: bool = False,
    out: Path = Path("series"),
) -> None:
    """Grow one elite at many sizes: those of Figure 18 unless others are given.

    Args:
        run_dir: the run directory.
        elite: "best", or the archive cell's indices like 12,40.
        sizes_: rows and columns of each layout, like 33x36 57x58.
        steps: NCA steps for each size; scaled with the size unless given.
        shelves: number of shelves for each size; scaled with the area unless given.
        repair_seed: other seeds give other, equally good repairs; the run's own unless given.
        human: also draw what people design at each size.
        out: folder for the layouts, their pictures and series.csv.
    """
    run = RunDirectory.open(run_dir)
    domain = find_domain(run.config.evaluation.domain)
    shapes = [sizes.parse_size(text) for text in sizes_]
    grown = []
    for item in sizes.grow_sizes(run, elite, shapes, steps, shelves, repair_seed):
        path = out / f"nca_{item.rows}x{item.cols}.json"
        details = sizes.details(item) | {"domain": domain.name}
        write_layout(path, item.layout, domain.tiles, **details)
        save_layout(path.with_suffix(".png"), item.layout, domain.tiles)
        print(f"{path}: " + ", ".join(f"{name} {value}" for name, value in details.items()))
        grown.append(item)
        if human:
            path = out / f"human_{item.rows}x{item.cols}.json"
            layout_human(item.rows, item.cols, domain.name, path)
    sizes.write_series(out / "series.csv", grown)


def compare(
    layouts: tyro.conf.Positional[tuple[Path, ...]],
    agents: str = "200",
    domain: str = "warehouse-even",
    timesteps: int = 1000,
    seeds: tuple[int, ...] = (10,),
    effort: Literal["low", "high"] = "high",
    out: Path = Path("compare.csv"),
) -> None:
    """Put layouts side by side: success rate, and throughput over the runs that never congested.

    Args:
        layouts: layout files.
        agents: numbers of agents, as 200 or 50,100 or 50:400:50.
        domain: whose tasks the agents do.
        timesteps: how long to simulate.
        seeds: how many seeds, or a list of them.
        effort: low for a quick look, high for numbers to report.
        out: CSV file to write, with a picture beside it.
    """
    kind, tiles = read_layouts(layouts, domain)
    config = FleetConfig(timesteps=timesteps, planner=EFFORTS[effort])
    show = table_printer(tiles)
    counts = parse_counts(agents)
    rows = comparing.compare(tiles, kind.tasks, config, counts, parse_seeds(seeds), show)
    comparing.write_comparison(out, rows)
    save_comparison(out.with_suffix(".png"), rows)
    print(f"{out}, {out.with_suffix('.png')}")


def scalability(
    layouts: tyro.conf.Positional[tuple[Path, ...]],
    agents: str = "50:1000:50",
    domain: str = "warehouse-even",
    timesteps: int = 1000,
    seeds: tuple[int, ...] = (5,),
    effort: Literal["low", "high"] = "high",
    out: Path = Path("scalability.csv"),
) -> None:
    """Add agents until the mean throughput drops; report the peak and where it is.

    Args:
        layouts: layout files, of one size or of several.
        agents: numbers of agents to try in turn; those that do not fit are left out.
        domain: whose tasks the agents do.
        timesteps: how long to simulate.
        seeds: how many seeds, or a list of them.
        effort: low for a quick look, high for numbers to report.
        out: CSV file to write, with a picture beside it.
    """
    kind, tiles = read_layouts(layouts, domain)
    config = FleetConfig(timesteps=timesteps, planner=EFFORTS[effort])
    show = table_printer(tiles)
    counts, numbers = parse_counts(agents), parse_seeds(seeds)
    ways = [
        comparing.climb(name, layout, kind.tasks, config, counts, numbers, show)
        for name, layout in tiles.items()
    ]
    peaks = [comparing.find_peak(way) for way in ways]
    for peak in peaks:
        end = "" if peak.dropped else ", still rising at the last number of agents"
        print(f"{peak.layout}: peak {peak.throughput:.3f} at {peak.agents} agents{end}")
    rows = [row for way in ways for row in way]
    comparing.write_comparison(out, rows)
    save_peaks(out.with_suffix(".png"), rows, peaks)
    print(f"{out}, {out.with_suffix('.png')}")


def read_layouts(paths: Sequence[Path], domain: str) -> tuple[Domain, dict[str, np.ndarray]]:
    """Read layouts of one domain, by name.

    Raises:
        InputError: none is given, or one cannot be read.
    """
    if not paths:
        raise InputError("give at least one layout file")
    kind = find_domain(domain)
    named = comparing.name_layouts(paths)
    return kind, {name: read_layout(path, kind.tiles) for name, path in named.items()}


def table_printer(names: Iterable[str]) -> Callable[[comparing.Compared], None]:
    """Print a table's head now and each row as it comes; columns fit the names."""
    width = max(6, *(len(name) for name in names))
    print(f"{'layout':{width}}   size    agents  throughput (s.e.)  success (95 %)    mean of all")

    def show(row: comparing.Compared) -> None:
        found = row.traffic
        size, spread = f"{row.rows}x{row.cols}", f"({found.standard_error:.3f})"
        bounds = f"({found.success_low:.0%} to {found.success_high:.0%})"
        print(
            f"{row.layout:{width}}  {size:8} {found.agents:6}  {found.throughput:8.3f} {spread:8} "
            f" {found.success_rate:4.0%} {bounds:14} {found.mean_of_all:9.3f}",
            flush=True,
        )

    return show
