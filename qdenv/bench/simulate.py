"""Benchmark of the fleet simulator beside recorded runs of the published C++ (RHCR: PBS + SIPP).

Each record of the reference (layout, domain, agents, T) is simulated with our seeds. Seeds are not
paired: the two programs draw starts and goals differently. The reference's CPU seconds include its
preprocessing; ours leave out compilation, which is reported apart. One thread, so that CPU seconds
are those of one core.
"""

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any, Literal

import jax
import numpy as np
import tyro

from qdenv.domains import find_domain
from qdenv.files import write_atomically
from qdenv.formats.layouts import read_layout
from qdenv.simulate.mapf.fleet import FleetConfig
from qdenv.simulate.mapf.negotiated.settings import EFFORTS
from qdenv.study.traffic import Simulated, broken_rules, run_seeds
from qdenv.types import InputError

DOMAINS = {
    "warehouse_even": "warehouse-even",
    "warehouse_uneven": "warehouse-uneven",
    "manufacture": "manufacturing",
}


def run(
    reference: Path = Path("../shared/reference/rhcr_baseline.json"),
    layouts: Path = Path("../shared/reference/layouts"),
    efforts: tuple[Literal["low", "high"], ...] = ("low", "high"),
    seeds: int = 3,
    longest: int = 1000,
    match: str = "",
    audit: bool = False,
    json_file: Annotated[Path | None, tyro.conf.arg(name="json")] = None,
) -> dict[str, Any]:
    """Simulate what the reference simulated and print both side by side.

    Args:
        reference: recorded runs of the C++.
        layouts: folder of their layout files.
        efforts: planner efforts to measure.
        seeds: runs of each case.
        longest: leave out cases with a longer horizon T.
        match: only layouts whose file name contains this.
        audit: check every trajectory.
        json_file: where to write the result.

    Raises:
        InputError: the reference is not there.
    """
    if not reference.exists():
        raise InputError(f"{reference}: no recorded runs there, name the file with --reference")
    cases = group(json.loads(reference.read_text())["records"], longest, match)
    rows = []
    print(
        f"{'layout':32s} agents     T  effort  throughput (s.e.)  C++    ratio   CPU s   C++ CPU s"
    )
    for (layout, domain, agents, timesteps), records in cases.items():
        for effort in efforts:
            config = FleetConfig(agents=agents, timesteps=timesteps, planner=EFFORTS[effort])
            kind = find_domain(DOMAINS[domain])
            tiles = read_layout(layouts / layout, kind.tiles)
            done = run_seeds(tiles, kind.tasks, config, range(seeds), record=audit, threads=1)
            wrong = broken_rules(tiles, kind.tasks, config, done) if audit else None
            row = compare(done, records) | {
                "layout": layout,
                "domain": kind.name,
                "agents": agents,
                "timesteps": timesteps,
                "effort": effort,
                "broken": wrong,
            }
            rows.append(row)
            print(line(row), flush=True)
    result = {"device": jax.devices()[0].device_kind, "seeds": seeds, "rows": rows}
    if json_file:
        write_atomically(json_file, (json.dumps(result, indent=1) + "\n").encode())
    return result


def group(
    records: Sequence[dict[str, Any]], longest: int, match: str
) -> dict[tuple, list[dict[str, Any]]]:
    """Collect the recorded runs of each case (layout, domain, agents, T)."""
    cases: dict[tuple, list[dict[str, Any]]] = {}
    for record in records:
        case = (record["layout"], record["domain"], record["n_agents"], record["T"])
        if record["T"] <= longest and match in record["layout"]:
            cases.setdefault(case, []).append(record)
    return cases


def compare(done: Simulated, records: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """Put our runs and the recorded ones of one case into one row."""
    ours = np.array([float(run.throughput) for run in done.runs])
    theirs = np.array([record["throughput"] for record in records])
    seconds = done.cpu_seconds / len(ours)
    their_seconds = float(np.mean([record["cpu_s"] for record in records]))
    error = float(ours.std(ddof=1) / np.sqrt(len(ours))) if len(ours) > 1 else None
    return {
        "throughputs": ours.tolist(),
        "throughput": float(ours.mean()),
        "standard_error": error,
        "congested": int(sum(bool(run.congested) for run in done.runs)),
        "cpu_seconds": seconds,
        "compile_seconds": done.compile_seconds,
        "reference_throughput": float(theirs.mean()),
        "reference_congested": int(sum(record["congested"] for record in records)),
        "reference_runs": len(theirs),
        "reference_cpu_seconds": their_seconds,
        "throughput_ratio": float(ours.mean() / theirs.mean()),
        "cpu_ratio": their_seconds / seconds,
    }


def line(row: dict[str, Any]) -> str:
    """Write a row of the table; "!" counts congested runs."""
    error = "" if row["standard_error"] is None else f"({row['standard_error']:.3f})"
    return (
        f"{row['layout'].removesuffix('.json'):32s} {row['agents']:6d} {row['timesteps']:5d}  "
        f"{row['effort']:6s} {row['throughput']:7.3f} {error:8s}"
        f"{'!' * row['congested']:3s}{row['reference_throughput']:6.3f}"
        f"{'!' * row['reference_congested']:3s}{row['throughput_ratio']:6.3f} "
        f"{row['cpu_seconds']:7.2f} {row['reference_cpu_seconds']:9.1f}  ({row['cpu_ratio']:.0f}x)"
    )
