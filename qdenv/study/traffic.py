"""Studies of one layout's traffic: simulate it over seeds, see where it jams, judge it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any, NamedTuple, Unpack

import numpy as np

from qdenv import devices
from qdenv.domains.base import find_domain
from qdenv.grid import of_tiles
from qdenv.progress import Progress, silent
from qdenv.simulate.mapf.metrics import Recording
from qdenv.simulate.mapf.settings import MOST_STEPS, FleetConfig, describe_planner
from qdenv.study.capacity import PROBES, Point, Verdict, judge, more_than, point_of
from qdenv.study.congestion import Maps, average, cells_with_half, map_run, worst_cells
from qdenv.study.engine import Simulated, auditor, run_seeds
from qdenv.study.options import Driving, fleet_tasks, make_fleet, parse_seeds, usual_fleet
from qdenv.study.table import Row, summarise
from qdenv.types import InputError, TaskRule, Traffic

_MOST_RECORDED = 50_000_000  # agent-steps recorded at a time: 650 MB, and copies of them


class Wanted(NamedTuple):
    """What a study looks into beyond throughput."""

    audit: bool = True  # check every trajectory against the rules
    maps: bool = True  # count where agents wait and work
    verdict: bool = True  # simulate other numbers of agents, too, and judge this one


class _Reading(NamedTuple):
    """What is read off the recording of one run."""

    maps: Maps  # where agents waited and worked
    broken: list[str]  # what was done against the rules; empty without an audit


class Study(NamedTuple):
    """What is known of a fleet on a layout."""

    row: Row  # its numbers in brief
    done: Simulated  # its runs
    maps: Maps | None  # averaged over the runs; None where they were not wanted
    verdict: Verdict | None  # None where it was not wanted
    broken: list[str] | None  # what was done against the rules; None where nobody looked


def examine(
    layout: np.ndarray,
    tasks: TaskRule | None,
    config: FleetConfig,
    seeds: Sequence[int],
    wanted: Wanted = Wanted(),  # noqa: B008 (frozen)
    progress: Progress = silent,
    tell: Callable[[Study], None] = lambda study: None,
) -> Study:
    """Simulate a fleet on a layout over seeds, see where it jams, and judge the number of agents.

    Args:
        layout: int8 [H, W].
        tasks: what the agents do; None where no fleet drives, which is refused.
        config: numbers of the simulation.
        seeds: of the runs; the first few of them for other numbers of agents.
        wanted: what is looked into.
        progress: called with the progress.
        tell: told the study without its verdict, before the runs that this takes.

    Raises:
        InputError: the fleet cannot work on this layout, or is too large to be recorded.
    """
    tasks = fleet_tasks(layout, tasks, config.agents)
    recorded = wanted.audit or wanted.maps
    if recorded and config.agents * config.timesteps > _MOST_RECORDED:
        without = "add --no-audit" if wanted.audit else "leave the picture out"
        raise InputError(
            f"{config.agents} agents over {config.timesteps} timesteps are too much to record: "
            f"simulate at most {_MOST_RECORDED // config.agents} timesteps, or {without}"
        )
    agents, most = config.agents, int(of_tiles(layout, tasks.traversable, tasks.tiles).sum())
    if wanted.verdict:  # the program has room for as many as are tried
        most = min(most, MOST_STEPS // config.timesteps)
        config = replace(config, agents=max(agents, min(most, more_than(agents))))
    read = _reader(layout, tasks, config, wanted) if recorded else None
    # No more recordings at a time than fit the memory.
    at_once = _MOST_RECORDED // (agents * config.timesteps)
    threads = min(devices.threads(), at_once) if recorded else None
    done = run_seeds(layout, tasks, config, seeds, agents, read, threads, progress)
    # The same program: another one for runs that are not recorded would have to be compiled.
    probing = (lambda *run: None) if recorded else None

    def probe(number: int) -> Point:
        def tell(doing: str, share: float, note: str) -> None:
            progress(f"trying {number} agents", share, note)

        few = run_seeds(layout, tasks, config, seeds[:PROBES], number, probing, threads, tell)
        return point_of(number, few.runs)

    study = Study(
        row=summarise("", layout, agents, done.runs, done.cpu_seconds, config.stop_when_congested),
        done=done,
        maps=average([reading.maps for reading in done.readings]) if wanted.maps else None,
        verdict=None,
        broken=[rule for one in done.readings for rule in one.broken] if wanted.audit else None,
    )
    tell(study)
    if not wanted.verdict:
        return study
    return study._replace(verdict=judge(point_of(agents, done.runs), probe, most))


def _reader(
    layout: np.ndarray, tasks: TaskRule, config: FleetConfig, wanted: Wanted
) -> Callable[[int, Traffic, Recording], _Reading]:
    find_broken = auditor(layout, tasks, config)

    def read(seed: int, run: Traffic, recording: Recording) -> _Reading:
        broken = find_broken(seed, run, recording) if wanted.audit else []
        return _Reading(map_run(layout.shape, run, recording), broken)

    return read


def simulate_layout(
    layout: np.ndarray,
    domain: str = "warehouse-even",
    agents: int | None = None,
    timesteps: int | None = None,
    seeds: int | str | Sequence[int | str] = 10,
    check: bool = False,
    **driving: Unpack[Driving],
) -> dict[str, Any]:
    """Simulate a layout over seeds and report it in JSON-ready values.

    Args:
        layout: int8 [H, W].
        domain: name of the domain.
        agents: number of agents; as `usual_fleet` chooses unless given.
        timesteps: horizon T; as `usual_fleet` chooses unless given.
        seeds: how many, or a list; see `parse_seeds`.
        check: audit every trajectory, and see where agents wait; without it "valid" is None.
        **driving: effort, planner, stop, see `options.Driving`.

    Returns:
        what `facts_of` reports, and domain, planner, agents, timesteps, stop.

    Raises:
        InputError: a name is unknown, or the fleet cannot work on this layout.
    """
    found = find_domain(domain)
    agents, timesteps, _ = usual_fleet(found, [layout], agents, timesteps)
    tasks = fleet_tasks(layout, found.simulator.tasks, agents)
    config = make_fleet(agents, timesteps, **driving)
    study = examine(layout, tasks, config, parse_seeds(seeds), Wanted(check, check, False))
    about = {"domain": domain, "planner": describe_planner(config.planner), "agents": agents}
    about |= {"timesteps": timesteps, "stop": config.stop_when_congested}
    return about | facts_of(study, layout)


def facts_of(study: Study, layout: np.ndarray) -> dict[str, Any]:
    """Report a study in JSON-ready values.

    Returns:
        runs (seed, throughput, congested, congested_at, end_timestep, finished_tasks),
        mean_throughput (see `Row.throughput`; None where it is none), mean_of_all (over all runs),
        standard_error (of the latter), success_rate, steps_per_task, cpu_seconds_per_run,
        compile_seconds, valid, broken; where it was looked into also waiting_share (of the
        agents' time), worst_cells, cells_with_half_of_waiting, verdict, verdict_reason,
        evidence (the numbers of agents that were tried).
    """
    row, done, maps, verdict, broken = study
    facts: dict[str, Any] = {
        "runs": [_describe(seed, run) for seed, run in zip(done.seeds, done.runs, strict=True)],
        "mean_throughput": None if np.isnan(row.throughput) else row.throughput,
        "mean_of_all": row.mean_of_all,
        "standard_error": row.error_of_all,
        "success_rate": row.success_rate,
        "steps_per_task": steps_per_task(done.runs),
        "cpu_seconds_per_run": round(row.cpu_seconds_per_run, 4),
        "compile_seconds": round(done.compile_seconds, 3),
        "valid": None if broken is None else not broken,
        "broken": broken or [],
    }
    if maps is not None:
        facts |= {
            "waiting_share": maps.waiting_share,
            "worst_cells": [spot._asdict() for spot in worst_cells(layout, maps)],
            "cells_with_half_of_waiting": cells_with_half(maps),
        }
    if verdict is not None:
        points = [point._asdict() for point in verdict.points]
        facts |= {"verdict": verdict.word, "verdict_reason": verdict.reason, "evidence": points}
    return facts


def steps_per_task(runs: Sequence[Traffic]) -> float | None:
    """Average the moves that a finished task takes over all runs; None where none is finished."""
    tasks = np.array([run.finished.sum() for run in runs])
    moves = tasks * [float(run.path_length) for run in runs]
    return float(moves.sum() / tasks.sum()) if tasks.any() else None


def _describe(seed: int, run: Traffic) -> dict[str, Any]:
    """Reduce one run to its JSON-ready numbers."""
    return {
        "seed": int(seed),
        "throughput": float(run.throughput),
        "congested": bool(run.congested),
        "congested_at": int(run.congested_at) if run.congested else None,
        "end_timestep": int(run.end_timestep),
        "finished_tasks": int(run.finished.sum()),
    }
