"""Operations that put fleets side by side: tables of several numbers of agents, and of planners."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any, Unpack

import numpy as np

from qdenv.ops import options as args
from qdenv.ops.output import Table, place, place_table, say
from qdenv.progress import Bar, Progress
from qdenv.simulation.mapf.settings import PLANNERS, check_costs, record_planner
from qdenv.stats import Difference
from qdenv.study import table as studies
from qdenv.study.options import AGENTS, parse_counts, usual_fleet
from qdenv.study.plans import Plan
from qdenv.study.recordings import FADING
from qdenv.types import InputError
from qdenv.view import PAGE, parse_width

# Numbers of agents unless given, on layouts for which 200 are usual: first, last, step.
SWEEP, CLIMB = (50, 400, 50), (50, 1000, 50)
_MOST_WARNINGS = 3


def sweep(
    layout: args.Source, agents: args.Counts = None, **study: Unpack[args.StudyOptions]
) -> Table:
    """Simulate a layout with more and more agents: throughput, its peak, and how many are worth it.

    Args:
        layout: layout file.
        agents: numbers of agents (robots), as 50,100,200 or 50:400:50; by default the latter, or
            in proportion where more or fewer than 200 are usual.
        **study: see `StudyOptions`.

    Returns:
        a `study.table.Row` for each number of agents.

    Raises:
        InputError: a number or a name is impossible, or a file cannot be read or written.

    Examples:
        ``qdenv sweep plan.txt --robots 50:400:50``
    """
    name = f"{Path(args.name_of(layout)).stem}_sweep"
    fleets = _Fleets([layout], agents, SWEEP, name, study)
    with Bar("simulating") as bar:
        rows = fleets.compare(bar)
    # Numbers of agents may be stated in any order; the peak is read along ascending ones.
    rows.sort(key=lambda row: row.agents)
    peak, worth = studies.find_peak(rows), studies.find_capacity(rows)
    if len(rows) > 1:
        each = "each brings at least half of what an average one does"
        say(fleets.describe_peak(peak), f"agents worth having: up to {worth}, {each}")
    return fleets.finish(rows, {"peak": peak._asdict(), "worth_it_up_to": worth})


def compare(
    layouts: args.Sources,
    agents: args.Counts = None,
    runs: args.Out = None,
    **study: Unpack[args.StudyOptions],
) -> Table:
    """Compare layouts or planners: throughput, success rate, how certain the difference is.

    Args:
        layouts: layout files; all others are compared with the first. With several planners, as
            --planner negotiated,pbs,pibt, each is compared with the first planner on the same
            layout, seed by seed.
        agents: numbers of agents (robots), as 200 or 50,100 or 50:400:50; by default that of the
            first plan or their size, else 200.
        runs: CSV file to write, with a row for each seed.
        **study: see `StudyOptions`.

    Returns:
        a `study.table.Row` for each layout and number of agents, planner by planner.

    Raises:
        InputError: no layout is given, they are of several domains, or a fleet cannot work there.

    Examples:
        ``qdenv compare before.txt after.txt --robots 40,60 --plot``
    """
    fleets = _Fleets(layouts, agents, (AGENTS, AGENTS, 1), "compare", study, several=True)
    each_run = place(runs, "compare_runs.csv", (".csv",), fleets.inputs)
    with Bar("simulating") as bar:
        rows = fleets.compare(bar)
    against, (first, how) = studies.differences(rows), (rows[0].layout, "Welch, Fieller")
    if rows[0].planner:
        first, how = rows[0].planner, "seed by seed; paired t, Fieller"
    others = [
        (row, one)
        for row, one in zip(rows, against, strict=True)
        if (row.planner or row.layout) != first
    ]
    say(*[f"against {first}, over all runs, with 95 % interval ({how}):"] * bool(others))
    for row, one in others:
        change = f"{one}, {'significant' if one.significant else 'may be chance'}"
        if np.isnan(one.low):
            change = f"{one.percent:+.1f} % (too few runs for an interval)"
        say(f"{row.name}, {row.agents} agents: {change}")
    names = [f"difference_{name}" for name in Difference._fields[:3]] + ["significant"]
    # None where there is no interval: an empty cell.
    ends = [
        [None if one != one else one for one in values] for values in zip(*against, strict=True)
    ]
    columns = dict(zip(names, ends, strict=True))
    if each_run:
        studies.write_runs(each_run.path, rows)
        say(each_run)
    return fleets.finish(rows, {}, columns)


def scalability(
    layouts: args.Sources, agents: args.Counts = None, **study: Unpack[args.StudyOptions]
) -> Table:
    """Add agents until the mean throughput drops; report the peak and the agents at the peak.

    Args:
        layouts: layout files, of one size or of several.
        agents: numbers of agents (robots) to try in turn; by default 50:1000:50, or in
            proportion where more or fewer than 200 are usual. Numbers that do not fit are left out.
        **study: see `StudyOptions`.

    Returns:
        a `study.table.Row` for each layout and number of agents.

    Raises:
        InputError: no layout is given, they are of several domains, or a fleet cannot work there.

    Examples:
        ``qdenv scalability plan.txt --effort low``
    """
    fleets = _Fleets(layouts, agents, CLIMB, "scalability", study)
    # All layouts are checked before hours go into the first one.
    for name, layout in fleets.floors.items():
        studies.check_climb(name, layout, fleets.trial)
    with Bar("simulating") as bar:
        climbs = [
            studies.climb(name, layout, fleets.trial, fleets.show, bar)
            for name, layout in fleets.floors.items()
        ]
    peaks = [studies.find_peak(rows) for rows in climbs]
    say(*map(fleets.describe_peak, peaks))
    facts = {"peaks": [peak._asdict() for peak in peaks]}
    return fleets.finish([row for rows in climbs for row in rows], facts, peaks=peaks)


class _Fleets:
    """A study of several runs: what is simulated, and what is logged, written and drawn of it."""

    def __init__(
        self,
        layouts: Sequence[Any],
        agents: Any,
        default: tuple[int, ...],
        name: str,
        study: args.StudyOptions,
        several: bool = False,
    ) -> None:
        """Check everything before anything is simulated.

        Without `agents` their numbers are those of `default`: first, last and step, on layouts for
        which 200 agents are usual. `name` is that of the table, unless `study` states another. The
        planners of `study` may be `several`.
        """
        layouts = list(layouts) if type(layouts) in (list, tuple) else [layouts]
        fleets = args.each_planner(study) if several else [args.Fleet(study, args.StudyOptions)]
        options, stated = fleets[0], parse_counts(agents)
        self._width = parse_width(study.get("width") or PAGE)
        options.config(max(stated, default=1))  # refuses what makes no simulation
        inputs = self.inputs = [*layouts, *options.inputs]
        self._table, self._picture = place_table(study.get("out"), study.get("plot"), name, inputs)
        plans = _read_plans(layouts, options)
        if any(plan.costs is not None for plan in plans.values()):
            for one in fleets:
                check_costs(one.planner)
        first, drawn = next(iter(plans.values())), [plan.layout for plan in plans.values()]
        largest = max(stated, default=first.facts.robots)
        usual, timesteps, note = usual_fleet(first.domain, drawn, largest, options.timesteps)
        # Larger known sizes are usual with more agents: the range grows in proportion.
        begin, end, step = (max(round(one * usual / AGENTS), 1) for one in default)
        counts = stated or tuple(range(begin, end + 1, step))
        self.floors = {name: plan.floor for name, plan in plans.items()}
        names = [PLANNERS.name_of(one.planner) for one in fleets]
        if len(set(names)) < len(names):  # one planner with other settings
            names = [f"{name} {number}" for number, name in enumerate(names, start=1)]
        tasks, most = first.domain.simulator.tasks, max(counts)
        self._trials = [
            studies.Trial(tasks, one.config(most, timesteps), counts, one.seeds, planner)
            for one, planner in zip(fleets, names if len(fleets) > 1 else [""], strict=True)
        ]
        self.trial = self._trials[0]
        self._per_hour = options.per_hour
        self._settings = options.settings(timesteps, [*plans.values()]) | {
            "agents": list(counts),
            "layouts": dict(zip(plans, map(args.name_of, layouts), strict=True)),
        }
        if len(fleets) > 1:
            self._settings["planner"] = {
                name: record_planner(one.planner) for name, one in zip(names, fleets, strict=True)
            }
        # A range is written as a range, so that the command line can be read off the line.
        written, steps = ",".join(map(str, counts)), {b - a for a, b in pairwise(counts)}
        if len(counts) > 2 and len(steps) == 1:
            written = f"{counts[0]}:{counts[-1]}:{steps.pop()}"
        # Columns fit the names of the layouts.
        wide = max(map(len, names)) + 2 if len(fleets) > 1 else 0
        self._long = max(6, *map(len, plans)) + wide
        hour = "  tasks/hour" if self._per_hour else ""
        head = "  size     agents  throughput (s.e.)  success (95 %)    mean of all"
        planners = [one.planner for one in fleets]
        lines = [options.describe(written, timesteps, [*plans.values()], planners), note]
        self._head = [*filter(None, lines), f"{'layout':{self._long}}{head}{hour}"]

    def compare(self, bar: Progress) -> list[studies.Row]:
        """Simulate every layout with every number of agents, planner by planner."""
        rows: list[studies.Row] = []
        for number, trial in enumerate(self._trials):

            def report(doing: str, share: float, note: str, number: int = number) -> None:
                bar(doing, (number + share) / len(self._trials), note)

            rows += studies.compare(self.floors, trial, self.show, report)
        return rows

    def show(self, row: studies.Row) -> None:
        """Log a row, the first one below a head."""
        size, error = f"{row.rows}x{row.cols}", f"({row.standard_error:.3f})"
        bounds = f"({row.success_low:.0%} to {row.success_high:.0%})"
        tasks = f"  {row.mean_of_all * self._per_hour:10,.0f}" if self._per_hour else ""
        say(
            *self._head,
            f"{row.name:{self._long}}  {size:8} {row.agents:6}  {row.throughput:8.3f} {error:8} "
            f" {row.success_rate:4.0%} {bounds:14} {row.mean_of_all:9.3f}{tasks}",
        )
        self._head = []

    def describe_peak(self, peak: studies.Peak) -> str:
        """Return in a line how much a layout moves at most."""
        rate = self._per_hour
        hour = f" ({peak.throughput * rate:,.0f} per hour)" if rate else ""
        end = "" if peak.dropped else ", still rising at the last number of agents: try more"
        most = f"peak {peak.throughput:.3f} tasks per timestep{hour}"
        return f"{peak.layout}: {most} at {peak.agents} agents{end}"

    def finish(
        self,
        rows: Sequence[studies.Row],
        facts: Mapping[str, Any],
        columns: Mapping[str, Sequence[Any]] | None = None,
        peaks: Sequence[studies.Peak] = (),
    ) -> Table:
        """Write the table and the picture, warn of jams that build up, collect the facts.

        The table has further `columns` beside the rows' own. The picture shows how layouts
        scale if there are `peaks`, else it puts them side by side.
        """
        columns = dict(columns or {})
        if self._per_hour:
            columns["tasks_per_hour"] = [row.mean_of_all * self._per_hour for row in rows]
        if self._table:
            studies.write_rows(self._table.path, rows, columns)
        if self._picture:
            from qdenv.view.studies import draw_comparison, draw_peaks  # imports matplotlib
            from qdenv.view.style import save_figure

            width = self._width
            figure = draw_peaks(rows, peaks, width) if peaks else draw_comparison(rows, width)
            save_figure(figure, self._picture.path)
        for row in [row for row in rows if row.fading > FADING][:_MOST_WARNINGS]:
            falls = f"throughput falls by {row.fading:.0%} with time"
            jam = f"{row.name}: with {row.agents} agents a jam builds up"
            say(f"{jam}, {falls}: more timesteps show where that ends")
        say(*filter(None, [", ".join(str(one) for one in (self._table, self._picture) if one)]))
        lines = [
            row._asdict()
            | {"each": [run._asdict() for run in row.each]}
            | {name: values[number] for name, values in columns.items()}
            for number, row in enumerate(rows)
        ]
        return Table(rows, {**facts, "rows": lines, "settings": self._settings})


def _read_plans(layouts: Sequence[Any], options: args.Fleet) -> dict[str, Plan]:
    """Read layouts of one domain, by names: briefly where that tells them apart."""
    if not layouts:
        raise InputError("give at least one layout file")
    plans = [options.read_plan(layout) for layout in layouts]
    kinds = list(dict.fromkeys(plan.domain.name for plan in plans))
    if len(kinds) > 1:
        raise InputError(f"these are layouts of {' and '.join(kinds)}: put one domain side by side")
    brief, long = Counter(plan.name for plan in plans), Counter(map(args.name_of, layouts))
    named = {}
    for number, (plan, layout) in enumerate(zip(plans, layouts, strict=True), start=1):
        name = plan.name
        if brief[name] > 1:
            own = args.name_of(layout)
            name = own if isinstance(layout, str | Path) and long[own] == 1 else f"{name} {number}"
        named[name] = plan
    return named
