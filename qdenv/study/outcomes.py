"""What runs that were written down say together: success, throughput, when they congest."""

from collections.abc import Iterable, Sequence
from typing import NamedTuple

import numpy as np

from qdenv.score import wilson_interval
from qdenv.study.differences import sample_of
from qdenv.study.ledger import Key, Run


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


def outcomes_of(runs: Iterable[Run]) -> list[Outcome]:
    """Make a row of each case that has runs, in the order of their first runs.

    A run that is given twice counts once.
    """
    cases: dict[Key, dict[int, Run]] = {}
    for run in runs:
        cases.setdefault(run._replace(seed=0).key, {})[run.seed] = run
    return [_condense(list(seeds.values())) for seeds in cases.values()]


def _condense(runs: Sequence[Run]) -> Outcome:
    one, every = runs[0], np.array([run.throughput for run in runs])
    good = every[[not run.congested for run in runs]]
    ends = [float(run.end_timestep) for run in runs if run.congested and run.stop]
    jams = np.array(ends or [np.nan])
    success, whole = sample_of(good if len(good) else np.array([np.nan])), sample_of(every)
    return Outcome(
        *(one.layout, one.domain, one.agents, one.timesteps, one.planner, one.stop),
        *(len(runs), len(good), *wilson_interval(len(good), len(runs))),
        *(success.mean, success.error, whole.mean, whole.error),
        *(float(np.median(jams)), float(jams.min()), float(jams.max())),
        cpu_seconds=float(np.mean([run.cpu_seconds for run in runs])),
    )
