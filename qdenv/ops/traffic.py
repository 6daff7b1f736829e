"""Operations on fleets: one on a layout, where it jams; tables of several numbers of agents."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any, Unpack

import numpy as np

from qdenv.ops import options as args
from qdenv.ops.output import PICTURES, Result, Table, format_table, place, place_table, say
from qdenv.progress import Bar
from qdenv.simulate.mapf.settings import describe_planner
from qdenv.stats import Difference
from qdenv.study import table as studies
from qdenv.study.options import AGENTS, fleet_tasks, usual_fleet
from qdenv.study.plans import Plan
from qdenv.study.recordings import FADING
from qdenv.study.table import Peak, Row, differences, find_capacity, find_peak, write_rows
from qdenv.types import InputError
from qdenv.view import PAGE, SCREEN

if TYPE_CHECKING:  # imports the simulator
    from qdenv.study.traffic import Study

# Numbers of agents unless given, on layouts for which 200 are usual: first, last, step.
SWEEP, CLIMB = (50, 400, 50), (50, 1000, 50)
_MOST_WARNINGS = 3


def simulate_layout(
    layout: args.Source,
    agents: int | None = None,
    audit: args.OnCommandLine = False,
    verdict: args.OnCommandLine = False,
    plot: args.Picture = None,
    width: args.Width = None,
    **fleet: Unpack[args.FleetOptions],
) -> Result:
    """Simulate a fleet on a layout: its throughput, where it jams, whether more agents would help.

    Args:
        layout: layout file.
        agents: number of agents (robots); 200, or what is known of the layout's size, unless given.
        audit: check every trajectory against the rules of movement.
        verdict: simulate a few runs with fewer and with more agents as well, to find whether this
            number flows, is near capacity, past its peak or congested.
        plot: picture of where agents wait, drive and finish tasks, and of throughput over time.
        width: of the picture in inches; what suits it unless given.
        **fleet: see `FleetOptions`.

    Returns:
        ``mean_throughput`` in tasks per timestep, and more: what `--json` writes.

    Raises:
        InputError: a name is unknown, or the fleet cannot work on this layout.
    """
    if width and not plot:
        raise InputError(f"--width {width:g} is the picture's: add --plot")
    options = args.Fleet(fleet)
    plan, name = options.read_plan(layout), args.name_of(layout)
    picture = place(plot, f"{plan.name}_traffic.png", PICTURES, [layout])
    agents, timesteps, note = usual_fleet(plan.domain, [plan.layout], agents, options.timesteps)
    with studies.about(name):
        fleet_tasks(plan.layout, plan.domain.simulator.tasks, agents)
        config = options.config(agents, timesteps)
    # This imports the simulator: refusals are faster without it.
    from qdenv.study.traffic import examine, facts_of

    about: dict[str, Any] = {"domain": plan.domain.name, "agents": agents, "layout": name}
    about |= {"planner": describe_planner(config.planner), "timesteps": timesteps}
    about["stop"] = options.stop

    def facts_with(study: Study) -> dict[str, Any]:
        facts = facts_of(study, plan.layout) | about
        if options.per_hour:
            facts["tasks_per_hour"] = facts["mean_of_all"] * options.per_hour
        return facts

    def log_runs(study: Study) -> None:  # before the runs that the verdict takes
        head = filter(None, [options.describe(str(agents), timesteps, [plan]), note])
        say(*head, *_numbers(facts_with(study)))

    # Whoever audits records every step anyway: maps of it cost nothing more.
    maps = audit or picture is not None
    with studies.about(name), Bar("simulating") as bar:
        study = examine(plan, config, options.seeds, audit, maps, verdict, bar, log_runs)
    facts, judgement = facts_with(study), ""
    if "verdict" in facts:
        judgement = f": {facts['verdict']}, {facts['verdict_reason']}"
        say(f"verdict      {facts['verdict']}: {facts['verdict_reason']}")
    say(*_jams(facts, plan))
    if picture:
        from qdenv.view.style import format_name  # imports matplotlib
        from qdenv.view.traffic import draw_traffic, make_scene

        title = f"{format_name(plan.name)}, {agents} agents{judgement}"
        scene = make_scene(plan, study, options.stop)
        picture.draw(draw_traffic(scene, title, width or SCREEN))
    return Result(facts | {"settings": options.settings(timesteps, [plan])})


def _numbers(facts: Mapping[str, Any]) -> list[str]:
    """Describe the throughput of the runs and their mean, and what the runs took."""
    lines = []
    for run in facts["runs"]:
        jam = f", congested at {run['congested_at']}" if run["congested"] else ""
        lines.append(f"seed {run['seed']}: {run['throughput']:.3f} tasks per timestep{jam}")
    error = facts["standard_error"]
    band = f" +- {error:.3f} (standard error)" if np.isfinite(error) else ""
    hour = f", {facts['tasks_per_hour']:,.0f} tasks per hour" if "tasks_per_hour" in facts else ""
    lines.append(f"throughput   {facts['mean_of_all']:.3f}{band} tasks per timestep{hour}")
    smooth, rate = facts["mean_throughput"], facts["success_rate"]
    if rate < 1:
        others = "" if smooth is None else f"; the others move {smooth:.3f}"
        after = others if facts["stop"] else ", and went on"
        lines.append(f"congested    {1 - rate:.0%} of the runs{after}")
    checked = "every trajectory valid, " if facts["valid"] else ""
    took = f"{checked}{facts['cpu_seconds_per_run']:.2f} CPU s per run"
    lines.append(f"computed     {took}, compiled in {facts['compile_seconds']:.1f} s")
    return lines + facts["broken"]


def _jams(facts: Mapping[str, Any], plan: Plan) -> list[str]:
    """Describe how much agents wait and travel, and the worst cells."""
    steps, lines = facts["steps_per_task"], []
    if steps is not None:
        lines.append(f"travelled    {steps:.1f} steps per task")
    if "worst_cells" not in facts:
        return lines
    # Half of the waiting on few of all cells that agents can reach is a jam at one place.
    free = plan.domain.drivable(plan.layout).sum()
    half = facts["cells_with_half_of_waiting"]
    where = f", half of it on {half} of {free} free cells" if half else ""
    lines.append(f"waiting      {facts['waiting_share']:.1%} of the agents' time{where}")
    if not facts["worst_cells"]:
        return lines
    names = [plan.domain.names.get(tile, repr(tile)) for tile in plan.domain.tiles]
    table = [("rank", "row", "column", "tile", "of all waiting", "an agent waits", "per visit")]
    for rank, spot in enumerate(facts["worst_cells"], 1):
        share, waiting = f"{spot['share']:.2%}", f"{spot['waiting']:.0%} of time"
        cell = (str(rank), str(spot["row"]), str(spot["column"]), names[spot["tile"]])
        table.append((*cell, share, waiting, f"{spot['wait_per_visit']:3.1f} steps"))
    head = "the cells with the most waiting; rows and columns are counted from 0 at the top left:"
    return [*lines, head, *format_table(table)]


def sweep(
    layout: args.Source, agents: args.Counts = None, **study: Unpack[args.StudyOptions]
) -> Table:
    """Simulate a layout with more and more agents: throughput, its peak, and how many are worth it.

    Args:
        layout: layout file.
        agents: numbers of agents, as 50:400:50, which it is unless given, or 50,100,200; more at a
            size for which more are known.
        **study: see `StudyOptions`.

    Returns:
        a `study.table.Row` for each number of agents.

    Raises:
        InputError: a number or a name is impossible, or a file cannot be read or written.
    """
    name = f"{Path(args.name_of(layout)).stem}_sweep"
    fleets = _Fleets([layout], agents, SWEEP, name, study)
    with Bar("simulating") as bar:
        rows = studies.compare(fleets.floors, fleets.trial, fleets.show, bar)
    # Numbers of agents may be stated in any order; the peak is read along ascending ones.
    rows.sort(key=lambda row: row.agents)
    peak, worth = find_peak(rows), find_capacity(rows)
    say(fleets.describe_peak(peak))
    say(f"worth it: up to {worth} agents each further one brings half an average one or more")
    return fleets.finish(rows, {"peak": peak._asdict(), "worth_it_up_to": worth})


def compare(
    layouts: args.Sources, agents: args.Counts = None, **study: Unpack[args.StudyOptions]
) -> Table:
    """Put layouts side by side: throughput, success rate, and how surely they differ in per cent.

    Args:
        layouts: layout files; all others are compared with the first.
        agents: numbers of agents, as 200 or 50,100 or 50:400:50; 200, or what is known of the
            layouts' size, unless given.
        **study: see `StudyOptions`.

    Returns:
        a `study.table.Row` for each layout and number of agents.

    Raises:
        InputError: no layout is given, they are of several domains, or a fleet cannot work there.
    """
    fleets = _Fleets(layouts, agents, (AGENTS, AGENTS, 1), "compare", study)
    with Bar("simulating") as bar:
        rows = studies.compare(fleets.floors, fleets.trial, fleets.show, bar)
    against, first = differences(rows), rows[0].layout
    if len(fleets.floors) > 1:
        say(f"against {first}, over all runs, with 95 % interval (Welch, Fieller):")
    for row, (percent, low, high, significant) in zip(rows, against, strict=True):
        if row.layout != first:
            sure = "significant" if significant else "may be chance"
            interval = f"({low:+.1f} to {high:+.1f}), {sure}"
            if np.isnan(low):
                interval = "(too few runs for an interval)"
            say(f"{row.layout}, {row.agents} agents: {percent:+.1f} % {interval}")
    names = [f"difference_{name}" for name in Difference._fields[:3]] + ["significant"]
    columns = dict(zip(names, zip(*against, strict=True), strict=True))
    return fleets.finish(rows, {}, columns)


def scalability(
    layouts: args.Sources, agents: args.Counts = None, **study: Unpack[args.StudyOptions]
) -> Table:
    """Add agents until the mean throughput drops; report the peak and where it is.

    Args:
        layouts: layout files, of one size or of several.
        agents: numbers of agents to try in turn, 50:1000:50 unless given, more at a size for which
            more are known; those that do not fit are left out.
        **study: see `StudyOptions`.

    Returns:
        a `study.table.Row` for each layout and number of agents.

    Raises:
        InputError: no layout is given, they are of several domains, or a fleet cannot work there.
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
    peaks = [find_peak(rows) for rows in climbs]
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
    ) -> None:
        """Check everything before anything is simulated.

        Without `agents` their numbers are those of `default`: first, last and step, on layouts for
        which 200 agents are usual. `name` is that of the table, unless `study` states another.
        """
        options, self._width = args.Fleet(study), study.get("width") or PAGE
        stated = (agents,) if isinstance(agents, int) else tuple(agents or ())
        options.config(max(stated, default=1))  # refuses what makes no simulation
        self._table, self._picture = place_table(study.get("out"), study.get("plot"), name, layouts)
        plans = _read_plans(layouts, options)
        first, drawn = next(iter(plans.values())), [plan.layout for plan in plans.values()]
        largest = max(stated, default=None)
        usual, timesteps, note = usual_fleet(first.domain, drawn, largest, options.timesteps)
        # Larger known sizes are usual with more agents: the range grows in proportion.
        begin, end, step = (round(one * usual / AGENTS) for one in default)
        counts = stated or tuple(range(begin, end + 1, step))
        config = options.config(max(counts), timesteps)
        self.floors = {name: plan.floor for name, plan in plans.items()}
        self.trial = studies.Trial(first.domain.simulator.tasks, config, counts, options.seeds)
        self._per_hour = options.per_hour
        self._settings = options.settings(timesteps, [*plans.values()]) | {
            "agents": list(counts),
            "layouts": dict(zip(plans, map(args.name_of, layouts), strict=True)),
        }
        # A range is written as a range, so that the command line can be read off the line.
        written, steps = ",".join(map(str, counts)), {b - a for a, b in pairwise(counts)}
        if len(counts) > 2 and len(steps) == 1:
            written = f"{counts[0]}:{counts[-1]}:{steps.pop()}"
        # Columns fit the names of the layouts.
        self._long = max(6, *map(len, plans))
        hour = "  tasks/hour" if self._per_hour else ""
        head = "  size     agents  throughput (s.e.)  success (95 %)    mean of all"
        lines = [options.describe(written, timesteps, [*plans.values()]), note]
        self._head = [*filter(None, lines), f"{'layout':{self._long}}{head}{hour}"]

    def show(self, row: Row) -> None:
        """Log a row, the first one below a head."""
        size, error = f"{row.rows}x{row.cols}", f"({row.standard_error:.3f})"
        bounds = f"({row.success_low:.0%} to {row.success_high:.0%})"
        tasks = f"  {row.mean_of_all * self._per_hour:10,.0f}" if self._per_hour else ""
        say(
            *self._head,
            f"{row.layout:{self._long}}  {size:8} {row.agents:6}  {row.throughput:8.3f} {error:8} "
            f" {row.success_rate:4.0%} {bounds:14} {row.mean_of_all:9.3f}{tasks}",
        )
        self._head = []

    def describe_peak(self, peak: Peak) -> str:
        """Return in a line how much a layout moves at most."""
        rate = self._per_hour
        hour = f" ({peak.throughput * rate:,.0f} per hour)" if rate else ""
        end = "" if peak.dropped else ", still rising at the last number of agents: try more"
        most = f"peak {peak.throughput:.3f} tasks per timestep{hour}"
        return f"{peak.layout}: {most} at {peak.agents} agents{end}"

    def finish(
        self,
        rows: Sequence[Row],
        facts: Mapping[str, Any],
        columns: Mapping[str, Sequence[Any]] | None = None,
        peaks: Sequence[Peak] = (),
    ) -> Table:
        """Write the table and the picture, warn of jams that build up, collect the facts.

        The table has further `columns` beside the rows' own. The picture shows how layouts
        scale if there are `peaks`, else it puts them side by side.
        """
        columns = dict(columns or {})
        if self._per_hour:
            columns["tasks_per_hour"] = [row.mean_of_all * self._per_hour for row in rows]
        if self._table:
            write_rows(self._table.path, rows, columns)
        if self._picture:
            from qdenv.view.studies import draw_comparison, draw_peaks  # imports matplotlib
            from qdenv.view.style import save_figure

            width = self._width
            figure = draw_peaks(rows, peaks, width) if peaks else draw_comparison(rows, width)
            save_figure(figure, self._picture.path)
        for row in [row for row in rows if row.fading > FADING][:_MOST_WARNINGS]:
            say(
                f"{row.layout}: with {row.agents} agents a jam builds up, throughput falls by "
                f"{row.fading:.0%} with time: more timesteps show where that ends"
            )
        say(*filter(None, [", ".join(str(one) for one in (self._table, self._picture) if one)]))
        lines = [
            row._asdict() | {name: values[number] for name, values in columns.items()}
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
