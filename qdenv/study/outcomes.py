"""What runs that were written down say together: success, throughput, when they congest."""

from collections.abc import Iterable, Sequence
from typing import NamedTuple

import numpy as np

from qdenv.score.traffic import wilson_interval
from qdenv.study.differences import sample_of
from qdenv.study.ledger import Key, Run


class Outcome(NamedTuple):
    """The runs of one case.

    Attributes:
        layout: its name.
        domain: whose tasks.
        agents: how many.
        timesteps: horizon T.
        planner: who drove.
        stop: runs ended where they congested.
        runs: how many.
        successes: how many never congested.
        low: lower end of the 95 % Wilson interval of the success rate.
        high: upper end.
        throughput: mean over the successful runs, as published tables have it; NaN for none.
        error: its standard error; NaN with fewer than two.
        mean_of_all: mean over all runs.
        error_of_all: its standard error.
        jam_median: timestep at which runs congested; NaN where none did, or none stopped there.
        jam_least: of the first.
        jam_most: of the last.
        cpu_seconds: of a run, on average.
    """

    layout: str
    domain: str
    agents: int
    timesteps: int
    planner: str
    stop: bool
    runs: int
    successes: int
    low: float
    high: float
    throughput: float
    error: float
    mean_of_all: float
    error_of_all: float
    jam_median: float
    jam_least: float
    jam_most: float
    cpu_seconds: float


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
