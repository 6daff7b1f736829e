"""The sentences of a report on layouts in which a fleet drives."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from qdenv.simulate.mapf.choosing import describe_planner
from qdenv.stats import Difference, Sample, difference, margin
from qdenv.study.congestion import FADING
from qdenv.study.table import Row, find_capacity, find_peak
from qdenv.study.traffic import Study
from qdenv.view.report.fleet import Found
from qdenv.view.report.subjects import Rival, Subject

VERDICTS = {
    "flows": "The floor plan takes this many robots with ease",
    "near capacity": "The floor plan is near its capacity",
    "past its peak": "This many robots are past the peak of the floor plan",
    "congested": "The floor plan jams with this many robots",
}


def listed(words: Sequence[str]) -> str:
    """Join words as a sentence does."""
    return " and ".join(filter(None, [", ".join(words[:-1]), words[-1]]))


def name_seeds(seeds: Sequence[int]) -> str:
    """Say seeds briefly."""
    if len(seeds) == 1:
        return f"seed {seeds[0]}"
    if list(seeds) == list(range(len(seeds))):
        return f"seeds 0 to {seeds[-1]}"
    return f"seeds {listed([str(seed) for seed in seeds])}"


def say_size(subject: Subject) -> str:
    """Say a layout's size and its numbers of tiles."""
    numbers = [f"{number:,} {name}" for name, number in subject.numbers.items()]
    return f"{subject.size} cells" + (f" with {listed(numbers)}" if numbers else "")


def question(found: Found) -> str:
    """Say in plain words what was asked."""
    asked, config = found.asked, found.asked.config
    subjects = [f"{one.name} ({say_size(one)})" for one in asked.subjects]
    plans = f"floor plan {subjects[0]}" if len(subjects) == 1 else f"floor plans {listed(subjects)}"
    does = "does" if len(subjects) == 1 else "do"
    peak = ", where the first moves most," if asked.agents is None else ""
    others = [str(count) for count in asked.counts if count != found.agents]
    also = f", and how would it be with {listed(others)}" if others else ""
    runs = (
        f"the mean of {len(asked.seeds)} simulated runs" if len(asked.seeds) > 1 else "of one run"
    )
    end = "" if config.stop_when_congested else " A run goes on after it congested."
    return (
        f"How well {does} the {plans} move tasks with {found.agents} robots{peak} over "
        f"{config.timesteps:,} timesteps{also}? Each number is {runs} ({name_seeds(asked.seeds)}). "
        f"The robots' paths are planned by: {describe_planner(config.planner)}. "
        "Throughput is the number of tasks that all robots together finish in a timestep. A run "
        f"congests when more than half of the robots stand still at once.{end}"
    )


def interval(row: Row, digits: int = 2) -> str:
    """Say the 95 % interval of a row's mean throughput; "" for one run."""
    half = margin(Sample(row.mean_of_all, row.error_of_all, row.runs))
    if np.isnan(half):
        return ""
    low = max(row.mean_of_all - half, 0.0)
    return f"{low:.{digits}f} to {row.mean_of_all + half:.{digits}f}"


def compare_rows(ours: Row, theirs: Row) -> Difference:
    """Compare two rows over all their runs, as `qdenv compare` does."""
    return difference(
        *(Sample(row.mean_of_all, row.error_of_all, row.runs) for row in (ours, theirs))
    )


def say_difference(found: Difference) -> str:
    """Say how much more or less, and how sure that is."""
    amount = f"{abs(found.percent):.1f} % {'more' if found.percent > 0 else 'less'}"
    if np.isnan(found.percent):
        return "not to be compared: the other one moves nothing"
    if np.isnan(found.low):
        return f"{amount} (too few runs to say how sure)"
    sure = "" if found.significant else ", which may be chance"
    return f"{amount} (95 %: {found.low:+.1f} to {found.high:+.1f} %{sure})"


def in_robots(words: str) -> str:
    """Call agents what they are to people."""
    return words.replace("agent", "robot")


def answer(found: Found, subject: Subject, study: Study, rival: Rival) -> str:
    """Say what was found out of one layout."""
    row, verdict = found.row_at(subject.name), study.verdict
    assert verdict is not None
    about = f" (95 % interval {interval(row)})" if interval(row) else ""
    per_hour = found.asked.per_hour
    hour = f", {row.mean_of_all * per_hour:,.0f} per hour" if per_hour else ""
    said = [
        f"{subject.name}: {VERDICTS[verdict.word]}. "
        f"With {found.agents} robots it moves {row.mean_of_all:.2f} tasks per timestep"
        f"{about}{hour}; {in_robots(verdict.reason)}."
    ]
    if row.success_rate == 1:
        said.append(f"None of {row.runs} runs congested.")
    else:
        bad = row.runs - round(row.success_rate * row.runs)
        said.append(f"{bad} of {row.runs} runs congested.")
    if rival.layout is not None:
        theirs = found.row_at(rival.name)
        said.append(
            f"That is {say_difference(compare_rows(row, theirs))} than the layout that people draw "
            f"by hand at this size, {theirs.mean_of_all:.2f}."
        )
    return " ".join(said)


def say_peak(found: Found, subject: Subject) -> str:
    """Say where a layout moves most, and up to where further robots are worth it."""
    rows = sorted(found.rows_of(subject.name), key=lambda row: row.agents)
    peak, worth = find_peak(rows), find_capacity(rows)
    if len(rows) == 1:
        return ""
    end = "" if peak.dropped else ", the most that were tried"
    return (
        f"{subject.name} moves most with {peak.agents} robots{end}: {peak.throughput:.2f} tasks "
        f"per timestep. Up to {worth} robots each further one brings half of what an average one "
        f"does, or more."
    )


def say_waiting(study: Study, half: int) -> str:
    """Say how much robots wait, and on how many cells."""
    assert study.maps is not None
    share = study.maps.waiting_share
    where = f", half of it on {half} cells" if half else ""
    return (
        f"Robots wait {share:.1%} of their time{where}. Waiting is a timestep without a move "
        f"anywhere but on the robot's own goal."
    )


def say_fading(found: Found) -> list[str]:
    """Name the cases in which a jam builds up, so that a longer run would show less."""
    return [
        f"{row.layout} with {row.agents} robots: a jam builds up, throughput falls by "
        f"{row.fading:.0%} with time, and a longer run would show less."
        for row in found.rows
        if row.fading > FADING
    ]
