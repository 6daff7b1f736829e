"""The section of a report on the run of which the best layout is reported on."""

from __future__ import annotations

import numpy as np

from qdenv.study.congestion import cells_with_half, worst_cells
from qdenv.study.groups import algorithm_name, group_runs
from qdenv.study.traffic import Study
from qdenv.view.archive import draw_archive, scatter_objectives
from qdenv.view.layouts import draw_plan
from qdenv.view.report import text as words
from qdenv.view.report.blocks import Drawing, Section, Table, Text, drawing
from qdenv.view.report.fleet import Found
from qdenv.view.report.subjects import Rival, Subject
from qdenv.view.runs import draw_progress
from qdenv.view.studies import draw_over_agents
from qdenv.view.style import WARNING, new_figure
from qdenv.view.traffic import Scene, draw_panel, scene_of

HEATMAP, CURVES = 5.2, 6.8  # inches
TALL = 0.78  # of its width: the height of the heat map


def search_sections(subjects: list[Subject]) -> list[Section]:
    """Show the archive and the progress of each run."""
    return [_section(one, place) for place, one in enumerate(subjects) if one.run is not None]


def _section(subject: Subject, place: int) -> Section:
    run, elite = subject.run, subject.elite
    assert run is not None and elite is not None
    config, meaning, archive = run.config, run.schema, run.archive
    name = algorithm_name(config_name(config.algorithm))
    what = f"It is the best of {len(archive):,} of different kinds that {name} kept."
    if run.shipped:
        one = run.shipped.generator
        what = f"It ships with qdenv ({one.about}), one of {len(archive)} from a search by {name}."
    blocks: list[Text | Table | Drawing] = [
        Text(
            f"{what} Each cell of the map is a kind of layout, by its measures; the colour says "
            "how good the best of its kind is. The ring is around this layout."
        )
    ]
    if len(meaning.measures) <= 2:
        heat = new_figure(HEATMAP, TALL * HEATMAP)
        columns = archive.columns
        filled = scatter_objectives(columns["index"], columns["objective"], meaning.measures)
        draw_archive(heat, filled, meaning.measures, label=meaning.objective)
        if run.shipped:
            heat.axes[0].set_title("")  # what ships is no measure of what was found
        spot = [*elite.measures.values(), 0.5][:2]
        heat.axes[0].plot(*spot, "o", markersize=9, mfc="none", mec=WARNING, clip_on=False)
        blocks.append(drawing(heat, "The archive of the search.", f"archive-{place}"))
    (group,) = group_runs([run])
    caption = "How the search went on: sum of all objectives, share of filled cells, the best."
    figure = draw_progress([group], meaning.objective, CURVES)
    blocks.append(drawing(figure, caption, f"progress-{place}"))
    last = run.read_metrics()[-1]
    measures = ", ".join(f"{name} {value:.4g}" for name, value in elite.measures.items())
    rows = [
        ("run", subject.source),
        ("domain", subject.plan.domain.name),
        ("algorithm", name),
        ("seed", str(config.seed)),
        ("evaluations", f"{last.evaluations:,}"),
        ("QD-score", f"{last.qd_score:,.1f}"),
        ("coverage", f"{last.coverage:.1%}"),
        ("best objective", f"{last.best_objective:.3f}"),
        ("this layout", f"objective {elite.objective:.3f}, {measures}"),
    ]
    blocks.append(Table(("", ""), rows, f"search-{place}"))
    return Section(f"The search: {subject.name}", blocks)


def config_name(algorithm: object) -> str:
    """Find the registered name of an algorithm's settings."""
    from qdenv.search.registry import ALGORITHMS  # imports an algorithm when it is asked for one

    return ALGORITHMS.name_of(algorithm)


WIDTH = 6.8  # inches of a figure on its own
MAP = 5.6  # inches of a map of the floor plan


def asked_section(found: Found) -> Section:
    """Say what was asked, and the answer for each layout."""
    asked = found.asked
    answers = [
        Text(words.answer(found, one, study, rival), "answer")
        for one, study, rival in zip(asked.subjects, found.studies, asked.rivals, strict=True)
    ]
    notes = [Text(f"{asked.said}.", "faint")] if asked.said else []
    return Section("What was asked", [Text(words.question(found)), *answers, *notes])


def layouts_section(subjects: list[Subject]) -> Section:
    """Draw the layouts."""
    many = len(subjects) > 1
    drawn = [plan_of(one, f"plan-{place}", many) for place, one in enumerate(subjects)]
    return Section("The floor plans" if many else "The floor plan", drawn)


def plan_of(subject: Subject, name: str, half: bool) -> Drawing:
    """Draw one layout."""
    domain = subject.plan.domain
    figure = draw_plan(subject.layout, domain.tiles, domain.names)
    caption = f"{subject.name}, {words.say_size(subject)}; rows and columns are numbered from 0"
    return drawing(figure, caption, name, half, crop=True)


def throughput_section(found: Found) -> Section:
    """Show throughput over numbers of agents, with intervals."""
    runs = len(found.asked.seeds)
    bars = f"mean of {runs} runs, with its 95 % interval" if runs > 1 else "one run each"
    caption = f"Throughput over the number of robots: {bars}."
    head = ["floor plan", "robots", "tasks per timestep", "95 % interval", "standard error"]
    head += ["tasks per hour"] * bool(found.asked.per_hour)
    rows = []
    for row in found.rows:
        error = "" if np.isnan(row.error_of_all) else f"{row.error_of_all:.3f}"
        cells = [row.layout, str(row.agents), f"{row.mean_of_all:.3f}"]
        cells += [words.interval(row, 3), error]
        if found.asked.per_hour:
            cells.append(f"{row.mean_of_all * found.asked.per_hour:,.0f}")
        rows.append(cells)
    peaks = [Text(said) for one in found.asked.subjects if (said := words.say_peak(found, one))]
    figure = drawing(draw_over_agents(found.rows, width=WIDTH), caption, "throughput-figure")
    fading = [Text(said, "faint") for said in words.say_fading(found)]
    table = Table(head, rows, "throughput")
    return Section("Throughput against robots", [figure, *peaks, table, *fading])


def success_section(found: Found) -> Section:
    """Show how often runs did not congest, with Wilson intervals."""
    caption = "Share of runs that never congested, with its 95 % Wilson interval."
    head = ("floor plan", "robots", "never congested", "share", "95 % interval (Wilson)")
    rows = [
        (
            row.layout,
            str(row.agents),
            f"{round(row.success_rate * row.runs)} of {row.runs}",
            f"{row.success_rate:.0%}",
            f"{row.success_low:.1%} to {row.success_high:.1%}",
        )
        for row in found.rows
    ]
    figure = drawing(draw_over_agents(found.rows, True, WIDTH), caption, "success-figure")
    return Section("Success rates", [figure, Table(head, rows, "success")])


def traffic_sections(found: Found) -> list[Section]:
    """Show where the robots of each layout drive and wait, and how it goes on."""
    many, stop = len(found.studies) > 1, found.asked.config.stop_when_congested
    sections = []
    for place, (one, study) in enumerate(zip(found.asked.subjects, found.studies, strict=True)):
        scene = scene_of(one.plan, study, one.name, stop)
        whose = f": {one.name}" if many else ""
        robots = f"{found.agents} robots"
        usage = drawing(
            draw_panel(scene, "usage", MAP), f"Where {robots} are{whose}.", f"usage-{place}"
        )
        time = drawing(
            draw_panel(scene, "time", WIDTH),
            f"Finished tasks per timestep over time{whose}.",
            f"time-{place}",
        )
        sections += [
            Section(f"Where robots drive{whose}", [usage]),
            Section(f"Where robots wait{whose}", _waiting(one, study, scene, place)),
            Section(f"Finished tasks over time{whose}", [time]),
        ]
    return sections


def _waiting(
    subject: Subject, study: Study, scene: Scene, place: int
) -> list[Text | Table | Drawing]:
    """Rank the worst cells of a layout, and map them."""
    assert study.maps is not None
    spots, tiles = worst_cells(subject.layout, study.maps), subject.plan.domain.tiles
    said = Text(words.say_waiting(study, cells_with_half(study.maps)))
    if not spots:
        return [said]
    names = [subject.plan.domain.names.get(tile, repr(tile)) for tile in tiles]
    head = ("rank", "row", "column", "tile", "of all waiting", "one waits here", "per visit")
    rows = [
        (
            str(rank),
            str(spot.row),
            str(spot.column),
            names[spot.tile],
            f"{spot.share:.2%}",
            f"{spot.waiting:.1%} of time",
            f"{spot.wait_per_visit:.1f} timesteps",
        )
        for rank, spot in enumerate(spots, 1)
    ]
    caption = "Where robots wait; the worst cells are framed, rows and columns numbered from 0."
    figure = drawing(draw_panel(scene, "waiting", MAP), caption, f"waiting-figure-{place}")
    return [said, figure, Table(head, rows, f"waiting-{place}")]


def rival_sections(found: Found) -> list[Section]:
    """Compare each layout with what people draw by hand at its size."""
    asked, sections = found.asked, []
    for place, (one, rival) in enumerate(zip(asked.subjects, asked.rivals, strict=True)):
        whose = f": {one.name}" if len(asked.subjects) > 1 else ""
        blocks: list[Text | Table | Drawing] = [Text(rival.about)]
        if rival.layout is not None:
            theirs = one.plan._replace(name=rival.name, layout=rival.layout)
            subject = Subject(rival.name, rival.name, theirs)
            blocks += [
                plan_of(one, f"own-{place}", half=True),
                plan_of(subject, f"rival-{place}", half=True),
            ]
            blocks.append(_differences(found, one, rival, place))
        sections.append(Section(f"Against the hand-made floor plan{whose}", blocks))
    return sections


def _differences(found: Found, subject: Subject, rival: Rival, place: int) -> Table:
    """List how much a layout moves more than the hand-made one."""
    head = ("robots", subject.name, rival.name, "difference", "95 % interval", "")
    rows = []
    for ours, theirs in zip(found.rows_of(subject.name), found.rows_of(rival.name), strict=True):
        apart = words.compare_rows(ours, theirs)
        known = not np.isnan(apart.low)
        rows.append(
            (
                str(ours.agents),
                f"{ours.mean_of_all:.3f}",
                f"{theirs.mean_of_all:.3f}",
                "" if np.isnan(apart.percent) else f"{apart.percent:+.1f} %",
                f"{apart.low:+.1f} to {apart.high:+.1f} %" if known else "",
                ("significant" if apart.significant else "may be chance") if known else "",
            )
        )
    return Table(head, rows, f"against-{place}")
