"""The report on mazes: how often the agent reaches the goal, where it walks, how soon it ends."""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from qdenv.agent.evaluate import Success, default_horizon, evaluate_agent, run_alone
from qdenv.grid import of_tiles
from qdenv.progress import Progress, silent
from qdenv.run.archive import mark_cells
from qdenv.simulate.maze.policy import load_weights
from qdenv.simulate.maze.world import WALL
from qdenv.study.groups import algorithm_name, group_runs
from qdenv.study.sweep import about
from qdenv.view.archive import draw_archive, scatter_objectives
from qdenv.view.layouts import draw_plan
from qdenv.view.maze import draw_arrivals, draw_walks
from qdenv.view.page import make_page
from qdenv.view.report.build import Report, whose
from qdenv.view.report.sections import Drawing, Section, Table, Text, drawing
from qdenv.view.report.subjects import Subject, made_line, settings_section
from qdenv.view.report.text import listed
from qdenv.view.runs import draw_marks, draw_progress
from qdenv.view.style import WARNING, paper_figure, styled

EPISODES, SEED = 100, 0  # those of `qdenv evaluate-agent`
CURVES, MAP = 6.8, 5.0  # inches

_run = jax.jit(run_alone, static_argnums=(3, 4))


class Solved(NamedTuple):
    """How the agent does in one maze."""

    subject: Subject  # the maze
    horizon: int  # actions after which an episode fails
    success: Success  # how often it reached the goal
    arrivals: np.ndarray  # float [episodes], actions to the goal, NaN where it was not reached
    usage: np.ndarray  # float [H, W], share of its actions that it takes on each cell


def solve(
    subjects: list[Subject], timesteps: int | None = None, progress: Progress = silent
) -> list[Solved]:
    """Let the agent walk through mazes, as `qdenv evaluate-agent` does.

    Args:
        subjects: the mazes.
        timesteps: actions per episode; twice the tiles of the ringed maze unless given.
        progress: hears how far it is.

    Raises:
        InputError: there is nothing to solve in one of them.
    """
    weights, found = load_weights(""), []
    for place, one in enumerate(subjects):
        progress("solving mazes", place / len(subjects), one.name)
        horizon = timesteps or default_horizon(one.layout)
        with about(one.source):
            success = evaluate_agent(weights, one.layout, SEED, EPISODES, horizon)
        key = jax.random.key(SEED)
        episodes = _run(weights, jnp.asarray(one.layout), key, EPISODES, horizon)
        arrivals = np.where(np.asarray(episodes.success), np.asarray(episodes.length), np.nan)
        usage = np.asarray(episodes.usage).mean(axis=0)
        found.append(Solved(one, horizon, success, arrivals, usage))
    return found


def maze_report(found: list[Solved], again: str = "") -> Report:
    """Make the page of mazes.

    Args:
        found: the mazes.
        again: the command line that makes the page again.
    """
    subjects = [one.subject for one in found]
    title = f"{listed([one.name for one in subjects])}: the agent's success"
    facts = {
        "layouts": {
            one.subject.name: {"source": one.subject.source, **one.success._asdict()}
            for one in found
        }
    }
    horizons = listed([f"{one.horizon:,}" for one in found])
    settings = {
        **{f"maze {one.name}": one.source for one in subjects},
        "domain": whose(subjects[0]),
        "agent": "the one that ships",
        "episodes": str(EPISODES),
        "actions per episode": horizons,
        "seed": str(SEED),
    }
    parts = [
        _asked(found),
        *search_sections(subjects),
        _mazes(found),
        _successes(found),
        *_walks(found),
        Section("Against other mazes", [Text(OTHERS)]),
        settings_section(settings, again),
    ]
    page = make_page("report", title, facts=facts, sections=parts, made=made_line())
    return Report(page, facts)


OTHERS = (
    "Nobody designs mazes by hand for this agent. qdenv evaluate-agent MAZE --random-mazes 100 "
    "compares one with random mazes of as many walls and a path of like length."
)


def _asked(found: list[Solved]) -> Section:
    names = listed([f"{one.subject.name} ({one.subject.size} cells)" for one in found])
    question = (
        f"How hard is the maze {names} for an agent that sees only what is near? It begins at one "
        "end of the longest of all shortest paths and shall reach the other end; an episode fails "
        f"after {listed([f'{one.horizon:,}' for one in found])} actions. Each number is of "
        f"{EPISODES} episodes (seed {SEED})."
    )
    answers = [
        Text(
            f"{one.subject.name}: the agent reaches the goal in {one.success.rate:.1%} of the "
            f"episodes (95 % interval {one.success.low:.1%} to {one.success.high:.1%}), after "
            f"{one.success.mean_length:.0f} actions on average; the shortest path has "
            f"{one.success.shortest} moves.",
            "answer",
        )
        for one in found
    ]
    return Section("What was asked", [Text(question), *answers])


def _mazes(found: list[Solved]) -> Section:
    drawn = []
    for place, one in enumerate(found):
        domain, layout = one.subject.plan.domain, one.subject.layout
        figure = draw_plan(layout, domain.tiles, domain.names)
        draw_marks(figure.axes[0], mark_cells(layout, domain))
        caption = f"{one.subject.name}: {one.subject.size} cells, with start and goal"
        drawn.append(drawing(figure, caption, f"plan-{place}", len(found) > 1, crop=True))
    return Section("The mazes" if len(found) > 1 else "The maze", drawn)


def _successes(found: list[Solved]) -> Section:
    head = ("maze", "at the goal", "share", "95 % interval (Wilson)", "actions", "shortest path")
    rows = [
        (
            one.subject.name,
            f"{np.isfinite(one.arrivals).sum()} of {one.success.runs}",
            f"{one.success.rate:.1%}",
            f"{one.success.low:.1%} to {one.success.high:.1%}",
            f"{one.success.mean_length:.1f}",
            f"{one.success.shortest} moves",
        )
        for one in found
    ]
    arrivals = {one.subject.name: one.arrivals for one in found}
    figure = draw_arrivals(arrivals, max(one.horizon for one in found), CURVES)
    caption = "Share of the episodes that have reached the goal, over the actions taken."
    curves = drawing(figure, caption, "arrivals")
    return Section("Success", [Table(head, rows, "success"), curves])


def _walks(found: list[Solved]) -> list[Section]:
    sections = []
    for place, one in enumerate(found):
        domain, layout = one.subject.plan.domain, one.subject.layout
        free = ~np.asarray(of_tiles(layout, domain.tiles[WALL], domain.tiles))
        figure = draw_walks(free, one.usage, MAP)
        draw_marks(figure.axes[0], mark_cells(layout, domain))
        whose_maze = f": {one.subject.name}" if len(found) > 1 else ""
        caption = f"Share of its actions that the agent takes on each cell{whose_maze}."
        walks = drawing(figure, caption, f"walks-{place}")
        sections.append(Section(f"Where the agent walks{whose_maze}", [walks]))
    return sections


HEATMAP = 5.2  # inches
TALL = 0.78  # of its width: the height of the heat map


def search_sections(subjects: list[Subject]) -> list[Section]:
    """Show the archive and the progress of each run."""
    return [_section(one, place) for place, one in enumerate(subjects) if one.run is not None]


def _section(subject: Subject, place: int) -> Section:
    run, elite = subject.run, subject.elite
    assert run is not None and elite is not None
    config, meaning, archive = run.config, run.meaning, run.archive
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
        heat = paper_figure(HEATMAP, TALL * HEATMAP)
        columns = archive.columns
        filled = scatter_objectives(columns["index"], columns["objective"], meaning.measures)
        styled(draw_archive)(heat, filled, meaning.measures, label=meaning.objective)
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
