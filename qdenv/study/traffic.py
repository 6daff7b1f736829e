"""The study of one layout's traffic: simulate it, see where it jams, judge its number of agents.

A fleet's throughput rises with its agents up to a peak, and falls beyond it. On crowded layouts it
falls all of a sudden, when a jam forms that no agent gets out of: the hand-made warehouse of
33 x 36 moves 6.04 tasks per timestep with 200 agents and 5.20 with 250. That no run was
*congested*, i.e. that never more than half of the agents stood still at once, says little then.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace
from math import ceil, floor
from typing import Any, NamedTuple, TypeAlias

import numpy as np

from qdenv import devices
from qdenv.progress import Progress, silent
from qdenv.simulation.mapf.audit import audit as list_violations
from qdenv.simulation.mapf.metrics import Recording
from qdenv.simulation.mapf.settings import MOST_STEPS, FleetConfig
from qdenv.stats import sample_of
from qdenv.study.engine import Simulated, run_seeds
from qdenv.study.options import fleet_tasks
from qdenv.study.plans import Plan
from qdenv.study.recordings import FADING, Maps, cells_with_half, fading, map_run, worst_cells
from qdenv.study.table import WORTH, Row, summarise, value_of_an_agent
from qdenv.types import InputError, Traffic

_FLOWS, _NEAR, _PAST, _CONGESTED = "flows", "near capacity", "past its peak", "congested"

_MOST_RECORDED = 50_000_000  # agent-steps recorded at a time: 650 MB, and copies of them
_JAMMED = 0.5  # least share of congested runs of a layout that is congested
_PROBES = 2  # runs with another number of agents
_FEWER, _FAR_FEWER, _MORE = 0.75, (0.5, 0.25), 1.25  # times the agents, to probe
_IDLE = 0.05  # share of time without an order from which on there are agents enough
_GAIN = 0.02  # more throughput than this with fewer agents: past the peak


class Point(NamedTuple):
    """The throughput at one number of agents."""

    agents: int  # how many agents
    throughput: float  # tasks per timestep, the mean over all runs
    standard_error: float  # of it; NaN for one run
    runs: int  # how many
    congested: int  # how many of them congested
    fading: float  # see `recordings.fading`


# How a layout bears a fleet: "flows", "near capacity", "past its peak" or "congested"; what shows
# it, in one line; the evidence, this number of agents first, then those that were probed.
Verdict: TypeAlias = tuple[str, str, list[Point]]


class Study(NamedTuple):
    """The results of a fleet on a layout; None where something was not looked into."""

    row: Row  # its numbers in brief
    done: Simulated  # its runs
    maps: Maps | None  # averaged over the runs
    verdict: Verdict | None
    broken: list[str] | None  # violations of the rules of movement, with their seeds


def examine(
    plan: Plan,
    config: FleetConfig,
    seeds: Sequence[int],
    audit: bool = True,
    maps: bool = True,
    verdict: bool = True,
    progress: Progress = silent,
    on_runs: Callable[[Study], None] = lambda study: None,
) -> Study:
    """Simulate a fleet on a layout over seeds, see where it jams, and judge the number of agents.

    `audit` checks every trajectory against the rules, `maps` counts where agents wait and work,
    `verdict` simulates other numbers of agents, too, each with the first few seeds. `on_runs` is
    called with the study before the runs that its verdict takes. Raises InputError if the fleet
    cannot work on this layout, or is too large to be recorded.
    """
    layout, agents = plan.layout, config.agents
    tasks = fleet_tasks(layout, plan.domain.simulator.tasks, agents)
    recorded, at_once = audit or maps, _MOST_RECORDED // (agents * config.timesteps)
    if recorded and not at_once:
        long = f"{agents} agents over {config.timesteps} timesteps are too much to record"
        cure = f"simulate at most {_MOST_RECORDED // agents} timesteps"
        raise InputError(f"{long}: {cure}; `simulate --no-audit` without a picture records nothing")
    # No more recordings at a time than fit into memory.
    threads = min(devices.threads(), at_once) if recorded else None
    most = int(plan.domain.drivable(layout).sum())
    if verdict:  # the program has room for as many agents as are tried
        most = min(most, MOST_STEPS // config.timesteps)
        config = replace(config, agents=max(agents, min(most, ceil(_MORE * agents))))

    def read(seed: int, run: Traffic, recording: Recording) -> tuple[Maps, list[str]]:
        violations = list_violations(layout, tasks, recording, run, config.horizon) if audit else []
        broken = [f"seed {seed}: {one}" for one in violations]
        return map_run(layout.shape, run, recording), broken

    reader = read if recorded else None
    done = run_seeds(plan.floor, tasks, config, seeds, agents, reader, threads, progress)
    # A reader that does nothing: without one, another program would have to be compiled.
    no_reader = (lambda *run: None) if recorded else None

    def probe(number: int) -> Point:
        def report(doing: str, share: float, note: str) -> None:
            progress(f"trying {number} agents", share, note)

        few = seeds[:_PROBES]
        runs = run_seeds(plan.floor, tasks, config, few, number, no_reader, threads, report).runs
        return point_of(number, runs)

    every = zip(*(one for one, _ in done.readings), strict=True)
    study = Study(
        row=summarise("", layout, agents, done.runs, done.cpu_seconds, config.stop_when_congested),
        done=done,
        maps=Maps(*(np.mean(part, axis=0) for part in every)) if maps else None,
        verdict=None,
        broken=[rule for _, broken in done.readings for rule in broken] if audit else None,
    )
    on_runs(study)
    if not verdict:
        return study
    idle = idle_share(done.runs) or 0.0
    return study._replace(verdict=judge(point_of(agents, done.runs), probe, most, idle))


def idle_share(runs: Sequence[Traffic]) -> float | None:
    """Average the share of time in which agents have no order; None where work never runs out."""
    shares = [float(run.idle) for run in runs if run.idle is not None]
    return float(np.mean(shares)) if shares else None


def point_of(agents: int, runs: Sequence[Traffic]) -> Point:
    """Condense runs with one number of agents."""
    # In double precision, other than in `table.Row`: the numbers of saved reports stay the same.
    sample = sample_of(np.array([run.throughput for run in runs], float))
    congested = sum(bool(run.congested) for run in runs)
    return Point(agents, sample.mean, sample.error, len(runs), congested, fading(runs))


def judge(here: Point, probe: Callable[[int], Point], most: int, idle: float = 0.0) -> Verdict:
    """Judge whether a layout takes this many agents, and whether it would take more.

    In this order, so that runs are only spent where the verdict hangs on them:

    * *congested*: in at least half of the runs, more than half of the agents stood still at once.
    * *past its peak*: throughput fades by more than 5 % while time goes on (a jam builds up), or a
      run congested, or three quarters, half or a quarter of the agents move 2 % more.
    * *near capacity*: the last quarter of the agents, or a quarter more of them, brings per agent
      less than half of what an average robot does.
    * *flows*: none of these.

    `here` is of the number of agents in question, `probe` simulates another number, of which at
    most `most` fit the layout. Agents without an order for a notable share of their time (`idle`)
    keep up with the orders: no other number would move more.
    """
    points = [here]

    def at(agents: int) -> Point:
        points.append(probe(agents))
        return points[-1]

    def gain(other: Point) -> float:
        if not here.throughput:
            return float(other.throughput > 0)
        return other.throughput / here.throughput - 1

    def compared(other: Point) -> str:
        share = round(gain(other), 2)
        amount = f"{abs(share):.0%} {'more' if share > 0 else 'less'}" if share else "as much"
        return f"{other.agents} agents would move {amount}"

    if here.congested >= _JAMMED * here.runs:
        stuck = "more than half of the agents stood still at once"
        return _CONGESTED, f"in {here.congested} of {here.runs} runs {stuck}", points
    if here.congested:
        return _PAST, f"{here.congested} of {here.runs} runs congested", points
    if here.fading > FADING:
        return _PAST, f"a jam builds up: throughput falls by {here.fading:.0%} with time", points
    if idle > _IDLE:
        return _FLOWS, f"agents have no order for {idle:.0%} of their time", points
    if here.agents > 1:
        fewer = at(floor(_FEWER * here.agents))
        if gain(fewer) > _GAIN:
            return _PAST, compared(fewer), points
        if value_of_an_agent(fewer[:2], here[:2]) < WORTH:
            reason = f"the last {here.agents - fewer.agents} agents add {-gain(fewer):.0%}"
            # Beyond the peak throughput may lie flat: it is sought where agents are far fewer.
            for share in _FAR_FEWER:
                fewer = at(max(1, floor(share * here.agents)))
                if gain(fewer) > _GAIN:
                    return _PAST, compared(fewer), points
            return _NEAR, reason, points
    if here.agents < most:
        more = at(min(most, ceil(_MORE * here.agents)))
        word = _NEAR if value_of_an_agent(here[:2], more[:2]) < WORTH else _FLOWS
        return word, compared(more), points
    return _FLOWS, "every free cell holds an agent", points


def facts_of(study: Study, layout: np.ndarray) -> dict[str, Any]:
    """Return a study of a layout (int8 [H, W]) in JSON-ready values.

    Returns:
        runs (seed, throughput, congested, congested_at, end_timestep, finished_tasks),
        mean_throughput (see `Row.throughput`; None where it is none), mean_of_all (over all runs),
        standard_error (of the latter), success_rate, steps_per_task (moves; None where no task is
        finished), cpu_seconds_per_run, compile_seconds, valid, broken; where tasks arrive
        at a rate also idle_share (of the agents' time), order_wait (mean timesteps until an agent
        has an order); where it was looked into
        also waiting_share (of the agents' time), worst_cells, cells_with_half_of_waiting, verdict,
        verdict_reason, evidence (the numbers of agents that were tried).
    """
    row, done, maps, verdict, broken = study
    tasks = np.array([run.finished.sum() for run in done.runs])
    moves = tasks * [float(run.path_length) for run in done.runs]
    facts: dict[str, Any] = {
        "runs": [
            {
                "seed": int(seed),
                "throughput": float(run.throughput),
                "congested": bool(run.congested),
                "congested_at": int(run.congested_at) if run.congested else None,
                "end_timestep": int(run.end_timestep),
                "finished_tasks": int(run.finished.sum()),
            }
            for seed, run in zip(done.seeds, done.runs, strict=True)
        ],
        "mean_throughput": None if np.isnan(row.throughput) else row.throughput,
        "mean_of_all": row.mean_of_all,
        "standard_error": row.error_of_all,
        "success_rate": row.success_rate,
        "steps_per_task": float(moves.sum() / tasks.sum()) if tasks.any() else None,
        "cpu_seconds_per_run": round(row.cpu_seconds_per_run, 4),
        "compile_seconds": round(done.compile_seconds, 3),
        "valid": None if broken is None else not broken,
        "broken": broken or [],
    }
    if (idle := idle_share(done.runs)) is not None:
        waits = [float(run.order_wait) for run in done.runs if run.order_wait is not None]
        facts |= {"idle_share": idle, "order_wait": float(np.mean(waits))}
    if maps is not None:
        facts |= {
            "waiting_share": maps.waiting_share,
            "worst_cells": worst_cells(layout, maps),
            "cells_with_half_of_waiting": cells_with_half(maps),
        }
    if verdict is not None:
        word, reason, points = verdict
        facts |= {"verdict": word, "verdict_reason": reason}
        facts["evidence"] = [point._asdict() for point in points]
    return facts
