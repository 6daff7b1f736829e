"""The tables of traffic studies: what is asked is checked first, rows are printed as they come."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from qdenv.commands import output, words
from qdenv.commands.choices import FleetOptions
from qdenv.study import sweep as studies
from qdenv.study.congestion import FADING
from qdenv.study.options import AGENTS, parse_counts, parse_seeds, scale_counts, usual_fleet
from qdenv.study.plans import Plan, read_plan
from qdenv.study.table import Peak, Row, write_rows
from qdenv.types import InputError

MOST_WARNINGS = 3


class Study(NamedTuple):
    """What a command was asked for, checked."""

    plans: dict[str, Plan]  # of all layouts, by name
    trial: studies.Trial  # what they are put to
    per_hour: float | None  # timesteps per hour; None where nobody said
    table: output.Place  # where the table goes
    picture: output.Place  # where the picture goes
    facts: Path | None  # where the facts go; None for nowhere
    settings: dict[str, Any]  # what facts are found with
    said: str  # what is simulated, in words

    @property
    def layouts(self) -> dict[str, np.ndarray]:
        """All layouts by name, int8 [H, W] each."""
        return {name: plan.layout for name, plan in self.plans.items()}


def prepare(
    paths: Sequence[Path],
    agents: tuple[str | None, str],
    options: FleetOptions,
    out: tuple[Path | None, str],
    plot: Path | None,
    json_file: Path | None,
) -> Study:
    """Check everything a command was told before anything is simulated.

    Args:
        paths: layout files.
        agents: numbers of agents in words, and those where nobody says, for layouts on which 200
            are usual.
        options: who drives.
        out: where the table shall go, and its default name.
        plot: where the picture shall go; None or without a name: beside the table.
        json_file: where the facts go.

    Raises:
        InputError: a number or a name means nothing, or a file cannot be read or written.
    """
    stated = () if agents[0] is None else parse_counts(agents[0])
    seeds, per_hour = parse_seeds(options.seeds), words.steps_per_hour(options)
    options.fleet(max(stated, default=1))  # refuses what makes no simulation
    table = output.place(*out, (".csv",), paths)
    picture = words.place_picture(plot or words.AUTO, f"{table.path.stem}.png", paths)
    if out[0] is not None and plot in (None, words.AUTO):
        picture = table.beside(".png")
    assert picture is not None
    plans = read_plans(paths, options.domain)
    first = next(iter(plans.values()))
    drawn = [plan.layout for plan in plans.values()]
    usual = usual_fleet(first.domain, drawn, max(stated, default=None), options.timesteps)
    options = replace(options, timesteps=usual.timesteps)
    text = agents[0] or scale_counts(agents[1], usual.agents / AGENTS)
    counts = parse_counts(text)
    trial = studies.Trial(first.domain.simulator.tasks, options.fleet(max(counts)), counts, seeds)
    settings = words.settings_of(options, seeds) | {"agents": list(counts)}
    settings["layouts"] = {name: str(path) for name, path in studies.name_layouts(paths).items()}
    said = words.describe_study(text, options, seeds, first)
    said += f"\n{usual.said}" if usual.said else ""
    return Study(plans, trial, per_hour, table, picture, json_file, settings, said)


def read_plans(paths: Sequence[Path], domain: str | None) -> dict[str, Plan]:
    """Read layouts of one domain, by name.

    Raises:
        InputError: none is given, one cannot be read, or they are of several domains.
    """
    if not paths:
        raise InputError("give at least one layout file")
    plans = {name: read_plan(path, domain) for name, path in studies.name_layouts(paths).items()}
    kinds = {plan.domain.name: plan for plan in plans.values()}
    if len(kinds) > 1:
        raise InputError(f"these are layouts of {' and '.join(kinds)}: put one domain side by side")
    return plans


def write(
    study: Study,
    rows: Sequence[Row],
    command: str,
    size: dict[str, float],
    facts: dict[str, Any],
    columns: Mapping[str, Sequence[Any]] | None = None,
    peaks: Sequence[Peak] = (),
) -> None:
    """Write the table, the picture and the facts of a study, and say so.

    Args:
        study: what was asked for.
        rows: of the table.
        command: its name.
        size: of the picture, as its width in inches.
        facts: beyond the rows.
        columns: of the table, beyond those of its rows.
        peaks: to draw how layouts scale; without any, layouts are put side by side.
    """
    # Only here: matplotlib takes half a second to import.
    from qdenv.view.studies import draw_comparison, draw_peaks
    from qdenv.view.style import save_figure

    columns = dict(columns or {})
    if study.per_hour:
        columns["tasks_per_hour"] = [row.mean_of_all * study.per_hour for row in rows]
    write_rows(study.table.path, rows, columns)
    figure = draw_peaks(rows, peaks, **size) if peaks else draw_comparison(rows, **size)
    save_figure(figure, study.picture.path)
    falling = [row for row in rows if row.fading > FADING]
    for row in falling[:MOST_WARNINGS]:
        print(
            f"{row.layout}: with {row.agents} agents a jam builds up, throughput falls by "
            f"{row.fading:.0%} with time: more timesteps show where that ends"
        )
    print(f"{study.table}, {study.picture}")
    lines = [
        row._asdict() | {name: values[place] for name, values in columns.items()}
        for place, row in enumerate(rows)
    ]
    output.write_facts(study.facts, command, {**facts, "rows": lines}, **study.settings)


def table_printer(study: Study, say: Callable[[str], None]) -> Callable[[Row], None]:
    """Print each row as it comes, and what is simulated above the first; columns fit the names."""
    width = max(6, *(len(name) for name in study.plans))
    hour = "  tasks/hour" if study.per_hour else ""
    head = (
        f"{study.said}\n{'layout':{width}}  size     agents  throughput (s.e.)  success (95 %)    "
        f"mean of all{hour}\n"
    )

    def show(row: Row) -> None:
        nonlocal head
        size, error = f"{row.rows}x{row.cols}", f"({row.standard_error:.3f})"
        bounds = f"({row.success_low:.0%} to {row.success_high:.0%})"
        tasks = f"  {row.mean_of_all * study.per_hour:10,.0f}" if study.per_hour else ""
        say(
            f"{head}{row.layout:{width}}  {size:8} {row.agents:6}  {row.throughput:8.3f} {error:8} "
            f" {row.success_rate:4.0%} {bounds:14} {row.mean_of_all:9.3f}{tasks}"
        )
        head = ""

    return show
