"""Commands about the traffic of many runs: sweep, compare, scalability."""

from collections.abc import Callable, Iterable, Sequence
from pathlib import Path

import numpy as np
import tyro

from qdenv.commands.choices import FleetOptions, Options
from qdenv.domains.base import Domain
from qdenv.plots.studies import save_comparison, save_peaks
from qdenv.simulate.mapf.settings import FleetConfig
from qdenv.study import sweep as studies
from qdenv.study.options import parse_counts, parse_seeds
from qdenv.study.plans import read_plan
from qdenv.study.table import Row, find_peak, write_rows
from qdenv.types import InputError

Files = tyro.conf.Positional[tuple[Path, ...]]


def sweep(
    layout: tyro.conf.Positional[Path],
    agents: str = "50:400:50",
    options: Options = FleetOptions(),  # noqa: B008 (frozen)
    out: Path | None = None,
) -> None:
    """Simulate a layout with more and more agents: throughput and success rate.

    Args:
        layout: layout file.
        agents: numbers of agents, as 50:400:50 or 50,100,200.
        options: who drives.
        out: CSV file to write, with a picture beside it; named after the layout unless given.
    """
    plan = read_plan(layout, options.domain)
    trial = trial_of(agents, options, plan.domain)
    print("agents  throughput  standard error  success rate (95 % interval)")

    def show(row: Row) -> None:
        print(
            f"{row.agents:6}  {row.throughput:10.3f}  {row.standard_error:14.3f}  "
            f"{row.success_rate:12.0%} ({row.success_low:.0%} to {row.success_high:.0%})",
            flush=True,
        )

    rows = studies.sweep(layout.stem, plan.layout, trial, show)
    table = out or Path(f"{layout.stem}_sweep.csv")
    write_rows(table, rows)
    save_comparison(table.with_suffix(".png"), rows)
    print(f"{table}, {table.with_suffix('.png')}")


def compare(
    layouts: Files,
    agents: str = "200",
    options: Options = FleetOptions(),  # noqa: B008 (frozen)
    out: Path = Path("compare.csv"),
) -> None:
    """Put layouts side by side: success rate, and throughput over the runs that never congested.

    Args:
        layouts: layout files.
        agents: numbers of agents, as 200 or 50,100 or 50:400:50.
        options: who drives.
        out: CSV file to write, with a picture beside it.
    """
    tiles, domain = read_layouts(layouts, options.domain)
    trial, show = trial_of(agents, options, domain), table_printer(tiles)
    rows = studies.compare(tiles, trial, show)
    write_rows(out, rows)
    save_comparison(out.with_suffix(".png"), rows)
    print(f"{out}, {out.with_suffix('.png')}")


def scalability(
    layouts: Files,
    agents: str = "50:1000:50",
    options: Options = FleetOptions(),  # noqa: B008 (frozen)
    out: Path = Path("scalability.csv"),
) -> None:
    """Add agents until the mean throughput drops; report the peak and where it is.

    Args:
        layouts: layout files, of one size or of several.
        agents: numbers of agents to try in turn; those that do not fit are left out.
        options: who drives.
        out: CSV file to write, with a picture beside it.
    """
    tiles, domain = read_layouts(layouts, options.domain)
    trial, show = trial_of(agents, options, domain), table_printer(tiles)
    climbs = [studies.climb(name, layout, trial, show) for name, layout in tiles.items()]
    peaks = [find_peak(rows) for rows in climbs]
    for peak in peaks:
        end = "" if peak.dropped else ", still rising at the last number of agents"
        print(f"{peak.layout}: peak {peak.throughput:.3f} at {peak.agents} agents{end}")
    rows = [row for climb in climbs for row in climb]
    write_rows(out, rows)
    save_peaks(out.with_suffix(".png"), rows, peaks)
    print(f"{out}, {out.with_suffix('.png')}")


def trial_of(agents: str, options: FleetOptions, domain: Domain) -> studies.Trial:
    """Read what a command puts its layouts to.

    Raises:
        InputError: a number or a name means nothing.
    """
    config = FleetConfig(timesteps=options.timesteps, planner=options.planner_settings)
    counts, seeds = parse_counts(agents), parse_seeds(options.seeds)
    return studies.Trial(domain.simulator.tasks, config, counts, seeds)


def read_layouts(paths: Sequence[Path], domain: str | None) -> tuple[dict[str, np.ndarray], Domain]:
    """Read layouts of one domain, by name.

    Raises:
        InputError: none is given, one cannot be read, or they are of several domains.
    """
    if not paths:
        raise InputError("give at least one layout file")
    plans = {name: read_plan(path, domain) for name, path in studies.name_layouts(paths).items()}
    kinds = {plan.domain.name: plan for plan in plans.values()}
    if len(kinds) > 1:
        raise InputError(f"these are layouts of {' and '.join(kinds)}: put one domain side by side")
    return {name: plan.layout for name, plan in plans.items()}, next(iter(kinds.values())).domain


def table_printer(names: Iterable[str]) -> Callable[[Row], None]:
    """Print a table's head now and each row as it comes; columns fit the names."""
    width = max(6, *(len(name) for name in names))
    print(f"{'layout':{width}}   size    agents  throughput (s.e.)  success (95 %)    mean of all")

    def show(row: Row) -> None:
        size, error = f"{row.rows}x{row.cols}", f"({row.standard_error:.3f})"
        bounds = f"({row.success_low:.0%} to {row.success_high:.0%})"
        print(
            f"{row.layout:{width}}  {size:8} {row.agents:6}  {row.throughput:8.3f} {error:8} "
            f" {row.success_rate:4.0%} {bounds:14} {row.mean_of_all:9.3f}",
            flush=True,
        )

    return show
