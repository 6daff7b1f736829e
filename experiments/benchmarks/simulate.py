"""Benchmark of the fleet simulator, beside recorded runs of the published C++ (RHCR: PBS + SIPP).

Each record of a reference (layout, domain, agents, T) is simulated with our seeds. Seeds are not
paired: the two programs draw starts and goals differently. The reference's CPU seconds include its
preprocessing; ours leave out compilation, which is reported apart. One thread, so that CPU seconds
are those of one core. Without a reference the hand-made layouts are simulated, and generated ones
of a fixed key, with nothing beside them.
"""

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Annotated, Any, Literal, NamedTuple

import jax
import numpy as np
import tyro

from experiments.benchmarks.layouts import grow_random, rules_at_size
from qdenv.domains.base import find_domain
from qdenv.io.files import write_json
from qdenv.io.layouts import read_layout
from qdenv.io.records import read_json
from qdenv.repair.recipe import repair_layout
from qdenv.repair.settings import RepairConfig
from qdenv.simulate.mapf.fleet import FleetConfig
from qdenv.study.engine import Simulated, auditor, run_seeds
from qdenv.study.ledger import DRIVERS
from qdenv.types import InputError, TaskRule

DOMAINS = {
    "warehouse_even": "warehouse-even",
    "warehouse_uneven": "warehouse-uneven",
    "manufacture": "manufacturing",
}
AGENTS = 200


class Recorded(NamedTuple):
    """A recorded run of another program, by the names of its file."""

    layout: str
    domain: Literal["warehouse_even", "warehouse_uneven", "manufacture"]
    n_agents: int
    T: int
    throughput: float
    congested: bool
    cpu_s: float


class _Reference(NamedTuple):
    """A file of recorded runs."""

    records: list[Recorded]


class Case(NamedTuple):
    """One layout and fleet to simulate."""

    layout: str  # name of the layout's file, or what it would be called
    kind: str  # name of the domain
    tiles: np.ndarray  # int8 [H, W]
    agents: int  # how many drive
    timesteps: int  # horizon T
    # recorded runs of another program on the same layout; may be none
    records: Sequence[Recorded] = ()


def run(
    reference: Path | None = None,
    layouts: Path | None = None,
    planners: tuple[Literal["low", "high", "published", "plain"], ...] = ("low", "high"),
    seeds: int = 3,
    longest: int = 1000,
    match: str = "",
    audit: bool = False,
    json_file: Annotated[Path | None, tyro.conf.arg(name="json")] = None,
) -> dict[str, Any]:
    """Simulate what the reference simulated and print both side by side.

    Args:
        reference: recorded runs of the C++; our own layouts alone unless given.
        layouts: folder of the recorded runs' layout files; beside the reference unless given.
        planners: the negotiated one at low or high effort, or priority-based search by the
            published or the plain rule.
        seeds: runs of each case.
        longest: leave out cases with a longer horizon T.
        match: only layouts whose file name contains this.
        audit: check every trajectory.
        json_file: where to write the result.

    Raises:
        InputError: the reference or one of its layouts cannot be read.
    """
    if reference is None:
        print("no --reference given: our own layouts, nothing to compare with")
        cases = own_cases(longest)
    else:
        cases = recorded_cases(reference, layouts or reference.parent / "layouts", longest)
    rows = []
    print(
        f"{'layout':32s} agents     T  planner    throughput (s.e.)  C++    ratio   CPU s  C++ CPU"
    )
    for case in (case for case in cases if match in case.layout):
        for planner in planners:
            rows.append(measure(case, planner, seeds, audit))
            print(line(rows[-1]), flush=True)
    result = {"device": jax.devices()[0].device_kind, "seeds": seeds, "rows": rows}
    if json_file:
        write_json(json_file, result)
    return result


def own_cases(timesteps: int) -> Iterator[Case]:
    """List the hand-made layout of size S of each domain, and one generated from a fixed key."""
    for kind in DOMAINS.values():
        domain = find_domain(kind)
        if domain.human is not None:
            yield Case(f"{kind}_human", kind, np.asarray(domain.human()), AGENTS, timesteps)
        (drawn,) = grow_random(kind, 1)
        repaired = repair_layout(drawn, rules_at_size(kind), 0, RepairConfig("quick"))
        yield Case(f"{kind}_random", kind, np.asarray(repaired.layout), AGENTS, timesteps)


def recorded_cases(reference: Path, layouts: Path, longest: int) -> Iterator[Case]:
    """List what the recorded runs simulated; say which cases are too long.

    Raises:
        InputError: the records or one of the layouts cannot be read.
    """
    records = read_json(reference, _Reference).records
    for (layout, domain, agents, timesteps), runs in group(records).items():
        if timesteps > longest:
            print(f"{layout}: left out, T {timesteps} is above --longest {longest}")
            continue
        kind = DOMAINS[domain]
        tiles = read_layout(layouts / layout, find_domain(kind).tiles)
        yield Case(layout, kind, tiles, agents, timesteps, runs)


def measure(case: Case, planner: str, seeds: int, audit: bool) -> dict[str, Any]:
    """Simulate a case with one planner: a row of the table.

    Raises:
        InputError: no fleet drives in this domain, or not on this layout.
    """
    config = FleetConfig(agents=case.agents, timesteps=case.timesteps, planner=DRIVERS[planner])
    tasks = tasks_of(case.kind)
    read = auditor(case.tiles, tasks, config) if audit else None
    done = run_seeds(case.tiles, tasks, config, range(seeds), read=read, threads=1)
    return compare(done, case.records) | {
        "layout": case.layout,
        "domain": case.kind,
        "agents": case.agents,
        "timesteps": case.timesteps,
        "planner": planner,
        "broken": [rule for found in done.readings for rule in found] if read else None,
    }


def tasks_of(kind: str) -> TaskRule:
    """Find what the fleet of a domain does.

    Raises:
        InputError: no fleet drives there.
    """
    tasks = find_domain(kind).simulator.tasks
    if tasks is None:
        raise InputError(f"no fleet drives in {kind}: choose another domain")
    return tasks


def group(records: Sequence[Recorded]) -> dict[tuple, list[Recorded]]:
    """Collect the recorded runs of each case (layout, domain, agents, T)."""
    cases: dict[tuple, list[Recorded]] = {}
    for record in records:
        case = (record.layout, record.domain, record.n_agents, record.T)
        cases.setdefault(case, []).append(record)
    return cases


def compare(done: Simulated, records: Sequence[Recorded]) -> dict[str, Any]:
    """Put our runs and the recorded ones of one case into one row; None where none is recorded."""
    ours = np.array([float(run.throughput) for run in done.runs])
    seconds = done.cpu_seconds / len(ours)
    error = float(ours.std(ddof=1) / np.sqrt(len(ours))) if len(ours) > 1 else None
    theirs = float(np.mean([record.throughput for record in records])) if records else None
    their_seconds = float(np.mean([record.cpu_s for record in records])) if records else None
    return {
        "throughputs": ours.tolist(),
        "throughput": float(ours.mean()),
        "standard_error": error,
        "congested": int(sum(bool(run.congested) for run in done.runs)),
        "cpu_seconds": seconds,
        "compile_seconds": done.compile_seconds,
        "reference_throughput": theirs,
        "reference_congested": int(sum(record.congested for record in records)),
        "reference_runs": len(records),
        "reference_cpu_seconds": their_seconds,
        "throughput_ratio": None if theirs is None else float(ours.mean() / theirs),
        "cpu_ratio": None if their_seconds is None else their_seconds / seconds,
    }


def line(row: dict[str, Any]) -> str:
    """Write a row of the table; "!" counts congested runs."""
    error = "" if row["standard_error"] is None else f"({row['standard_error']:.3f})"
    ours = (
        f"{row['layout'].removesuffix('.json'):32s} {row['agents']:6d} {row['timesteps']:5d}  "
        f"{row['planner']:10s} {row['throughput']:7.3f} {error:8s}{'!' * row['congested']:3s}"
    )
    if not row["reference_runs"]:
        return f"{ours}{'':13s}{row['cpu_seconds']:7.2f}"
    return (
        f"{ours}{row['reference_throughput']:6.3f}"
        f"{'!' * row['reference_congested']:3s}{row['throughput_ratio']:6.3f} "
        f"{row['cpu_seconds']:7.2f} {row['reference_cpu_seconds']:9.1f}  ({row['cpu_ratio']:.0f}x)"
    )
