"""What reports on fleets and on mazes share; their sentences and tables are templates.

`templates/report.html` holds what all reports show, `report_fleet.html` and `report_maze.html` the
sections of each.
"""

import platform
from collections.abc import Sequence
from datetime import datetime
from importlib.metadata import version
from typing import Any

from qdenv import devices
from qdenv.run.directory import RunDirectory, package_versions
from qdenv.search.registry import ALGORITHMS
from qdenv.study.groups import algorithm_name, group_runs
from qdenv.view.archive import draw_archive, scatter_objectives
from qdenv.view.page import Page, make_page
from qdenv.view.report_subjects import Subject
from qdenv.view.runs import draw_progress
from qdenv.view.style import WARNING, new_figure, to_svg

WIDTH = 6.8  # inches of figures
_HEATMAP = 5.2  # inches of an archive
_PACKAGES = ("qdenv", "jax", "numpy", "numba", "highspy", "matplotlib")


def make_report(
    kind: str,
    title: str,
    subjects: Sequence[Subject],
    facts: dict[str, Any],
    command: str,
    **content: Any,
) -> Page:
    """Fill the template of a kind of reports, "fleet" or "maze".

    `facts` are the numbers of the page, `command` is the line that makes it again ("" for none),
    and `content` holds further variables of the template.
    """
    machine = f"{platform.system()} on {platform.machine()}, {devices.threads()} threads"
    versions = package_versions(_PACKAGES)
    versions |= {"Python": platform.python_version(), "machine": machine}
    return make_page(
        f"report_{kind}",
        title,
        facts=facts,
        subjects=subjects,
        searches=[_search(one, one.run, n) for n, one in enumerate(subjects) if one.run],
        versions=versions,
        command=command,
        qdenv_version=version("qdenv"),
        date=f"{datetime.now():%d %B %Y}",
        **content,
    )


def _search(subject: Subject, run: RunDirectory, number: int) -> dict[str, Any]:
    """Return what the page shows of the run that a layout comes from."""
    schema, archive, heat_svg = run.schema, run.archive, ""
    elite = archive.best
    if len(schema.measures) <= 2:
        heat = new_figure(_HEATMAP, 0.78 * _HEATMAP)
        objectives = scatter_objectives(archive.columns, schema.measures)
        draw_archive(heat, objectives, schema.measures, label=schema.objective)
        if run.shipped:
            # Only a selection of the elites ships: its share of cells says nothing.
            heat.axes[0].set_title("")
        # An archive of one measure is a strip, whose middle is at a height of 0.5.
        spot = [*elite.measures.values(), 0.5][:2]
        heat.axes[0].plot(*spot, "o", markersize=9, mfc="none", mec=WARNING, clip_on=False)
        heat_svg = to_svg(heat, f"archive-{number}")
    progress = draw_progress(group_runs([run]), schema.objective, WIDTH)
    return {
        "subject": subject,
        "elite": elite,
        "shipped": run.shipped.generator.about if run.shipped else "",
        "elites": len(archive),
        "algorithm": algorithm_name(ALGORITHMS.name_of(run.config.algorithm)),
        "archive": heat_svg,
        "progress": to_svg(progress, f"progress-{number}"),
        "seed": run.config.seed,
        "last": run.read_progress()[-1],
    }
