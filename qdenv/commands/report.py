"""The command report: one page about floor plans, or the best one of a run, to send to somebody."""

from __future__ import annotations

import shlex
import sys
from importlib import util
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from qdenv import devices
from qdenv.commands import output, words
from qdenv.commands.choices import FleetOptions, Options
from qdenv.commands.costs import in_words
from qdenv.progress import Bar
from qdenv.study.options import parse_counts, parse_seeds
from qdenv.study.table import Row
from qdenv.types import InputError
from qdenv.view.page import missing
from qdenv.view.report.subjects import Subject, read_subjects

if TYPE_CHECKING:
    from qdenv.view.report.build import Report
    from qdenv.view.report.fleet import Asked

ENDINGS = (".html",)
PATIENCE = 20.0  # seconds from which on an estimate is worth a line

Sources = Annotated[tuple[Path, ...], tyro.conf.Positional, tyro.conf.arg(metavar="RUN|LAYOUT ...")]


def report(
    sources: Sources,
    agents: str | None = None,
    options: Options = FleetOptions(),  # noqa: B008 (frozen)
    out: Path | None = None,
    json_file: output.JsonFile = None,
) -> None:
    """Make a page to send to somebody: what floor plans move, where robots wait, how sure that is.

    Args:
        sources: layout files, and runs or zoo:DOMAIN/NAME, whose best layout is reported on.
        agents: number of agents (robots), 200 or what is known of the layout's size unless given;
            half as many to half as many again are simulated, too, unless several are given, as
            50,100 or 50:400:50: then those, and the first layout's peak is looked at closely.
        options: who drives.
        out: page to write (.html); report.html unless given.
        json_file: where to write the numbers; - is standard output.
    """
    if util.find_spec("jinja2") is None:
        raise missing("pages", "jinja2")
    files = [source for source in sources if source.is_file()]
    place = output.place(out, "report.html", ENDINGS, files)
    counts = () if agents is None else parse_counts(agents)
    seeds, per_hour = parse_seeds(options.seeds), words.steps_per_hour(options)
    options.fleet(max(counts, default=1))  # refuses what makes no simulation
    subjects = read_subjects(sources, options.domain)
    again = shlex.join(["qdenv", *sys.argv[1:]])
    if subjects[0].plan.domain.simulator.tasks is None:
        done = on_mazes(subjects, agents, options, again)
    else:
        # Only here: who is refused need not wait for what it imports.
        from qdenv.view.report.fleet import ask

        asked = ask(subjects, counts, options.timesteps, options.fleet_for, seeds)
        done = on_fleets(asked._replace(per_hour=per_hour), again)
    done.page.save(place.path)
    size = place.path.stat().st_size / 1e6
    print(f"{place}: {size:.1f} MB")
    settings = words.settings_of(options, seeds) | {"sources": [str(one) for one in sources]}
    output.write_facts(json_file, "report", done.facts, **settings)


def on_fleets(asked: Asked, again: str) -> Report:
    """Simulate, saying how long that will take, and make the page."""
    from qdenv.view.report.build import fleet_report
    from qdenv.view.report.fleet import seconds_for, study

    first = True
    with Bar("simulating") as bar:

        def told(row: Row) -> None:
            nonlocal first
            rest = seconds_for(asked, row, devices.threads())
            if first and rest > PATIENCE:
                bar.print(f"this takes about {in_words(rest)} in all (an estimate)")
            first = False
            rate = f"{row.success_rate:.0%} never congested"
            bar.print(f"{row.layout}, {row.agents} agents: {row.mean_of_all:.3f}, {rate}")

        found = study(asked, told, bar)
        bar.begin("drawing the page")
        done = fleet_report(found, again)
    for one, result in zip(asked.subjects, found.studies, strict=True):
        assert result.verdict is not None
        print(f"{one.name}, {found.agents} agents: {result.verdict.word}, {result.verdict.reason}")
    return done


def on_mazes(
    subjects: list[Subject], agents: str | None, options: FleetOptions, again: str
) -> Report:
    """Let the agent solve mazes, and make the page."""
    if agents is not None:
        raise InputError(f"--agents {agents}: no fleet drives in mazes: leave --agents out")
    from qdenv.view.report.mazes import maze_report, solve

    with Bar("solving mazes") as bar:
        return maze_report(solve(subjects, options.timesteps, bar), again)
