"""The report on layouts in which a fleet drives: the study behind it, and its page."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from qdenv.guidance import preferences
from qdenv.progress import Progress, silent
from qdenv.repairs.audit import audit, check_built
from qdenv.simulation.mapf.settings import FleetConfig, describe_planner
from qdenv.stats import difference
from qdenv.study.diagnosis import diagnose
from qdenv.study.options import fleet_tasks, usual_fleet
from qdenv.study.plans import name_guidance
from qdenv.study.recordings import FADING, cells_with_half
from qdenv.study.table import Row, Trial, compare, decide, find_capacity, find_peak
from qdenv.study.traffic import Study, examine, facts_of
from qdenv.types import Floor, about
from qdenv.view.change import draw_change
from qdenv.view.guidance import STRONGEST, draw_arrows, share_along
from qdenv.view.layouts import draw_plan
from qdenv.view.page import Page, listed
from qdenv.view.report import WIDTH, make_report
from qdenv.view.report_subjects import Rival, Subject, find_rival
from qdenv.view.studies import draw_over_agents
from qdenv.view.style import to_svg
from qdenv.view.traffic import Scene, draw_panel, make_scene, top_of

_MAP, _PLAN = 5.6, 4.8  # inches of maps of floor plans, and of the longer side of a plan
# Shares of time, and timesteps, that are written as more than zero.
_LEAST_WAITING, _LEAST_VISIT = 0.0005, 0.05
_SHARES = (0.5, 0.75, 1.0, 1.25, 1.5)  # of a single number of agents, to compare it with


class FleetRequest(NamedTuple):
    """What a report on a fleet is to show."""

    subjects: list[Subject]  # the layouts, of one domain
    rivals: list[Rival | None]  # what people draw by hand around the stations of each subject
    agents: int | None  # the number of the close look; None for the first layout's peak
    counts: tuple[int, ...]  # the numbers of agents that are simulated, few to many
    config: FleetConfig  # the settings of a simulation
    seeds: tuple[int, ...]  # of the runs with each number of agents
    note: str  # what a known size brings along; "" for nothing
    per_hour: float | None  # timesteps per hour; None if unknown

    @property
    def floors(self) -> dict[str, Floor]:
        """All that is simulated by name: the subjects, then the hand-made layouts."""
        rivals = {one.plan.name: one.plan.floor for one in self.rivals if one}
        return {one.name: one.plan.floor for one in self.subjects} | rivals


def make_request(
    subjects: list[Subject],
    agents: Sequence[int],
    timesteps: int | None,
    config: Callable[[int, int], FleetConfig],
    seeds: tuple[int, ...],
    per_hour: float | None = None,
) -> FleetRequest:
    """Check what a report is to show, before anything is simulated.

    The subjects are of one domain. `agents` is one number, around which others are chosen, or
    several, in place of those, or none for the usual number; `timesteps` is None for the usual
    horizon; `config` makes the numbers of a simulation of agents and timesteps. Raises InputError
    if a fleet cannot work on one of the layouts, or the numbers make no simulation.
    """
    domain, layouts = subjects[0].plan.domain, [one.plan.layout for one in subjects]
    most = max(agents, default=subjects[0].plan.facts.robots)
    usual, timesteps, note = usual_fleet(domain, layouts, most, timesteps)
    counts = tuple(sorted(agents)) or (usual,)
    for one in subjects:
        with about(one.source):
            fleet_tasks(one.plan.layout, domain.simulator.tasks, counts[-1])
    rivals = [find_rival(one, subjects) for one in subjects]
    # A single number is compared with others, as many as fit the smallest of all layouts.
    single = counts[0] if len(counts) == 1 else None
    if single is not None:
        every = [*layouts, *(one.plan.layout for one in rivals if one)]
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
    agents, rows, studies = _simulate(request, on_row, progress)
    progress("drawing the page", -1, "")  # how far it is, is unknown
    closely = [next(r for r in rows if (r.layout, r.agents) == (s.name, agents)) for s in subjects]
    decisions = [decide(one, closely[0]) for one in closely[1:]]
    scenes = [
        make_scene(one.plan, study, request.config.stop_when_congested)
        for one, study in zip(subjects, studies, strict=True)
    ]
    # Maps of all floor plans have one colour scale.
    tops = {
        kind: top_of(np.concatenate([getattr(one.maps, kind).ravel() for one in scenes]))
        for kind in ("usage", "waiting")
    }
    layouts, facts = [], {}
    for number, (one, study) in enumerate(zip(subjects, studies, strict=True)):
        rival = request.rivals[number]
        content = _compare(one, rival, rows, closely[number])
        scene = scenes[number]._replace(tops=tops)
        layouts.append(content | _draw(one, study, rival, number, scene))
        # By the names that `qdenv simulate` and `compare` give them.
        apart = [{"agents": row.agents, **apart._asdict()} for row, _, apart in content["against"]]
        facts[one.name] = facts_of(study, one.plan.layout) | {
            "source": one.source,
            "worth_having": content["capacity"],
            "hand_made": rival
            and {"layout": rival.plan.name, "about": rival.about, "differences": apart},
        }
    jammed = any(row.success_rate < 1 for row in rows)
    return make_report(
        "fleet",
        f"{listed([one.name for one in subjects])}: {agents} robots",
        subjects,
        {
            "agents": agents,
            "decisions": decisions,
            "layouts": facts,
            "rows": [row._asdict() | {"each": [run._asdict() for run in row.each]} for row in rows],
        },
        command,
        request=request,
        agents=agents,
        decisions=decisions,
        changes=_draw_changes(subjects, scenes),
        layouts=layouts,
        runs=len(request.seeds),
        planner=_describe_planner(request),
        rows=rows,
        jammed=jammed,
        fading=[row for row in rows if row.fading > FADING],
        throughput=to_svg(draw_over_agents(rows, width=WIDTH), "throughput-figure"),
        success=to_svg(draw_over_agents(rows, True, WIDTH), "success-figure") if jammed else "",
    )


def _simulate(
    request: FleetRequest, on_row: Callable[[Row], None], progress: Progress
) -> tuple[int, list[Row], list[Study]]:
    """Return the number of agents of the close look, all rows, and the study of each subject."""
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
    return agents, rows, studies


def _compare(subject: Subject, rival: Rival | None, rows: list[Row], row: Row) -> dict[str, Any]:
    """Return the numbers of one layout, and by how much it moves more than the hand-made one."""
    own = sorted((one for one in rows if one.layout == subject.name), key=lambda one: one.agents)
    theirs = {one.agents: one for one in rows if rival and one.layout == rival.plan.name}
    # Over all runs, as `qdenv compare` does.
    against = [
        (one, theirs[one.agents], difference(one.sample_of_all, theirs[one.agents].sample_of_all))
        for one in own
        if rival
    ]
    capacity = find_capacity(own)
    return {
        "name": subject.name,
        "rival": rival,
        "row": row,
        "congested": row.runs - round(row.success_rate * row.runs),
        "peak": find_peak(own) if len(own) > 1 else None,
        "capacity": capacity,
        "most": capacity == own[-1].agents,
        "against": against,
        "by_hand": decide(row, theirs[row.agents])["sentence"] if rival else "",
    }


def _describe_planner(request: FleetRequest) -> str:
    """Name the planner, and the guidance if there is any."""
    planner = describe_planner(request.config.planner)
    guidance = name_guidance([one.plan for one in request.subjects])
    if not guidance:
        return planner
    without = ", none on the hand-made layout" if any(request.rivals) else ""
    return f"{planner}; guidance: {guidance}{without}"


def _draw_changes(subjects: Sequence[Subject], scenes: Sequence[Scene]) -> list[dict[str, str]]:
    """Draw each further layout beside the first one, where the sizes are the same."""
    (first, before), *others = zip(subjects, scenes, strict=True)
    changes = []
    for number, (one, after) in enumerate(others):
        if one.plan.layout.shape == first.plan.layout.shape:
            usages = before.maps.usage, after.maps.usage
            figure = draw_change(first.plan, one.plan, usages, (first.name, one.name), WIDTH)
            svg = to_svg(figure, f"change-{number}", crop=True)
            changes.append({"name": one.name, "figure": svg})
    return changes


def _draw(
    subject: Subject, study: Study, rival: Rival | None, number: int, scene: Scene
) -> dict[str, Any]:
    """Return the pictures of one layout, and what its study found."""
    domain, layout, maps = subject.plan.domain, subject.plan.layout, scene.maps
    assert study.verdict is not None
    verdict, reason, _ = study.verdict
    make_rules, remarks = subject.plan.fitted().rules, list[str]()
    if make_rules:
        rules = make_rules()
        remarks = [one.message for one in audit(layout, rules)]
        remarks += [f"holds: {rule}" for rule, wrong in check_built(layout, rules) if not wrong]
    remarks += [one.message for one in diagnose(subject.plan)]
    rows, cols = layout.shape
    counts = [f"{number:,} {name}" for name, number in domain.fitted(layout).numbers.items()]
    plan = draw_plan(layout, domain.tiles, domain.names, side=_PLAN)
    flow, along = "", 0.0
    if scene.costs is not None:
        preferred = preferences(scene.costs, scene.free)
        draw_arrows(plan.axes[0], preferred / STRONGEST).set_gid("guidance")
        along = share_along(preferred, maps.moves)
        flow = to_svg(draw_panel(scene, "flow", _MAP), f"flow-{number}")
    change = rival and draw_change(
        rival.plan, subject.plan, None, (rival.plan.name, subject.name), WIDTH
    )
    # A cell that is hardly ever waited on is no place to look at.
    spots = [one for one in scene.worst if one["waiting"] >= _LEAST_WAITING]
    return {
        "contents": f"{rows} x {cols} cells" + (f" with {listed(counts)}" if counts else ""),
        "remarks": remarks,
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
        "spots": spots,
        "per_visit": any(one["wait_per_visit"] >= _LEAST_VISIT for one in spots),
        "tiles": [domain.names.get(tile, repr(tile)) for tile in domain.tiles],
        "change": to_svg(change, f"by-hand-{number}", crop=True) if change else "",
    }
