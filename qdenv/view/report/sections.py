"""What a report is made of: sections of paragraphs, tables and figures, which a template sets."""

from __future__ import annotations

import io
import re
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from matplotlib import rc_context
from matplotlib.figure import Figure

from qdenv.study.congestion import cells_with_half, worst_cells
from qdenv.study.traffic import Study
from qdenv.view.layouts import draw_plan
from qdenv.view.report import text as words
from qdenv.view.report.fleet import Found
from qdenv.view.report.subjects import Rival, Subject
from qdenv.view.studies import draw_success, draw_throughput
from qdenv.view.style import FONTS
from qdenv.view.traffic import Scene, draw_panel, scene_of


class Text(NamedTuple):
    """A paragraph."""

    words: str  # of it
    kind: str = "plain"  # "plain", "answer" for what the reader came for, "faint" for a side note
    block: str = "text"


class Table(NamedTuple):
    """A table."""

    head: Sequence[str]  # names of the columns
    rows: Sequence[Sequence[str]]  # cells as they are read, at least one row
    name: str  # identifies it in the page
    block: str = "table"

    @property
    def numeric(self) -> list[bool]:
        """Tell for each column whether it holds numbers, which are set right."""
        columns = zip(*self.rows, strict=True)
        return [all(re.match(r"[-+]?\d|$", cell) for cell in column) for column in columns]


class Drawing(NamedTuple):
    """A figure."""

    svg: str  # drawing, inline
    caption: str  # below it
    name: str  # identifies it in the page
    half: bool = False  # two of its kind stand side by side where there is room
    block: str = "drawing"


class Section(NamedTuple):
    """A part of the report."""

    title: str  # its heading
    blocks: Sequence[Text | Table | Drawing]  # in order

    @property
    def lead(self) -> int:
        """Count the first blocks that stay with the heading on paper: up to a first large one."""
        count = 0
        for block in self.blocks:
            count += 1
            beside = isinstance(block, Drawing) and block.half
            if not (isinstance(block, Text) or beside):
                break
        return count


def drawing(
    figure: Figure, caption: str, name: str, half: bool = False, crop: bool = False
) -> Drawing:
    """Turn a figure into vector graphics for the page.

    Args:
        figure: what to draw.
        caption: below it; what it shows to who cannot see it, too.
        name: identifies it in the page, and all that it refers to inside itself.
        half: stands beside another one.
        crop: cut the picture to what is drawn.
    """
    content = io.StringIO()
    with rc_context(FONTS):
        box = "tight" if crop else None
        figure.savefig(content, format="svg", bbox_inches=box, metadata={"Date": None})
    svg = content.getvalue()
    svg = svg[svg.index("<svg") :]
    # Every figure of the page has names of its own for what is referred to within it.
    svg = re.sub(r'\bid="', f'id="{name}-', svg)
    svg = re.sub(r'(url\(#|href="#)', rf"\g<1>{name}-", svg)
    svg = re.sub(r"<metadata>.*?</metadata>", "", svg, flags=re.DOTALL)
    return Drawing(svg, caption, name, half)


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
    figure = drawing(draw_throughput(found.rows, WIDTH), caption, "throughput-figure")
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
    figure = drawing(draw_success(found.rows, WIDTH), caption, "success-figure")
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
