"""Whether a layout still takes more agents, judged by runs with fewer and with more of them.

A fleet's throughput rises with its agents up to a peak, and falls beyond it. On crowded layouts it
falls all of a sudden, when a jam forms that no agent gets out of: the hand-made warehouse of
33 x 36 moves 6.04 tasks per timestep with 200 agents, 5.68 with 225 and 5.20 with 250. That no run
was *congested*, i.e. that never more than half of the agents stood still at once, says little then.

Held against the true peaks, found by sweeps over T = 1000 with high effort in steps of 12 to 50
agents, on three published warehouses of 33 x 36:

| layout | peak at | flows         | near capacity | past its peak | congested |
| human  |     200 | 100, 150      | 175, 200      | 225, 250      |           |
| NCA    |     338 | 200, 250      | 300, 350      | 400           |           |
| DSAGE  |     300 | 200, 250      | 300           |               | 350       |
"""

from collections.abc import Callable, Sequence
from math import ceil, floor
from typing import NamedTuple

import numpy as np

from qdenv.stats import sample_of
from qdenv.study.congestion import FADING, fading
from qdenv.study.table import WORTH, value_of_an_agent
from qdenv.types import Traffic

FLOWS, NEAR, PAST, CONGESTED = "flows", "near capacity", "past its peak", "congested"

_JAMMED = 0.5  # share of congested runs from which on the layout is
PROBES = 2  # runs with another number of agents
FEWER, FAR_FEWER, MORE = 0.75, (0.5, 0.25), 1.25  # of the agents, those numbers
_GAIN = 0.02  # more throughput than this with fewer agents: past the peak


class Point(NamedTuple):
    """The throughput at one number of agents."""

    agents: int  # how many agents
    throughput: float  # tasks per timestep, the mean over all runs
    standard_error: float  # of it; NaN for one run
    runs: int  # how many
    congested: int  # how many of them congested
    fading: float  # see `congestion.fading`


class Verdict(NamedTuple):
    """How a layout bears a fleet."""

    word: str  # "flows", "near capacity", "past its peak" or "congested"
    reason: str  # what shows it, in one line
    # the evidence: this number of agents first, then those that were probed
    points: tuple[Point, ...]


def point_of(agents: int, runs: Sequence[Traffic]) -> Point:
    """Condense runs with one number of agents."""
    # In double precision, other than in `table.Row`: the numbers of saved reports stay the same.
    sample = sample_of(np.array([run.throughput for run in runs], float))
    return Point(
        agents=agents,
        throughput=sample.mean,
        standard_error=sample.error,
        runs=len(runs),
        congested=sum(bool(run.congested) for run in runs),
        fading=fading(runs),
    )


def judge(here: Point, probe: Callable[[int], Point], most: int) -> Verdict:
    """Judge whether a layout takes this many agents, and whether it would take more.

    In this order, so that runs are only spent where the verdict hangs on them:

    * *congested*: in at least half of the runs, more than half of the agents stood still at once.
    * *past its peak*: throughput fades by more than 5 % while time goes on (a jam builds up), or a
      run congested, or three quarters, half or a quarter of the agents move 2 % more.
    * *near capacity*: the last quarter of the agents, or a quarter more of them, brings per agent
      less than half of what an average robot does.
    * *flows*: none of these.

    Args:
        here: with the number of agents in question.
        probe: simulates another number of agents.
        most: agents that fit the layout.
    """
    points = [here]

    def at(agents: int) -> Point:
        points.append(probe(agents))
        return points[-1]

    def verdict(word: str, reason: str) -> Verdict:
        return Verdict(word, reason, tuple(points))

    if here.congested >= _JAMMED * here.runs:
        stuck = "more than half of the agents stood still at once"
        return verdict(CONGESTED, f"in {here.congested} of {here.runs} runs {stuck}")
    if here.congested:
        return verdict(PAST, f"{here.congested} of {here.runs} runs congested")
    if here.fading > FADING:
        return verdict(PAST, f"a jam builds up: throughput falls by {here.fading:.0%} with time")
    worth = 1.0
    if here.agents > 1:
        fewer = at(floor(FEWER * here.agents))
        if _gain(here, fewer) > _GAIN:
            return verdict(PAST, _compared(here, fewer))
        worth = value_of_an_agent(fewer[:2], here[:2])
        reason = f"the last {here.agents - fewer.agents} agents add {-_gain(here, fewer):.0%}"
    if worth < WORTH:
        # Beyond the peak throughput may lie flat: it is sought where agents are far fewer.
        for share in FAR_FEWER:
            fewer = at(max(1, floor(share * here.agents)))
            if _gain(here, fewer) > _GAIN:
                return verdict(PAST, _compared(here, fewer))
        return verdict(NEAR, reason)
    if here.agents < most:
        more = at(min(most, more_than(here.agents)))
        word = NEAR if value_of_an_agent(here[:2], more[:2]) < WORTH else FLOWS
        return verdict(word, _compared(here, more))
    return verdict(FLOWS, "every free cell holds an agent")


def more_than(agents: int) -> int:
    """Say how many agents are tried above a number of them."""
    return ceil(MORE * agents)


def _gain(here: Point, other: Point) -> float:
    """Say how much more `other` moves than `here`, as a share of the latter."""
    if not here.throughput:
        return float(other.throughput > 0)
    return other.throughput / here.throughput - 1


def _compared(here: Point, other: Point) -> str:
    share = round(_gain(here, other), 2)
    amount = f"{abs(share):.0%} {'more' if share > 0 else 'less'}" if share else "as much"
    return f"{other.agents} agents would move {amount}"
