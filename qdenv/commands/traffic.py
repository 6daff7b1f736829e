"""Commands about the traffic of many runs: sweep, compare, scalability."""

from pathlib import Path

import numpy as np

from qdenv.commands import output, words
from qdenv.commands.choices import FleetOptions, LayoutFile, LayoutFiles, Options
from qdenv.commands.tables import prepare, table_printer, write
from qdenv.progress import Bar
from qdenv.stats import Difference
from qdenv.study import sweep as studies
from qdenv.study.table import Peak, differences, find_capacity, find_peak

# Numbers of agents where nobody says, on layouts for which 200 are usual.
SWEPT, COMPARED, CLIMBED = "50:400:50", "200", "50:1000:50"


def sweep(
    layout: LayoutFile,
    agents: str | None = None,
    options: Options = FleetOptions(),  # noqa: B008 (frozen)
    out: Path | None = None,
    plot: words.Picture = None,
    width: words.Width = None,
    json_file: output.JsonFile = None,
) -> None:
    """Simulate a layout with more and more agents: throughput, its peak, and how many are worth it.

    Args:
        layout: layout file.
        agents: numbers of agents, as 50:400:50, which it is unless given, or 50,100,200; more at a
            size for which more are known.
        options: who drives.
        out: CSV file to write; named after the layout unless given.
        plot: picture to write; beside the table unless given.
        width: of the picture: column or page of a journal, or inches; page unless given.
        json_file: where to write the numbers; - is standard output.
    """
    size = words.inches(width)
    study = prepare(
        [layout], (agents, SWEPT), options, (out, f"{layout.stem}_sweep.csv"), plot, json_file
    )
    with Bar("simulating") as bar:
        show = table_printer(study, bar.print)
        rows = studies.compare(study.layouts, study.trial, show, bar)
    rows.sort(key=lambda row: row.agents)
    peak, worth = find_peak(rows), find_capacity(rows)
    print(describe_peak(peak, study.per_hour))
    print(f"worth it: up to {worth} agents each further one brings half an average one or more")
    write(study, rows, "sweep", size, {"peak": peak._asdict(), "worth_it_up_to": worth})


def compare(
    layouts: LayoutFiles,
    agents: str | None = None,
    options: Options = FleetOptions(),  # noqa: B008 (frozen)
    out: Path | None = None,
    plot: words.Picture = None,
    width: words.Width = None,
    json_file: output.JsonFile = None,
) -> None:
    """Put layouts side by side: throughput, success rate, and how surely they differ in per cent.

    Args:
        layouts: layout files; all others are compared with the first.
        agents: numbers of agents, as 200 or 50,100 or 50:400:50; 200, or what is known of the
            layouts' size, unless given.
        options: who drives.
        out: CSV file to write; compare.csv unless given.
        plot: picture to write; beside the table unless given.
        width: of the picture: column or page of a journal, or inches; page unless given.
        json_file: where to write the numbers; - is standard output.
    """
    size = words.inches(width)
    study = prepare(layouts, (agents, COMPARED), options, (out, "compare.csv"), plot, json_file)
    with Bar("simulating") as bar:
        show = table_printer(study, bar.print)
        rows = studies.compare(study.layouts, study.trial, show, bar)
    against = differences(rows)
    first = rows[0].layout
    if len(study.plans) > 1:
        print(f"against {first}, over all runs, with 95 % interval (Welch, Fieller):")
    for row, found in zip(rows, against, strict=True):
        if row.layout != first:
            print(f"{row.layout}, {row.agents} agents: {describe_difference(found)}")
    columns = [f"difference_{name}" for name in Difference._fields[:3]] + ["significant"]
    write(
        study,
        rows,
        "compare",
        size,
        {},
        dict(zip(columns, zip(*against, strict=True), strict=True)),
    )


def scalability(
    layouts: LayoutFiles,
    agents: str | None = None,
    options: Options = FleetOptions(),  # noqa: B008 (frozen)
    out: Path | None = None,
    plot: words.Picture = None,
    width: words.Width = None,
    json_file: output.JsonFile = None,
) -> None:
    """Add agents until the mean throughput drops; report the peak and where it is.

    Args:
        layouts: layout files, of one size or of several.
        agents: numbers of agents to try in turn, 50:1000:50 unless given, more at a size for which
            more are known; those that do not fit are left out.
        options: who drives.
        out: CSV file to write; scalability.csv unless given.
        plot: picture to write; beside the table unless given.
        width: of the picture: column or page of a journal, or inches; page unless given.
        json_file: where to write the numbers; - is standard output.
    """
    size = words.inches(width)
    study = prepare(layouts, (agents, CLIMBED), options, (out, "scalability.csv"), plot, json_file)
    for name, layout in study.layouts.items():
        studies.check_climb(name, layout, study.trial)
    with Bar("simulating") as bar:
        show = table_printer(study, bar.print)
        climbs = [
            studies.climb(name, layout, study.trial, show, bar)
            for name, layout in study.layouts.items()
        ]
    peaks = [find_peak(rows) for rows in climbs]
    for peak in peaks:
        print(describe_peak(peak, study.per_hour))
    facts = {"peaks": [peak._asdict() for peak in peaks]}
    rows = [row for climb in climbs for row in climb]
    write(study, rows, "scalability", size, facts, peaks=peaks)


def describe_peak(peak: Peak, per_hour: float | None) -> str:
    """Say where a layout's throughput peaks."""
    hour = f" ({peak.throughput * per_hour:,.0f} per hour)" if per_hour else ""
    end = "" if peak.dropped else ", still rising at the last number of agents: try more"
    return (
        f"{peak.layout}: peak {peak.throughput:.3f} tasks per timestep{hour} "
        f"at {peak.agents} agents{end}"
    )


def describe_difference(found: Difference) -> str:
    """Say how much a layout moves more or less, and whether that may be chance."""
    if np.isnan(found.low):
        return f"{found.percent:+.1f} % (too few runs to say how sure)"
    sure = "significant" if found.significant else "may be chance"
    return f"{found.percent:+.1f} % ({found.low:+.1f} to {found.high:+.1f}), {sure}"
