"""Commands about traffic: simulate."""

import json
from pathlib import Path
from typing import Annotated, Literal

import tyro

from qdenv.domains import find_domain
from qdenv.files import write_atomically
from qdenv.formats.layouts import read_layout
from qdenv.run.traffic import simulate_layout
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
