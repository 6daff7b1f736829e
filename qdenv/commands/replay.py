"""The command replay: one run to be played in a browser, or as a film."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import tyro

from qdenv.commands import output
from qdenv.commands.choices import LayoutFile, OneRun, RunOptions
from qdenv.commands.words import Picture, place_picture
from qdenv.progress import Bar
from qdenv.ranges import NonNegativeInt, PositiveInt, Ranged, Seed
from qdenv.simulate.mapf.choosing import OWN, record_planner
from qdenv.simulate.mapf.settings import PLANNERS
from qdenv.study import motion as studies
from qdenv.study.motion import MAZES, Motion
from qdenv.study.options import fleet_tasks, usual_fleet
from qdenv.study.plans import Plan, read_plan
from qdenv.types import InputError
from qdenv.view.page import demand

if TYPE_CHECKING:
    from qdenv.view.page import Page

SHORT = 100  # timesteps of a GIF of robots, unless more are asked for: it grows by megabytes


@dataclass(frozen=True)
class Films(Ranged):
    """Films beside the page, for where no page can be opened."""

    gif: Picture = None  # draw an animated GIF
    mp4: Picture = None  # draw a film
    first: NonNegativeInt = 0  # timestep at which films begin
    # timestep at which they end; unless given the end of the run, in a GIF of robots 100 after the
    # first
    last: PositiveInt | None = None

    def __post_init__(self) -> None:
        """Refuse stretches of time that are none."""
        super().__post_init__()
        if self.last is not None and self.last <= self.first:
            raise InputError(
                f"--first {self.first} --last {self.last}: give timesteps, the first before the "
                "last"
            )
        if (self.first or self.last is not None) and not (self.gif or self.mp4):
            raise InputError("--first and --last are for films: add --gif or --mp4")

    def check(self, timesteps: int | None) -> None:
        """Refuse films that begin when the run is over; None where its end is not known yet.

        Raises:
            InputError: they do.
        """
        if timesteps is not None and self.first >= timesteps:
            raise InputError(f"--first {self.first}: the run ends at timestep {timesteps}")

    def places(self, layout: Path) -> list[output.Place]:
        """Choose where the films go, before any work is done.

        Raises:
            InputError: a place is none, or the encoder is not installed.
        """
        if self.mp4:
            demand("films", "imageio-ffmpeg")
        wanted = [
            place_picture(path, f"{layout.stem}_replay{ending}", [layout], (ending,))
            for path, ending in ((self.gif, ".gif"), (self.mp4, ".mp4"))
        ]
        return [place for place in wanted if place]


def replay(
    layout: LayoutFile,
    agents: int | None = None,
    options: OneRun = RunOptions(),  # noqa: B008 (frozen)
    seed: Seed = 0,
    films: Annotated[Films, tyro.conf.arg(name="")] = Films(),
    out: Path | None = None,
    json_file: output.JsonFile = None,
) -> None:
    """Replay one run in a browser: robots, goals, jams, tile usage; in a maze, the agent's way.

    Args:
        layout: layout file.
        agents: number of agents (robots); 200, or what is known of the layout's size, unless given.
        options: who drives.
        seed: of the run.
        films: beside the page.
        out: page to write (.html), one file that needs no network; LAYOUT_replay.html unless given.
        json_file: where to write the facts; - is standard output.
    """
    target = output.place(out, f"{layout.stem}_replay.html", (".html",), [layout])
    places = films.places(layout)
    demand("pages", "jinja2")
    plan = read_plan(layout, options.domain)
    show = _show_episode if plan.domain.name in MAZES else _show_fleet
    page, motion, facts = show(plan, agents, options, seed, films)
    page.save(target.path)
    print(target)
    for place in places:
        draw(place.path, plan, motion, films)
        print(place)
    facts |= {"page": target.path, "megabytes": len(page.html.encode()) / 1e6}
    facts |= {place.path.suffix[1:]: place.path for place in places}
    about = {"layout": layout, "domain": plan.domain.name, "seed": seed}
    output.write_facts(json_file, "replay", facts, **about, timesteps=motion.timesteps)


def _show_fleet(
    plan: Plan, agents: int | None, options: RunOptions, seed: int, films: Films
) -> tuple[Page, Motion, dict[str, Any]]:
    """Simulate a fleet once, say what came of it, and make its page."""
    usual = usual_fleet(plan.domain, [plan.layout], agents, options.timesteps)
    options = replace(options, timesteps=usual.timesteps)
    films.check(usual.timesteps)
    fleet_tasks(plan.layout, plan.domain.simulator.tasks, usual.agents)
    config = options.fleet(usual.agents)
    studies.check_run(config.agents, config.timesteps, seed)
    # Only now: what is above answers at once, and this imports the simulator.
    from qdenv.view.replay import about_fleet, make_replay

    with Bar("simulating") as bar:
        motion, traffic = studies.record_fleet(plan, config, seed, bar)
    about = about_fleet(plan, config, seed, motion, traffic)
    _say([*about, plan.whose, *[usual.said] * bool(usual.said)])
    facts = {
        "agents": config.agents,
        "planner": record_planner(config.planner),
        "stop": options.stop,
        "throughput": float(traffic.throughput),
        "finished_tasks": int(motion.finished.sum()),
        "congested_at": int(traffic.congested_at) or None,
        "end_timestep": motion.steps,
        "waiting_share": float(motion.waits.mean()) if motion.steps else None,
    }
    return make_replay(plan, motion, traffic, about), motion, facts


def _show_episode(
    plan: Plan, agents: int | None, options: RunOptions, seed: int, films: Films
) -> tuple[Page, Motion, dict[str, Any]]:
    """Let the agent walk through a maze once, say what came of it, and make its page."""
    if agents is not None:
        raise InputError("one agent walks in a maze: leave --agents out")
    if options.effort or PLANNERS.name_of(options.planner_settings) != OWN or not options.stop:
        raise InputError("in a maze nobody plans: leave --planner, --effort and --no-stop out")
    films.check(options.timesteps)
    studies.check_run(1, options.timesteps or 1, seed)
    from qdenv.view.replay import about_episode, make_replay

    with Bar("walking"):
        motion = studies.trace_agent(plan, seed, options.timesteps)
    about = about_episode(motion, seed)
    _say(about)
    facts = {
        "success": bool(motion.finished.any()),
        "actions": motion.steps,
        "shortest": motion.shortest,
    }
    return make_replay(plan, motion, None, about), motion, facts


def _say(lines: Sequence[str]) -> None:
    print("\n".join(lines))


def draw(path: Path, plan: Plan, motion: Motion, films: Films) -> None:
    """Draw a film of a stretch of the run."""
    from qdenv.view.film import save_film

    films.check(motion.steps)
    first = films.first
    short = path.suffix.lower() == ".gif" and motion.headings is None
    last = first + SHORT if short else motion.steps
    last = last if films.last is None else films.last
    with Bar(f"drawing {path}") as bar:
        save_film(path, plan.layout, plan.domain.tiles, motion, (first, last), bar)
