"""Commands about traffic: simulate, sweep."""

import json
from pathlib import Path
from typing import Annotated, Literal

import tyro

from qdenv.domains import find_domain
from qdenv.files import write_atomically
from qdenv.formats.layouts import read_layout
from qdenv.plots.traffic import save_sweep
from qdenv.simulate.mapf.fleet import FleetConfig
from qdenv.simulate.mapf.negotiated.settings import EFFORTS
from qdenv.study import sweep as sweeping
from qdenv.study.traffic import parse_seeds, simulate_layout
from qdenv.types import InputError


def simulate(
    layout: tyro.conf.Positional[Path],
    domain: str = "warehouse-even",
    agents: int = 200,
    timesteps: int = 1000,
    seeds: tuple[int, ...] = (3,),
    effort: Literal["low", "high"] = "low",
    audit: bool = True,
    json_file: Annotated[Path | None, tyro.conf.arg(name="json")] = None,
) -> None:
    """Simulate a fleet on a layout and report its throughput.

    Args:
        layout: layout file.
        domain: whose tasks the agents do.
        agents: number of agents.
        timesteps: how long to simulate.
        seeds: how many seeds, or a list of them.
        effort: low for a quick look, high for numbers to report.
        audit: check every trajectory against the rules of movement.
        json_file: where to write the numbers.
    """
    tiles = read_layout(layout, find_domain(domain).tiles)
    try:
        result = simulate_layout(tiles, domain, agents, timesteps, seeds, effort, audit)
    except InputError as error:
        raise InputError(f"{layout}: {error}") from error
    result = {"layout": str(layout), **result}
    if json_file:
        write_atomically(json_file, (json.dumps(result, indent=1) + "\n").encode())
    for run in result["runs"]:
        state = f"congested at {run['end_timestep']}" if run["congested"] else "never congested"
        print(f"seed {run['seed']}: throughput {run['throughput']:.3f}, {state}")
    print(
        f"mean throughput {result['mean_throughput']:.3f}, success rate "
        f"{result['success_rate']:.0%}, {result['cpu_seconds_per_run']:.2f} CPU s per run, "
        f"compiled in {result['compile_seconds']:.1f} s"
        + (", every trajectory valid" if result["valid"] else "")
    )
    print("\n".join(result["broken"]), end="\n" if result["broken"] else "")


def sweep(
    layout: tyro.conf.Positional[Path],
    agents: str = "50:400:50",
    domain: str = "warehouse-even",
    timesteps: int = 1000,
    seeds: tuple[int, ...] = (10,),
    effort: Literal["low", "high"] = "high",
    out: Path | None = None,
) -> None:
    """Simulate a layout with more and more agents: throughput and success rate.

    Args:
        layout: layout file.
        agents: numbers of agents, as 50:400:50 or 50,100,200.
        domain: whose tasks the agents do.
        timesteps: how long to simulate.
        seeds: how many seeds, or a list of them.
        effort: low for a quick look, high for numbers to report.
        out: CSV file to write, with a picture beside it; named after the layout unless given.
    """
    kind = find_domain(domain)
    tiles = read_layout(layout, kind.tiles)
    config = FleetConfig(timesteps=timesteps, planner=EFFORTS[effort])
    print("agents  throughput  standard error  success rate (95 % interval)")

    def show(row: sweeping.SweepRow) -> None:
        print(
            f"{row.agents:6}  {row.throughput:10.3f}  {row.standard_error:14.3f}  "
            f"{row.success_rate:12.0%} ({row.success_low:.0%} to {row.success_high:.0%})",
            flush=True,
        )

    counts = sweeping.parse_counts(agents)
    rows = sweeping.sweep(tiles, kind.tasks, config, counts, parse_seeds(seeds), show)
    table = out or Path(f"{layout.stem}_sweep.csv")
    sweeping.write_table(table, rows)
    save_sweep(table.with_suffix(".png"), rows, layout.stem)
    print(f"{table}, {table.with_suffix('.png')}")
