"""Runs written down: a CSV file with a row per run; what it holds is not simulated again."""

import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from datetime import timedelta
from pathlib import Path
from typing import Any, NamedTuple, TypeAlias

import numpy as np

from experiments.pieces import say
from qdenv.domains.base import Domain
from qdenv.grid import checksum
from qdenv.io.files import write_csv
from qdenv.io.records import read_table
from qdenv.run.executors import ClusterExecutor
from qdenv.simulation.mapf.negotiated.settings import EFFORTS
from qdenv.simulation.mapf.settings import MOST_STEPS, FleetConfig, PbsConfig
from qdenv.stats import Sample, sample_of, wilson_interval
from qdenv.study.engine import Simulated, run_seeds
from qdenv.study.options import fleet_tasks
from qdenv.study.table import choose_capacity
from qdenv.types import about, look_up

# Planners by name: ours at two efforts, the paper's by two rules.
DRIVERS: Mapping[str, Any] = {
    **EFFORTS,
    "published": PbsConfig(rule="published"),
    "plain": PbsConfig(rule="plain"),
}
# CPU seconds of one agent's timestep where no run is known.
RATES = {"low": 1.3e-6, "high": 2.5e-6, "plain": 6e-6, "published": 5e-6}
_PAUSE = 30.0  # seconds between two lines on the progress
_Key: TypeAlias = tuple[str, str, int, int, str, bool, str, int]  # the first fields of a `Run`


class Case(NamedTuple):
    """What is simulated once per seed."""

    layout: str  # its name in tables
    tiles: np.ndarray  # int8 [H, W]
    domain: Domain  # whose tasks the agents do
    agents: int  # how many
    timesteps: int  # horizon T
    planner: str  # one of `DRIVERS`
    stop: bool = True  # end a run where it congests

    def key(self, seed: int) -> _Key:
        """Return the fields of `Run` that tell the run of a seed from all others."""
        numbers = (self.agents, self.timesteps, self.planner, self.stop)
        return (self.layout, self.domain.name, *numbers, checksum(self.tiles), seed)

    @property
    def fleet(self) -> FleetConfig:
        """The settings of its simulation."""
        how: Any = {"planner": DRIVERS[self.planner], "stop_when_congested": self.stop}
        return FleetConfig(self.agents, self.timesteps, **how)


class Run(NamedTuple):
    """One run, a row of the file."""

    layout: str  # its name
    domain: str  # name of the domain
    agents: int  # how many drove
    timesteps: int  # horizon T
    planner: str  # one of `DRIVERS`
    stop: bool  # it would have ended where it congested
    tiles: str  # checksum of the layout: another one of the same name has other runs
    seed: int  # of starts, goals and ties
    throughput: float  # tasks per timestep, over all of T
    congested: bool  # it congested
    end_timestep: int  # timesteps driven
    cpu_seconds: float  # of driving, without preparing and compiling

    @property
    def key(self) -> _Key:
        """Layout to seed, which tell it from all other runs, as `Case.key` does."""
        return self[:8]


def read_runs(path: Path) -> list[Run]:
    """Read the runs of a file; raise InputError if there is none, or it is no table of runs."""
    return list(read_table(path, Run))


def complete(
    path: Path,
    cases: Sequence[Case],
    seeds: Sequence[int],
    others: Sequence[Path] = (),
    client: Any = None,
) -> list[Run]:
    """Simulate what no file holds, write each run down as it ends; return all, case by case.

    `path` is the file that grows; `others` are only read; `client` is of a cluster whose workers
    simulate, else this process does, run by run. Every half minute a line on the progress is
    printed. Several processes may share a file: if two write in the same instant a row can get
    lost, and is simulated again the next time.

    Raises InputError if a case cannot be simulated, or a file is no table of runs.
    """
    for case in cases:
        look_up(DRIVERS, case.planner, "planner")
        with about(case.layout):
            fleet_tasks(case.tiles, case.domain.simulator.tasks, case.fleet.agents)
    files = [*others, *[path] * path.exists()]
    known = {run.key: run for file in files for run in read_runs(file)}
    todo = [(case, seed) for case in cases for seed in seeds if case.key(seed) not in known]
    last = time.time()
    for done, run in enumerate(_simulate_all(todo, client), start=1):
        known[run.key] = run
        # Read again: another process may have written since.
        write_csv(path, Run._fields, [*(read_runs(path) if path.exists() else []), run])
        if time.time() - last > _PAUSE or done == len(todo):
            last = time.time()
            rest = [case for case, seed in todo if case.key(seed) not in known]
            left = timedelta(seconds=round(seconds_for(rest, list(known.values()))))
            jam = ", congested" * run.congested
            say(
                f"{done} of {len(todo)} runs, about {left} of one core left: {run.layout}, "
                f"{run.agents} agents, {run.planner}, seed {run.seed}: {run.throughput:.3f}{jam}"
            )
    return [known[case.key(seed)] for case in cases for seed in seeds]


def _simulate_all(todo: Sequence[tuple[Case, int]], client: Any) -> Iterator[Run]:
    """Simulate cases, each from its seed, here or on a cluster."""
    if client is None:
        yield from (simulate(case, seed) for case, seed in todo)
    elif todo:
        executor = ClusterExecutor(client)
        try:
            # Workers have the package, not this module: they get no `Case`.
            given = zip(*(_arguments(case, seed) for case, seed in todo), strict=True)
            for (case, seed), done in zip(todo, executor.map(run_seeds, *given), strict=True):
                yield _to_run(case, seed, done)
        finally:
            executor.shutdown(cancel_futures=True)


def simulate(case: Case, seed: int) -> Run:
    """Simulate one run on one core; the program has been loaded before its clock starts."""
    return _to_run(case, seed, run_seeds(*_arguments(case, seed)))


def _arguments(case: Case, seed: int) -> tuple:
    """Return what `run_seeds` takes for one run on one core."""
    # Runs with other numbers of agents share the program; it is no larger than can be counted.
    most = max(case.agents, min(case.tiles.size, MOST_STEPS // case.timesteps))
    config = replace(case.fleet, agents=min(choose_capacity(case.agents), most))
    return (case.tiles, case.domain.simulator.tasks, config, [seed], case.agents, None, 1)


def _to_run(case: Case, seed: int, done: Simulated) -> Run:
    """Round a run as the file holds it: one that is read equals the one that was made."""
    (run,) = done.runs
    return Run(
        *case.key(seed),
        throughput=float(f"{run.throughput:.6g}"),
        congested=bool(run.congested),
        end_timestep=int(run.end_timestep),
        cpu_seconds=round(done.cpu_seconds, 4),
    )


def rate(planner: str, runs: Iterable[Run]) -> float:
    """Estimate the CPU seconds of an agent's timestep: from runs of the planner, or any, if any."""
    known = list(runs)
    same = [run for run in known if run.planner == planner] or known
    if not same:
        return RATES[planner]
    return sum(run.cpu_seconds for run in same) / sum(run.agents * run.timesteps for run in same)


def seconds_for(cases: Sequence[Case], runs: Sequence[Run]) -> float:
    """Estimate the CPU seconds of a run of each case from other runs."""
    rates = {planner: rate(planner, runs) for planner in {case.planner for case in cases}}
    return sum(rates[case.planner] * case.agents * case.timesteps for case in cases)


class Outcome(NamedTuple):
    """The runs of one case."""

    layout: str  # its name
    domain: str  # whose tasks
    agents: int  # how many
    timesteps: int  # horizon T
    planner: str  # who drove
    stop: bool  # runs ended where they congested
    runs: int  # how many
    successes: int  # how many never congested
    low: float  # lower end of the 95 % Wilson interval of the success rate
    high: float  # upper end
    throughput: float  # mean over the successful runs, as published tables have it; NaN for none
    error: float  # its standard error; NaN with fewer than two
    mean_of_all: float  # mean over all runs
    error_of_all: float  # its standard error
    jam_median: float  # timestep at which runs congested; NaN where none did, or none stopped there
    jam_least: float  # of the first
    jam_most: float  # of the last
    cpu_seconds: float  # of a run, on average

    @property
    def sample_of_all(self) -> Sample:
        """The mean over all runs, congested ones too, with its error."""
        return Sample(self.mean_of_all, self.error_of_all, self.runs)


def outcomes_of(runs: Iterable[Run]) -> list[Outcome]:
    """Make a row of each case that has runs, in the order of their first runs.

    A run that is given twice counts once.
    """
    cases: dict[tuple, dict[int, Run]] = {}
    for run in runs:
        cases.setdefault(run[:7], {})[run.seed] = run
    rows = []
    for own in (list(seeds.values()) for seeds in cases.values()):
        every = np.array([run.throughput for run in own])
        good = every[[not run.congested for run in own]]
        ends = [float(run.end_timestep) for run in own if run.congested and run.stop]
        jams = np.array(ends or [np.nan])
        success, whole = sample_of(good if len(good) else np.array([np.nan])), sample_of(every)
        row = Outcome(
            *own[0][:6],
            *(len(own), len(good), *wilson_interval(len(good), len(own))),
            *(success.mean, success.error, whole.mean, whole.error),
            *(float(np.median(jams)), float(jams.min()), float(jams.max())),
            cpu_seconds=float(np.mean([run.cpu_seconds for run in own])),
        )
        rows.append(row)
    return rows
