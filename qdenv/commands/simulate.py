"""The command simulate: one layout, one number of agents."""

from pathlib import Path
from typing import Annotated

import tyro

from qdenv.commands.choices import FleetOptions, Options
from qdenv.files import write_json
from qdenv.study import sweep as studies
from qdenv.study.plans import read_plan


def simulate(
    layout: tyro.conf.Positional[Path],
    agents: int = 200,
    options: Options = FleetOptions(),  # noqa: B008 (frozen)
    audit: bool = True,
    json_file: Annotated[Path | None, tyro.conf.arg(name="json")] = None,
) -> None:
    """Simulate a fleet on a layout and report its throughput.

    Args:
        layout: layout file.
        agents: number of agents.
        options: who drives.
        audit: check every trajectory against the rules of movement.
        json_file: where to write the numbers.
    """
    plan = read_plan(layout, options.domain)
    from qdenv.study.traffic import simulate_layout  # imports the simulator

    with studies.about(str(layout)):
        result = simulate_layout(
            plan.layout,
            plan.domain.name,
            agents,
            options.timesteps,
            options.seeds,
            options.effort,
            audit,
            options.planner,
        )
    result = {"layout": str(layout), **result}
    if json_file:
        write_json(json_file, result)
    for run in result["runs"]:
        state = f"congested at {run['end_timestep']}" if run["congested"] else "never congested"
        print(f"seed {run['seed']}: throughput {run['throughput']:.3f}, {state}")
    # No mean of smooth runs where every run congested: the mean of all is another number.
    smooth = result["mean_throughput"]
    print(
        (
            f"every run congested, mean of all {result['mean_of_all']:.3f}"
            if smooth is None
            else f"mean throughput {smooth:.3f}"
        )
        + f", success rate {result['success_rate']:.0%}, "
        + f"{result['cpu_seconds_per_run']:.2f} CPU s per run, "
        + f"compiled in {result['compile_seconds']:.1f} s"
        + (", every trajectory valid" if result["valid"] else "")
    )
    print("\n".join(result["broken"]), end="\n" if result["broken"] else "")
