"""From a finished study of a fleet to the page and its facts; the page's sentences are templates.

`templates/report.html` holds what reports share, `report_fleet.html` and `report_maze.html` the
sections of each.
"""

from __future__ import annotations

import io
import platform
import re
from collections.abc import Mapping, Sequence
from datetime import datetime
from importlib.metadata import version
from typing import Any, NamedTuple

import numpy as np
from matplotlib import rc_context
from matplotlib.figure import Figure

from qdenv import devices
from qdenv.run.directory import package_versions
from qdenv.simulate.mapf.settings import describe_planner
from qdenv.stats import Difference, Sample, difference
from qdenv.study.groups import algorithm_name, group_runs
from qdenv.study.recordings import FADING, cells_with_half, worst_cells
from qdenv.study.table import Row, find_capacity, find_peak
from qdenv.study.traffic import Study, facts_of
from qdenv.view.archive import draw_archive, scatter_objectives
from qdenv.view.layouts import draw_plan
from qdenv.view.page import FILTERS, Page, make_page
from qdenv.view.report.fleet import Found
from qdenv.view.report.subjects import Rival, Subject, name_contents
from qdenv.view.runs import draw_progress
from qdenv.view.studies import draw_over_agents
from qdenv.view.style import FONTS, WARNING, new_figure
from qdenv.view.traffic import draw_panel, scene_of

WIDTH, MAP, HEATMAP = 6.8, 5.6, 5.2  # inches of figures, maps of floor plans, and archives
_TALL = 0.78  # of its width: the height of the heat map
_PACKAGES = ("qdenv", "jax", "numpy", "numba", "highspy", "matplotlib")

listed, interval, percent_range = (
    FILTERS[name] for name in ("listed", "interval", "percent_range")
)


class Report(NamedTuple):
    """A report that is done."""

    page: Page  # to save or to look at
    facts: dict[str, Any]  # all its numbers, JSON-ready; the page holds them, too


def make_report(
    template: str,
    title: str,
    facts: dict[str, Any],
    settings: Mapping[str, str],
    command: str,
    **content: Any,
) -> Report:
    """Fill a template of reports.

    Args:
        template: "report_fleet" or "report_maze".
        title: of the page.
        facts: the numbers of the page.
        settings: all that decides them, by their names.
        command: the command line that makes the page again; "" where there is none.
        **content: of the template.
    """
    machine = f"{platform.system()} on {platform.machine()}, {devices.threads()} threads"
    versions = package_versions(_PACKAGES)
    versions |= {"Python": platform.python_version(), "machine": machine}
    page = make_page(
        template,
        title,
        facts=facts,
        settings=[*settings.items(), *versions.items()],
        command=command,
        qdenv_version=version("qdenv"),
        date=f"{datetime.now():%d %B %Y}",
        **content,
    )
    return Report(page, facts)


def fleet_report(found: Found, again: str = "") -> Report:
    """Make the page of a study of layouts in which a fleet drives.

    Args:
        found: the study.
        again: the command line that makes the page again.
    """
    request, config = found.asked, found.asked.config
    subjects, facts = request.subjects, _fleet_facts(found)
    settings = {
        **{f"floor plan {one.name}": one.source for one in subjects},
        "domain": domain_of(subjects[0]),
        "robots": listed(request.counts),
        "looked at closely with": f"{found.agents} robots",
        "timesteps": f"{config.timesteps:,}",
        "seeds": listed(request.seeds),
        "planner": describe_planner(config.planner),
        "stop at congestion": "yes" if config.stop_when_congested else "no",
        **({"timesteps per hour": f"{request.per_hour:g}"} if request.per_hour else {}),
    }
    every = zip(subjects, found.studies, request.rivals, strict=True)
    return make_report(
        "report_fleet",
        f"{listed([one.name for one in subjects])}: {found.agents} robots",
        facts,
        settings,
        again,
        layouts=[_layout(found, place, *one) for place, one in enumerate(every)],
        searched=searches_of(subjects),
        agents=found.agents,
        at_peak=request.agents is None,
        other_counts=[count for count in request.counts if count != found.agents],
        timesteps=config.timesteps,
        runs=len(request.seeds),
        seeds=name_seeds(request.seeds),
        planner=settings["planner"],
        stop=config.stop_when_congested,
        per_hour=request.per_hour,
        note=request.said,
        throughput=to_svg(draw_over_agents(found.rows, width=WIDTH), "throughput-figure"),
        throughput_rows=_throughput_rows(found.rows, request.per_hour),
        fading=[row for row in found.rows if row.fading > FADING],
        success=to_svg(draw_over_agents(found.rows, True, WIDTH), "success-figure"),
        success_rows=[
            (
                row.layout,
                str(row.agents),
                f"{round(row.success_rate * row.runs)} of {row.runs}",
                f"{row.success_rate:.0%}",
                f"{row.success_low:.1%} to {row.success_high:.1%}",
            )
            for row in found.rows
        ],
    )


def _throughput_rows(rows: Sequence[Row], per_hour: float | None) -> list[list[str]]:
    """List the table of throughput, its head first."""
    head = ["floor plan", "robots", "tasks per timestep", "95 % interval", "standard error"]
    table = [head + ["tasks per hour"] * bool(per_hour)]
    for row in rows:
        error = "" if np.isnan(row.error_of_all) else f"{row.error_of_all:.3f}"
        cells = [row.layout, str(row.agents), f"{row.mean_of_all:.3f}", interval(row, 3), error]
        table.append(cells + ([f"{row.mean_of_all * per_hour:,.0f}"] if per_hour else []))
    return table


def _layout(
    found: Found, place: int, subject: Subject, study: Study, rival: Rival
) -> dict[str, Any]:
    """Collect what the page shows of one layout."""
    rows = sorted(found.rows_of(subject.name), key=lambda row: row.agents)
    row = found.row_at(subject.name)
    assert study.maps is not None
    scene = scene_of(subject.plan, study, subject.name, found.asked.config.stop_when_congested)
    names = subject.plan.domain.names
    tiles = [names.get(tile, repr(tile)) for tile in subject.plan.domain.tiles]
    content = {
        "name": subject.name,
        "title": f"{subject.name} ({subject.contents})",
        "caption": _caption(subject.name, subject.contents),
        "verdict": study.verdict,
        "row": row,
        "congested": row.runs - round(row.success_rate * row.runs),
        "peak": find_peak(rows) if len(rows) > 1 else None,
        "capacity": find_capacity(rows),
        "plan": _plan_svg(subject.layout, subject, f"plan-{place}"),
        "usage": to_svg(draw_panel(scene, "usage", MAP), f"usage-{place}"),
        "waiting": to_svg(draw_panel(scene, "waiting", MAP), f"waiting-figure-{place}"),
        "time": to_svg(draw_panel(scene, "time", WIDTH), f"time-{place}"),
        "waiting_share": study.maps.waiting_share,
        "half": cells_with_half(study.maps),
        "spots": [
            (
                str(rank),
                str(spot.row),
                str(spot.column),
                tiles[spot.tile],
                f"{spot.share:.2%}",
                f"{spot.waiting:.1%} of time",
                f"{spot.wait_per_visit:.1f} timesteps",
            )
            for rank, spot in enumerate(worst_cells(subject.layout, study.maps), 1)
        ],
        "rival": rival,
        "against": None,
        "rival_plan": "",
    }
    if rival.layout is None:
        return content
    numbers = subject.plan.domain.fitted(rival.layout).numbers
    return content | {
        "rival_row": found.row_at(rival.name),
        "against": _compare(row, found.row_at(rival.name)),
        "own_plan": _plan_svg(subject.layout, subject, f"own-{place}"),
        "rival_plan": _plan_svg(rival.layout, subject, f"rival-{place}"),
        "rival_caption": _caption(rival.name, name_contents(rival.layout, numbers)),
        "differences": [
            _difference_cells(ours, theirs)
            for ours, theirs in zip(
                found.rows_of(subject.name), found.rows_of(rival.name), strict=True
            )
        ],
    }


def _caption(name: str, contents: str) -> str:
    return f"{name}, {contents}; rows and columns are numbered from 0"


def _plan_svg(layout: np.ndarray, subject: Subject, name: str) -> str:
    domain = subject.plan.domain
    return to_svg(draw_plan(layout, domain.tiles, domain.names), name, crop=True)


def _compare(ours: Row, theirs: Row) -> Difference:
    """Compare two rows over all their runs, as `qdenv compare` does."""
    return difference(
        *(Sample(row.mean_of_all, row.error_of_all, row.runs) for row in (ours, theirs))
    )


def _difference_cells(ours: Row, theirs: Row) -> tuple[str, ...]:
    """Write by how much a layout moves more than the hand-made one."""
    apart = _compare(ours, theirs)
    known = not np.isnan(apart.low)  # there are several runs
    return (
        str(ours.agents),
        f"{ours.mean_of_all:.3f}",
        f"{theirs.mean_of_all:.3f}",
        "" if np.isnan(apart.percent) else f"{apart.percent:+.1f} %",
        percent_range(apart) if known else "",
        ("significant" if apart.significant else "may be chance") if known else "",
    )


def _fleet_facts(found: Found) -> dict[str, Any]:
    """List the numbers of a report as `qdenv simulate`, `sweep` and `compare` name them."""
    layouts = {}
    every = zip(found.asked.subjects, found.studies, found.asked.rivals, strict=True)
    for one, study, rival in every:
        against = None
        if rival.layout is not None:
            pairs = zip(found.rows_of(one.name), found.rows_of(rival.name), strict=True)
            against = {
                "layout": rival.name,
                "about": rival.about,
                "differences": [
                    {"agents": ours.agents, **_compare(ours, theirs)._asdict()}
                    for ours, theirs in pairs
                ],
            }
        facts = facts_of(study, one.layout) | {"source": one.source, "hand_made": against}
        layouts[one.name] = facts
    rows = [row._asdict() for row in found.rows]
    return {"agents": found.agents, "layouts": layouts, "rows": rows}


def name_seeds(seeds: Sequence[int]) -> str:
    """Write seeds briefly."""
    if len(seeds) == 1:
        return f"seed {seeds[0]}"
    if list(seeds) == list(range(len(seeds))):
        return f"seeds 0 to {seeds[-1]}"
    return f"seeds {listed(seeds)}"


def domain_of(subject: Subject) -> str:
    """Name the domain of a layout, and say where that is an assumption."""
    assumed = " (assumed from the tiles)" if subject.plan.assumed else ""
    return f"{subject.plan.domain.name}{assumed}"


def searches_of(subjects: Sequence[Subject]) -> list[dict[str, Any]]:
    """Collect what the page shows of the run of each layout that comes from one."""
    return [_search(one, place) for place, one in enumerate(subjects) if one.run is not None]


def _search(subject: Subject, place: int) -> dict[str, Any]:
    from qdenv.search.registry import ALGORITHMS  # imports an algorithm when one is looked up

    run, elite = subject.run, subject.elite
    assert run is not None and elite is not None
    schema, archive, heat_svg = run.schema, run.archive, ""
    if len(schema.measures) <= 2:
        heat = new_figure(HEATMAP, _TALL * HEATMAP)
        columns = archive.columns
        filled = scatter_objectives(columns["index"], columns["objective"], schema.measures)
        draw_archive(heat, filled, schema.measures, label=schema.objective)
        if run.shipped:
            heat.axes[0].set_title("")  # a selection ships: its share of cells says nothing
        spot = [*elite.measures.values(), 0.5][:2]
        heat.axes[0].plot(*spot, "o", markersize=9, mfc="none", mec=WARNING, clip_on=False)
        heat_svg = to_svg(heat, f"archive-{place}")
    progress = draw_progress(group_runs([run]), schema.objective, WIDTH)
    algorithm = algorithm_name(ALGORITHMS.name_of(run.config.algorithm))
    last = run.read_metrics()[-1]
    measures = ", ".join(f"{name} {value:.4g}" for name, value in elite.measures.items())
    return {
        "name": subject.name,
        "shipped": run.shipped.generator.about if run.shipped else "",
        "elites": len(archive),
        "algorithm": algorithm,
        "archive": heat_svg,
        "progress": to_svg(progress, f"progress-{place}"),
        "rows": [
            ("run", subject.source),
            ("domain", subject.plan.domain.name),
            ("algorithm", algorithm),
            ("seed", str(run.config.seed)),
            ("evaluations", f"{last.evaluations:,}"),
            ("QD-score", f"{last.qd_score:,.1f}"),
            ("coverage", f"{last.coverage:.1%}"),
            ("best objective", f"{last.best_objective:.3f}"),
            ("this layout", f"objective {elite.objective:.3f}, {measures}"),
        ],
    }


def to_svg(figure: Figure, name: str, crop: bool = False) -> str:
    """Turn a figure into vector graphics for a page.

    Args:
        figure: what to draw.
        name: begins all identifiers, which are unique within the page only so.
        crop: cut the picture to what is drawn.
    """
    content = io.StringIO()
    with rc_context(FONTS):
        box = "tight" if crop else None
        figure.savefig(content, format="svg", bbox_inches=box, metadata={"Date": None})
    svg = content.getvalue()
    svg = svg[svg.index("<svg") :]
    svg = re.sub(r'\bid="', f'id="{name}-', svg)
    svg = re.sub(r'(url\(#|href="#)', rf"\g<1>{name}-", svg)
    return re.sub(r"<metadata>.*?</metadata>", "", svg, flags=re.DOTALL)
