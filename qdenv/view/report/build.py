"""From a finished study of a fleet to the page and its facts."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

from qdenv.simulate.mapf.choosing import describe_planner
from qdenv.study.traffic import facts_of
from qdenv.view.page import Page, make_page
from qdenv.view.report import sections
from qdenv.view.report import text as words
from qdenv.view.report.blocks import made_line, settings_section
from qdenv.view.report.fleet import Found
from qdenv.view.report.sections import search_sections
from qdenv.view.report.subjects import Subject


class Report(NamedTuple):
    """A report that is done."""

    page: Page  # to save or to look at
    facts: dict[str, Any]  # all its numbers, JSON-ready; the page holds them, too


def fleet_report(found: Found, again: str = "") -> Report:
    """Make the page of a study of layouts in which a fleet drives.

    Args:
        found: the study.
        again: the command line that makes the page again.
    """
    subjects = found.asked.subjects
    names = words.listed([one.name for one in subjects])
    title = f"{names}: {found.agents} robots"
    facts = fleet_facts(found)
    parts = [
        sections.asked_section(found),
        *search_sections(subjects),
        sections.layouts_section(subjects),
        sections.throughput_section(found),
        sections.success_section(found),
        *sections.traffic_sections(found),
        *sections.rival_sections(found),
        settings_section(_settings(found), again),
    ]
    page = make_page("report", title, facts=facts, sections=parts, made=made_line())
    return Report(page, facts)


def fleet_facts(found: Found) -> dict[str, Any]:
    """List the numbers of a report as `qdenv simulate`, `sweep` and `compare` name them."""
    asked = found.asked
    layouts = {}
    for one, study, rival in zip(asked.subjects, found.studies, asked.rivals, strict=True):
        against = None
        if rival.layout is not None:
            pairs = zip(found.rows_of(one.name), found.rows_of(rival.name), strict=True)
            against = {
                "layout": rival.name,
                "about": rival.about,
                "differences": [
                    {"agents": ours.agents, **words.compare_rows(ours, theirs)._asdict()}
                    for ours, theirs in pairs
                ],
            }
        facts = facts_of(study, one.layout) | {"source": one.source, "hand_made": against}
        layouts[one.name] = facts
    return {
        "agents": found.agents,
        "layouts": layouts,
        "rows": [row._asdict() for row in found.rows],
    }


def _settings(found: Found) -> Mapping[str, str]:
    asked, config = found.asked, found.asked.config
    return {
        **{f"floor plan {one.name}": one.source for one in asked.subjects},
        "domain": whose(asked.subjects[0]),
        "robots": words.listed([str(count) for count in asked.counts]),
        "looked at closely with": f"{found.agents} robots",
        "timesteps": f"{config.timesteps:,}",
        "seeds": words.listed([str(seed) for seed in asked.seeds]),
        "planner": describe_planner(config.planner),
        "stop at congestion": "yes" if config.stop_when_congested else "no",
        **({"timesteps per hour": f"{asked.per_hour:g}"} if asked.per_hour else {}),
    }


def whose(subject: Subject) -> str:
    """Say whose layout it is, and where that is an assumption."""
    assumed = " (assumed from the tiles)" if subject.plan.assumed else ""
    return f"{subject.plan.domain.name}{assumed}"
