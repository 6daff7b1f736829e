"""Studies: layouts with several numbers of agents, and how well a surrogate predicts elites."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any, Unpack

import numpy as np

from qdenv.ops import options as args
from qdenv.ops.output import Table, place_table, say
from qdenv.progress import Bar
from qdenv.stats import Difference
from qdenv.study import table as studies
from qdenv.study.options import AGENTS, usual_fleet
from qdenv.study.plans import Plan
from qdenv.study.recordings import FADING
from qdenv.study.table import Peak, Row, differences, find_capacity, find_peak, write_rows
from qdenv.types import InputError
from qdenv.view import PAGE

# Numbers of agents unless given, on layouts for which 200 are usual: first, last, step.
SWEEP, CLIMB = (50, 400, 50), (50, 1000, 50)
_MOST_WARNINGS = 3


def sweep(
    layout: args.Source,
    agents: args.Counts = None,
    out: args.Out = None,
    plot: args.Picture = None,
    width: args.Width = None,
    **fleet: Unpack[args.FleetOptions],
) -> Table:
    """Simulate a layout with more and more agents: throughput, its peak, and how many are worth it.

    Args:
        layout: layout file.
        agents: numbers of agents, as 50:400:50, which it is unless given, or 50,100,200; more at a
            size for which more are known.
        out: CSV file to write; named after the layout unless given.
        plot: picture to write; beside the table unless given.
        width: of the picture in inches.
        **fleet: see `FleetOptions`.

    Returns:
        a `study.table.Row` for each number of agents.

    Raises:
        InputError: a number or a name is impossible, or a file cannot be read or written.
    """
    name = f"{Path(args.name_of(layout)).stem}_sweep"
    study = _Study([layout], agents, SWEEP, fleet, out, name, plot)
    with Bar("simulating") as bar:
        rows = studies.compare(study.layouts, study.trial, study.show, bar)
    # Numbers of agents may be stated in any order; the peak is read along ascending ones.
    rows.sort(key=lambda row: row.agents)
    peak, worth = find_peak(rows), find_capacity(rows)
    say(study.describe_peak(peak))
    say(f"worth it: up to {worth} agents each further one brings half an average one or more")
    return study.finish(rows, width, {"peak": peak._asdict(), "worth_it_up_to": worth})


def compare(
    layouts: args.Sources,
    agents: args.Counts = None,
    out: args.Out = None,
    plot: args.Picture = None,
    width: args.Width = None,
    **fleet: Unpack[args.FleetOptions],
) -> Table:
    """Put layouts side by side: throughput, success rate, and how surely they differ in per cent.

    Args:
        layouts: layout files; all others are compared with the first.
        agents: numbers of agents, as 200 or 50,100 or 50:400:50; 200, or what is known of the
            layouts' size, unless given.
        out: CSV file to write; compare.csv unless given.
        plot: picture to write; beside the table unless given.
        width: of the picture in inches.
        **fleet: see `FleetOptions`.

    Returns:
        a `study.table.Row` for each layout and number of agents.

    Raises:
        InputError: no layout is given, they are of several domains, or a fleet cannot work there.
    """
    study = _Study(layouts, agents, (AGENTS, AGENTS, 1), fleet, out, "compare", plot)
    with Bar("simulating") as bar:
        rows = studies.compare(study.layouts, study.trial, study.show, bar)
    against, first = differences(rows), rows[0].layout
    if len(study.layouts) > 1:
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
    return study.finish(rows, width, {}, columns)


def scalability(
    layouts: args.Sources,
    agents: args.Counts = None,
    out: args.Out = None,
    plot: args.Picture = None,
    width: args.Width = None,
    **fleet: Unpack[args.FleetOptions],
) -> Table:
    """Add agents until the mean throughput drops; report the peak and where it is.

    Args:
        layouts: layout files, of one size or of several.
        agents: numbers of agents to try in turn, 50:1000:50 unless given, more at a size for which
            more are known; those that do not fit are left out.
        out: CSV file to write; scalability.csv unless given.
        plot: picture to write; beside the table unless given.
        width: of the picture in inches.
        **fleet: see `FleetOptions`.

    Returns:
        a `study.table.Row` for each layout and number of agents.

    Raises:
        InputError: no layout is given, they are of several domains, or a fleet cannot work there.
    """
    study = _Study(layouts, agents, CLIMB, fleet, out, "scalability", plot)
    # All layouts are checked before hours go into the first one.
    for name, layout in study.layouts.items():
        studies.check_climb(name, layout, study.trial)
    with Bar("simulating") as bar:
        climbs = [
            studies.climb(name, layout, study.trial, study.show, bar)
            for name, layout in study.layouts.items()
        ]
    peaks = [find_peak(rows) for rows in climbs]
    say(*map(study.describe_peak, peaks))
    facts = {"peaks": [peak._asdict() for peak in peaks]}
    return study.finish([row for rows in climbs for row in rows], width, facts, peaks=peaks)


class _Study:
    """A study of several runs: what is simulated, and what is logged, written and drawn of it."""

    def __init__(
        self,
        layouts: Sequence[Any],
        agents: Any,
        default: tuple[int, ...],
        fleet: Mapping[str, Any],
        out: Any,
        name: str,
        plot: Any,
    ) -> None:
        """Check everything before anything is simulated.

        Without `agents` their numbers are those of `default`: first, last and step, on layouts for
        which 200 agents are usual. `name` is that of the table, unless `out` states another.
        """
        options = args.Fleet(fleet)
        stated = (agents,) if isinstance(agents, int) else tuple(agents or ())
        options.config(max(stated, default=1))  # refuses what makes no simulation
        self._table, self._picture = place_table(out, plot, name, layouts)
        plans = _read_plans(layouts, options.domain)
        first, drawn = next(iter(plans.values())), [plan.layout for plan in plans.values()]
        largest = max(stated, default=None)
        usual, timesteps, note = usual_fleet(first.domain, drawn, largest, options.timesteps)
        # Larger known sizes are usual with more agents: the range grows in proportion.
        begin, end, step = (round(one * usual / AGENTS) for one in default)
        counts = stated or tuple(range(begin, end + 1, step))
        config = options.config(max(counts), timesteps)
        self.layouts = {name: plan.layout for name, plan in plans.items()}
        self.trial = studies.Trial(first.domain.simulator.tasks, config, counts, options.seeds)
        self._per_hour = options.per_hour
        self._settings = options.settings(timesteps) | {
            "agents": list(counts),
            "layouts": dict(zip(plans, map(args.name_of, layouts), strict=True)),
        }
        # A range is written as a range, so that the command line can be read off the line.
        written, steps = ",".join(map(str, counts)), {b - a for a, b in pairwise(counts)}
        if len(counts) > 2 and len(steps) == 1:
            written = f"{counts[0]}:{counts[-1]}:{steps.pop()}"
        # Columns fit the names of the layouts.
        self._width = max(6, *map(len, plans))
        hour = "  tasks/hour" if self._per_hour else ""
        head = "  size     agents  throughput (s.e.)  success (95 %)    mean of all"
        lines = [options.describe(written, timesteps, first), note]
        self._head = [*filter(None, lines), f"{'layout':{self._width}}{head}{hour}"]

    def show(self, row: Row) -> None:
        """Log a row, the first one below a head."""
        size, error = f"{row.rows}x{row.cols}", f"({row.standard_error:.3f})"
        bounds = f"({row.success_low:.0%} to {row.success_high:.0%})"
        tasks = f"  {row.mean_of_all * self._per_hour:10,.0f}" if self._per_hour else ""
        say(
            *self._head,
            f"{row.layout:{self._width}}  {size:8} {row.agents:6}  {row.throughput:8.3f} {error:8} "
            f" {row.success_rate:4.0%} {bounds:14} {row.mean_of_all:9.3f}{tasks}",
        )
        self._head = []

    def describe_peak(self, peak: Peak) -> str:
        """Return in a line how much a layout moves at most."""
        per_hour = self._per_hour
        hour = f" ({peak.throughput * per_hour:,.0f} per hour)" if per_hour else ""
        end = "" if peak.dropped else ", still rising at the last number of agents: try more"
        return (
            f"{peak.layout}: peak {peak.throughput:.3f} tasks per timestep{hour} "
            f"at {peak.agents} agents{end}"
        )

    def finish(
        self,
        rows: Sequence[Row],
        width: float | None,
        facts: Mapping[str, Any],
        columns: Mapping[str, Sequence[Any]] | None = None,
        peaks: Sequence[Peak] = (),
    ) -> Table:
        """Write the table and the picture, warn of jams that build up, collect the facts.

        The table has further `columns` beside the rows' own. The picture, `width` inches wide,
        shows how layouts scale if there are `peaks`, else it puts them side by side.
        """
        columns = dict(columns or {})
        if self._per_hour:
            columns["tasks_per_hour"] = [row.mean_of_all * self._per_hour for row in rows]
        if self._table:
            write_rows(self._table.path, rows, columns)
        if self._picture:
            from qdenv.view.studies import draw_comparison, draw_peaks  # imports matplotlib
            from qdenv.view.style import save_figure

            size = width or PAGE
            figure = draw_peaks(rows, peaks, size) if peaks else draw_comparison(rows, size)
            save_figure(figure, self._picture.path)
        for row in [row for row in rows if row.fading > FADING][:_MOST_WARNINGS]:
            say(
                f"{row.layout}: with {row.agents} agents a jam builds up, throughput falls by "
                f"{row.fading:.0%} with time: more timesteps show where that ends"
            )
        if written := [str(one) for one in (self._table, self._picture) if one]:
            say(", ".join(written))
        lines = [
            row._asdict() | {name: values[number] for name, values in columns.items()}
            for number, row in enumerate(rows)
        ]
        return Table(rows, {**facts, "rows": lines, "settings": self._settings})


def _read_plans(layouts: Sequence[Any], domain: str | None) -> dict[str, Plan]:
    """Read layouts of one domain, by names: briefly where that tells them apart."""
    if not layouts:
        raise InputError("give at least one layout file")
    plans = [args.read_plan(layout, domain) for layout in layouts]
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
