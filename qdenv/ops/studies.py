"""Operations that simulate layouts with several numbers of agents, or several layouts."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, Unpack

import numpy as np

from qdenv.ops.options import (
    Counts,
    Fleet,
    FleetOptions,
    Out,
    Picture,
    Source,
    Sources,
    Width,
    name_of,
    read_plan,
    stem_of,
)
from qdenv.ops.output import AUTO, PICTURES, Place, place, say
from qdenv.ops.results import Table
from qdenv.progress import Bar
from qdenv.stats import Difference
from qdenv.study import table as studies
from qdenv.study.options import AGENTS, usual_fleet
from qdenv.study.plans import Plan
from qdenv.study.recordings import FADING
from qdenv.study.table import Peak, Row, differences, find_capacity, find_peak, write_rows
from qdenv.types import InputError

if TYPE_CHECKING:  # imports the simulator
    pass

# Numbers of agents unless given, on layouts for which 200 are usual.
SWEEP, CLIMB = (50, 400, 50), (50, 1000, 50)  # first, last, step
_MOST_WARNINGS = 3


def sweep(
    layout: Source,
    agents: Counts = None,
    out: Out = None,
    plot: Picture = None,
    width: Width = None,
    **fleet: Unpack[FleetOptions],
) -> Table:
    """Simulate a layout with more and more agents: throughput, its peak, and how many are worth it.

    Args:
        layout: layout file.
        agents: numbers of agents, as 50:400:50, which it is unless given, or 50,100,200; more at a
            size for which more are known.
        out: CSV file to write; named after the layout unless given.
        plot: picture to write; beside the table unless given.
        width: of the picture: column or page of a journal, or inches; page unless given.
        **fleet: see `FleetOptions`.

    Returns:
        a `study.table.Row` for each number of agents.

    Raises:
        InputError: a number or a name is impossible, or a file cannot be read or written.
    """
    case = _prepare([layout], agents, SWEEP, fleet, (out, f"{stem_of(layout)}_sweep.csv", plot))
    with Bar("simulating") as bar:
        rows = studies.compare(case.layouts, case.trial, _row_printer(case), bar)
    rows.sort(key=lambda row: row.agents)
    peak, worth = find_peak(rows), find_capacity(rows)
    say(_describe_peak(peak, case.per_hour))
    say(f"worth it: up to {worth} agents each further one brings half an average one or more")
    return _finish(case, rows, width, {"peak": peak._asdict(), "worth_it_up_to": worth})


def compare(
    layouts: Sources,
    agents: Counts = None,
    out: Out = None,
    plot: Picture = None,
    width: Width = None,
    **fleet: Unpack[FleetOptions],
) -> Table:
    """Put layouts side by side: throughput, success rate, and how surely they differ in per cent.

    Args:
        layouts: layout files; all others are compared with the first.
        agents: numbers of agents, as 200 or 50,100 or 50:400:50; 200, or what is known of the
            layouts' size, unless given.
        out: CSV file to write; compare.csv unless given.
        plot: picture to write; beside the table unless given.
        width: of the picture: column or page of a journal, or inches; page unless given.
        **fleet: see `FleetOptions`.

    Returns:
        a `study.table.Row` for each layout and number of agents.

    Raises:
        InputError: no layout is given, they are of several domains, or a fleet cannot work there.
    """
    case = _prepare(layouts, agents, (AGENTS, AGENTS, 1), fleet, (out, "compare.csv", plot))
    with Bar("simulating") as bar:
        rows = studies.compare(case.layouts, case.trial, _row_printer(case), bar)
    against, first = differences(rows), rows[0].layout
    if len(case.layouts) > 1:
        say(f"against {first}, over all runs, with 95 % interval (Welch, Fieller):")
    for row, one in zip(rows, against, strict=True):
        if row.layout != first:
            say(f"{row.layout}, {row.agents} agents: {_describe_difference(one)}")
    names = [f"difference_{name}" for name in Difference._fields[:3]] + ["significant"]
    columns = dict(zip(names, zip(*against, strict=True), strict=True))
    return _finish(case, rows, width, {}, columns)


def scalability(
    layouts: Sources,
    agents: Counts = None,
    out: Out = None,
    plot: Picture = None,
    width: Width = None,
    **fleet: Unpack[FleetOptions],
) -> Table:
    """Add agents until the mean throughput drops; report the peak and where it is.

    Args:
        layouts: layout files, of one size or of several.
        agents: numbers of agents to try in turn, 50:1000:50 unless given, more at a size for which
            more are known; those that do not fit are left out.
        out: CSV file to write; scalability.csv unless given.
        plot: picture to write; beside the table unless given.
        width: of the picture: column or page of a journal, or inches; page unless given.
        **fleet: see `FleetOptions`.

    Returns:
        a `study.table.Row` for each layout and number of agents.

    Raises:
        InputError: no layout is given, they are of several domains, or a fleet cannot work there.
    """
    case = _prepare(layouts, agents, CLIMB, fleet, (out, "scalability.csv", plot))
    for name, layout in case.layouts.items():
        studies.check_climb(name, layout, case.trial)
    climbs = []
    with Bar("simulating") as bar:
        show = _row_printer(case)
        for name, layout in case.layouts.items():
            climbs.append(studies.climb(name, layout, case.trial, show, bar))
    peaks = [find_peak(rows) for rows in climbs]
    say(*(_describe_peak(peak, case.per_hour) for peak in peaks))
    facts = {"peaks": [peak._asdict() for peak in peaks]}
    return _finish(case, [row for rows in climbs for row in rows], width, facts, peaks=peaks)


class _Case(NamedTuple):
    """A study of several runs, checked."""

    layouts: dict[str, np.ndarray]  # all layouts by name, int8 [H, W] each
    trial: studies.Trial  # domain's tasks, numbers of agents, seeds
    per_hour: float | None  # timesteps per hour; None where their length is not given
    table: Place | None  # of the rows
    picture: Place | None  # of the study
    settings: dict[str, Any]  # for facts
    description: list[str]  # lines about what is simulated


def _prepare(
    layouts: Sequence[Any],
    agents: Any,
    default: tuple[int, ...],
    fleet: Mapping[str, Any],
    files: tuple[Any, str, Any],
) -> _Case:
    """Check everything before anything is simulated.

    Args:
        layouts: layout files, or layouts of another form.
        agents: a number of agents, or several; None for `default`.
        default: first, last and step of the numbers of agents, on layouts for which 200 are usual.
        fleet: the other options.
        files: the table, its default name, and the picture.
    """
    options, (out, default_name, plot) = Fleet(fleet), files
    stated = (agents,) if isinstance(agents, int) else tuple(agents or ())
    options.config(max(stated, default=1))  # refuses what makes no simulation
    table = None if out is None else place(out, default_name, (".csv",), layouts)
    picture = None
    if plot not in (None, AUTO):
        picture = place(plot, default_name, PICTURES, layouts)
    elif table is not None:
        named = out != AUTO
        picture = table.beside(".png") if named else place(AUTO, f"{table.path.stem}.png", PICTURES)
    plans = _read_plans(layouts, options.domain)
    first, drawn = next(iter(plans.values())), [plan.layout for plan in plans.values()]
    largest = max(stated, default=None)
    usual, timesteps, note = usual_fleet(first.domain, drawn, largest, options.timesteps)
    begin, end, step = (round(one * usual / AGENTS) for one in default)
    counts = stated or tuple(range(begin, end + 1, step))
    config = options.config(max(counts), timesteps)
    trial = studies.Trial(first.domain.simulator.tasks, config, counts, options.seeds)
    settings = options.settings(timesteps) | {"agents": list(counts)}
    settings["layouts"] = dict(zip(plans, map(name_of, layouts), strict=True))
    lines = [options.describe(_describe_counts(counts), timesteps, first), note]
    return _Case(
        {name: plan.layout for name, plan in plans.items()},
        trial,
        options.per_hour,
        table,
        picture,
        settings,
        [line for line in lines if line],
    )


def _read_plans(layouts: Sequence[Any], domain: str | None) -> dict[str, Plan]:
    """Read layouts of one domain, by names: briefly where that tells them apart."""
    if not layouts:
        raise InputError("give at least one layout file")
    plans = [read_plan(layout, domain) for layout in layouts]
    kinds = {plan.domain.name for plan in plans}
    if len(kinds) > 1:
        names = " and ".join(dict.fromkeys(plan.domain.name for plan in plans))
        raise InputError(f"these are layouts of {names}: put one domain side by side")
    brief, long = Counter(plan.name for plan in plans), Counter(map(name_of, layouts))
    named = {}
    for number, (plan, layout) in enumerate(zip(plans, layouts, strict=True), start=1):
        name = plan.name
        if brief[name] > 1:
            own = name_of(layout)
            name = own if isinstance(layout, str | Path) and long[own] == 1 else f"{name} {number}"
        named[name] = plan
    return named


def _describe_counts(counts: Sequence[int]) -> str:
    steps = {b - a for a, b in pairwise(counts)}
    if len(counts) > 2 and len(steps) == 1:
        return f"{counts[0]}:{counts[-1]}:{steps.pop()}"
    return ",".join(map(str, counts))


def _row_printer(case: _Case) -> Callable[[Row], None]:
    """Log each row as it comes, below a head; columns fit the names."""
    width = max(6, *(len(name) for name in case.layouts))
    hour = "  tasks/hour" if case.per_hour else ""
    head = f"{'layout':{width}}  size     agents  throughput (s.e.)  success (95 %)    mean of all"
    lines = [*case.description, head + hour]

    def show(row: Row) -> None:
        size, error = f"{row.rows}x{row.cols}", f"({row.standard_error:.3f})"
        bounds = f"({row.success_low:.0%} to {row.success_high:.0%})"
        tasks = f"  {row.mean_of_all * case.per_hour:10,.0f}" if case.per_hour else ""
        say(
            *lines,
            f"{row.layout:{width}}  {size:8} {row.agents:6}  {row.throughput:8.3f} {error:8} "
            f" {row.success_rate:4.0%} {bounds:14} {row.mean_of_all:9.3f}{tasks}",
        )
        lines.clear()

    return show


def _finish(
    case: _Case,
    rows: Sequence[Row],
    width: float | None,
    facts: dict[str, Any],
    columns: Mapping[str, Sequence[Any]] | None = None,
    peaks: Sequence[Peak] = (),
) -> Table:
    """Write the table and the picture of a study, warn of jams that build up, collect the facts.

    Args:
        case: what was simulated.
        rows: of the table.
        width: of the picture in inches.
        facts: beyond the rows.
        columns: of the table, beyond those of its rows.
        peaks: to draw how layouts scale; without any, layouts are drawn side by side.
    """
    columns = dict(columns or {})
    if case.per_hour:
        columns["tasks_per_hour"] = [row.mean_of_all * case.per_hour for row in rows]
    if case.table:
        write_rows(case.table.path, rows, columns)
    if case.picture:
        from qdenv.view.studies import draw_comparison, draw_peaks  # imports matplotlib
        from qdenv.view.style import save_figure

        size = {} if width is None else {"width": width}
        figure = draw_peaks(rows, peaks, **size) if peaks else draw_comparison(rows, **size)
        save_figure(figure, case.picture.path)
    for row in [row for row in rows if row.fading > FADING][:_MOST_WARNINGS]:
        say(
            f"{row.layout}: with {row.agents} agents a jam builds up, throughput falls by "
            f"{row.fading:.0%} with time: more timesteps show where that ends"
        )
    if case.table or case.picture:
        say(", ".join(str(one) for one in (case.table, case.picture) if one))
    lines = [
        row._asdict() | {name: values[number] for name, values in columns.items()}
        for number, row in enumerate(rows)
    ]
    return Table(rows, {**facts, "rows": lines, "settings": case.settings})


def _describe_peak(peak: Peak, per_hour: float | None) -> str:
    hour = f" ({peak.throughput * per_hour:,.0f} per hour)" if per_hour else ""
    end = "" if peak.dropped else ", still rising at the last number of agents: try more"
    return (
        f"{peak.layout}: peak {peak.throughput:.3f} tasks per timestep{hour} "
        f"at {peak.agents} agents{end}"
    )


def _describe_difference(difference: Difference) -> str:
    """Describe how much more or less a layout moves, and whether that may be chance."""
    percent, low, high, significant = difference
    if np.isnan(low):
        return f"{percent:+.1f} % (too few runs for an interval)"
    sure = "significant" if significant else "may be chance"
    return f"{percent:+.1f} % ({low:+.1f} to {high:+.1f}), {sure}"
