"""The report on layouts in which a fleet drives: the study behind it, and its page."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

from qdenv.guidance import preferences
from qdenv.progress import Progress, silent
from qdenv.simulate.mapf.settings import FleetConfig, describe_planner
from qdenv.stats import difference
from qdenv.study.options import fleet_tasks, usual_fleet
from qdenv.study.plans import name_guidance
from qdenv.study.recordings import FADING, cells_with_half, worst_cells
from qdenv.study.table import Row, Trial, about, compare, find_capacity, find_peak
from qdenv.study.traffic import Study, examine, facts_of
from qdenv.types import Floor
from qdenv.view.guidance import STRONGEST, draw_arrows, share_along
from qdenv.view.layouts import draw_plan
from qdenv.view.page import Page, listed
from qdenv.view.report import WIDTH, make_report
from qdenv.view.report_subjects import Rival, Subject, describe_contents, find_rival
from qdenv.view.studies import draw_over_agents
from qdenv.view.style import to_svg
from qdenv.view.traffic import draw_panel, make_scene

_MAP = 5.6  # inches of maps of floor plans
_SHARES = (0.5, 0.75, 1.0, 1.25, 1.5)  # of a single number of agents, to compare it with


class FleetRequest(NamedTuple):
    """What a report on a fleet shall show."""

    subjects: list[Subject]  # the layouts, of one domain
    rivals: list[Rival]  # what people draw by hand at the size of each subject
    agents: int | None  # the number of the close look; None for the first layout's peak
    counts: tuple[int, ...]  # the numbers of agents that are simulated, few to many
    config: FleetConfig  # the numbers of a simulation
    seeds: tuple[int, ...]  # of the runs with each number of agents
    note: str  # what a known size brings along; "" for nothing
    per_hour: float | None  # timesteps per hour; None if unknown

    @property
    def floors(self) -> dict[str, Floor]:
        """All that is simulated by name: the subjects, then the hand-made layouts."""
        rivals = {one.name: Floor(one.layout) for one in self.rivals if one.layout is not None}
        return {one.name: one.plan.floor for one in self.subjects} | rivals


def make_request(
    subjects: list[Subject],
    agents: Sequence[int],
    timesteps: int | None,
    config: Callable[[int, int], FleetConfig],
    seeds: tuple[int, ...],
    per_hour: float | None = None,
) -> FleetRequest:
    """Check what a report shall show, before anything is simulated.

    The subjects are of one domain. `agents` is one number, around which others are chosen, or
    several, in place of those, or none for the usual number; `timesteps` is None for the usual
    horizon; `config` makes the numbers of a simulation of agents and timesteps. Raises InputError
    if a fleet cannot work on one of the layouts, or the numbers make no simulation.
    """
    domain, layouts = subjects[0].plan.domain, [one.plan.layout for one in subjects]
    usual, timesteps, note = usual_fleet(domain, layouts, max(agents, default=None), timesteps)
    counts = tuple(sorted(agents)) or (usual,)
    tasks = domain.simulator.tasks
    for one in subjects:
        with about(one.source):
            fleet_tasks(one.plan.layout, tasks, counts[-1])
    rivals = [find_rival(one, subjects) for one in subjects]
    # A single number is compared with others, as many as fit the smallest of all layouts.
    single = counts[0] if len(counts) == 1 else None
    if single is not None:
        every = [*layouts, *(one.layout for one in rivals if one.layout is not None)]
        most = min(int(domain.drivable(one).sum()) for one in every)
        shares = {max(1, round(share * single)) for share in _SHARES}
        counts = tuple(sorted({min(count, max(most, single)) for count in shares}))
    made = config(max(counts), timesteps)
    return FleetRequest(subjects, rivals, single, counts, made, seeds, note, per_hour)


def report_fleet(
    request: FleetRequest,
    command: str = "",
    on_row: Callable[[Row], None] = lambda row: None,
    progress: Progress = silent,
) -> Page:
    """Simulate all layouts and their rivals over numbers of agents, and make the page.

    `command` is the line that makes the page again; `on_row` is called with each finished row.
    """
    subjects = request.subjects
    tasks = subjects[0].plan.domain.simulator.tasks
    trial = Trial(tasks, request.config, request.counts, request.seeds)
    rows = compare(request.floors, trial, on_row, progress)
    agents = request.agents
    if agents is None:
        agents = find_peak([row for row in rows if row.layout == subjects[0].name]).agents
    config = replace(request.config, agents=agents)
    studies = []
    for one in subjects:

        def show(step: str, share: float, note: str, name: str = one.name) -> None:
            progress(f"looking closely at {name}", share, note or step)

        studies.append(examine(one.plan, config, request.seeds, progress=show))
    progress("drawing the page", -1, "")  # how far it is, is unknown
    layouts, facts = [], {}
    for number, (one, study) in enumerate(zip(subjects, studies, strict=True)):
        content = _compare(one, request.rivals[number], rows, agents)
        rival, differences = content["rival"], content["differences"]
        layouts.append(content | _draw(one, study, rival, number, config))
        # By the names that `qdenv simulate` and `compare` give them.
        apart = [{"agents": row.agents, **apart._asdict()} for row, _, apart in differences]
        against = {"layout": rival.name, "about": rival.about, "differences": apart}
        facts[one.name] = facts_of(study, one.plan.layout) | {
            "source": one.source,
            "hand_made": against if apart else None,
        }
    planner, guidance = describe_planner(config.planner), name_guidance([s.plan for s in subjects])
    if guidance:
        others = any(one.layout is not None for one in request.rivals)
        planner += f"; guidance: {guidance}{', none on the hand-made layout' * others}"
    return make_report(
        "fleet",
        f"{listed([one.name for one in subjects])}: {agents} robots",
        subjects,
        {"agents": agents, "layouts": facts, "rows": [row._asdict() for row in rows]},
        command,
        request=request,
        agents=agents,
        layouts=layouts,
        runs=len(request.seeds),
        planner=planner,
        rows=rows,
        fading=[row for row in rows if row.fading > FADING],
        throughput=to_svg(draw_over_agents(rows, width=WIDTH), "throughput-figure"),
        success=to_svg(draw_over_agents(rows, True, WIDTH), "success-figure"),
    )


def _compare(subject: Subject, rival: Rival, rows: list[Row], agents: int) -> dict[str, Any]:
    """Return the numbers of one layout, and by how much it moves more than the hand-made one."""
    own = sorted((row for row in rows if row.layout == subject.name), key=lambda row: row.agents)
    differences = []
    if rival.layout is not None:
        theirs = {row.agents: row for row in rows if row.layout == rival.name}
        for row in own:
            # Over all runs, as `qdenv compare` does.
            other = theirs[row.agents]
            apart = difference(row.sample_of_all, other.sample_of_all)
            differences.append((row, other, apart))
    row = next(row for row in own if row.agents == agents)
    return {
        "name": subject.name,
        "rival": rival,
        "row": row,
        "congested": row.runs - round(row.success_rate * row.runs),
        "peak": find_peak(own) if len(own) > 1 else None,
        "capacity": find_capacity(own),
        "differences": differences,
        "closely": next((one for one in differences if one[0].agents == agents), None),
    }


def _draw(
    subject: Subject, study: Study, rival: Rival, number: int, config: FleetConfig
) -> dict[str, Any]:
    """Return the pictures of one layout, and what its study found."""
    domain, layout, maps = subject.plan.domain, subject.plan.layout, study.maps
    assert maps is not None and study.verdict is not None
    verdict, reason, _ = study.verdict
    scene = make_scene(subject.plan, study, config.stop_when_congested)
    plan = draw_plan(layout, domain.tiles, domain.names)
    contents = describe_contents(layout, domain)
    flow, along = "", 0.0
    if scene.costs is not None:
        preferred = preferences(scene.costs, scene.free)
        draw_arrows(plan.axes[0], preferred / STRONGEST).set_gid("guidance")
        along = share_along(preferred, maps.moves)
        flow = to_svg(draw_panel(scene, "flow", _MAP), f"flow-{number}")
    content = {
        "title": f"{subject.name} ({contents})",
        "contents": contents,
        "verdict": verdict,
        "reason": reason,
        "plan": to_svg(plan, f"plan-{number}", crop=True),
        "usage": to_svg(draw_panel(scene, "usage", _MAP), f"usage-{number}"),
        "waiting": to_svg(draw_panel(scene, "waiting", _MAP), f"waiting-figure-{number}"),
        "time": to_svg(draw_panel(scene, "time", WIDTH), f"time-{number}"),
        "flow": flow,
        "along": along,
        "waiting_share": maps.waiting_share,
        "half": cells_with_half(maps),
        "spots": worst_cells(layout, maps),
        "tiles": [domain.names.get(tile, repr(tile)) for tile in domain.tiles],
    }
    if rival.layout is not None:
        theirs = draw_plan(rival.layout, domain.tiles, domain.names)
        content["own_plan"] = to_svg(plan, f"own-{number}", crop=True)
        content["rival_plan"] = to_svg(theirs, f"rival-{number}", crop=True)
        content["rival_contents"] = describe_contents(rival.layout, domain)
    return content
