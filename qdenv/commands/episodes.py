"""The command evaluate-agent: how often the agent solves a maze, and random mazes like it."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
import tyro
from annotated_types import Interval

from qdenv.commands.choices import LayoutFile
from qdenv.commands.output import JsonFile, place, write_facts
from qdenv.commands.words import Picture, place_picture
from qdenv.io.files import write_csv
from qdenv.io.layouts import write_layout
from qdenv.progress import Bar
from qdenv.ranges import PositiveInt, Ranged, Seed
from qdenv.study.plans import Plan, read_plan
from qdenv.types import InputError

if TYPE_CHECKING:
    from qdenv.agent.evaluate import Comparison
    from qdenv.simulate.maze.policy import Weights

MOST_RUNS = 1_000_000
MOST_MAZES = 10_000
MAZES = ("maze-walls", "maze-entropy")
TABLE = ("file", "rows", "cols", "walls", "shortest", "runs", "success", "low", "high", "actions")


@dataclass(frozen=True)
class Episodes(Ranged):
    """Who walks through the maze, how often, and for how long."""

    agent: str = ""  # an agent.npz; the shipped one unless given
    runs: Annotated[int, Interval(ge=1, le=MOST_RUNS)] = 100  # independent episodes, in each maze
    # actions per episode; twice the tiles of the ringed maze unless given
    timesteps: Annotated[PositiveInt | None, tyro.conf.arg(aliases=("--horizon",))] = None
    seed: Seed = 0  # of headings, actions and random mazes
    reference_batching: bool = False  # repeat the published evaluation's two quirks, for comparison


@dataclass(frozen=True)
class Baseline:
    """Random mazes to compare with."""

    # also solve so many random mazes with as many walls and a path length within 0.8 to 1.2 of this
    # one's
    random_mazes: int = 0
    # table of the random mazes (.csv), their layout files in a folder and a picture of them beside
    # it; LAYOUT_random.csv unless given
    out: Path | None = None

    def __post_init__(self) -> None:
        """Refuse numbers without a standard error, and a place for nothing."""
        if self.random_mazes and not 2 <= self.random_mazes <= MOST_MAZES:
            raise InputError(
                f"--random-mazes {self.random_mazes}: give 2 to {MOST_MAZES:,}, or leave it out"
            )
        if self.out and not self.random_mazes:
            raise InputError("--out is for the table of random mazes: add --random-mazes 100")


class Places:
    """Where the random mazes go: a table, a picture beside it and a folder of layouts."""

    def __init__(self, out: Path | None, layout: Path) -> None:
        """Choose the places before any work is done.

        Raises:
            InputError: the table's is none, or a file has the folder's name.
        """
        self.table = place(out, f"{layout.stem}_random.csv", (".csv",), [layout])
        self.picture = self.table.beside(".png")
        self.folder = self.table.beside("")
        if self.folder.path.is_file():
            raise InputError(f"{self.folder.path}: that is a file, and random mazes need a folder")


def evaluate_agent(
    layout: LayoutFile,
    episodes: Annotated[Episodes, tyro.conf.arg(name="")] = Episodes(),
    baseline: Annotated[Baseline, tyro.conf.arg(name="")] = Baseline(),
    gif: Picture = None,
    json_file: JsonFile = None,
) -> None:
    """Let the agent solve a maze many times: success rate with its 95 % interval.

    Args:
        layout: layout file of a maze, with or without its ring of walls.
        episodes: who walks, how often, for how long.
        baseline: random mazes to compare with.
        gif: draw one episode.
        json_file: where to write the numbers; - for standard output.
    """
    plan = read_plan(layout, None)
    if plan.domain.name not in MAZES:
        raise InputError(f"{layout}: a layout of {plan.domain.name}, the agent walks in mazes")
    if baseline.random_mazes and episodes.reference_batching:
        raise InputError("--reference-batching is for one maze: leave --random-mazes out")
    picture = place_picture(gif, "episode.gif", [layout], (".gif",))
    places = Places(baseline.out, layout) if baseline.random_mazes else None
    # Only now: what is above answers at once, and these import jax.
    from qdenv.agent.evaluate import default_horizon
    from qdenv.agent.evaluate import evaluate_agent as measure_success
    from qdenv.simulate.maze.policy import load_weights

    maze, weights, seed = plan.layout, load_weights(episodes.agent), episodes.seed
    steps = episodes.timesteps or default_horizon(maze)
    with Bar(f"solving {layout} {episodes.runs} times"):
        result = measure_success(
            weights, maze, seed, episodes.runs, steps, episodes.reference_batching
        )
    facts = result._asdict()
    print(
        f"success {result.rate:.1%} ({result.low:.1%} to {result.high:.1%}) in {result.runs} runs "
        f"of at most {steps} timesteps, {result.mean_length:.0f} actions on average, shortest path "
        f"{result.shortest} moves"
    )
    if places:
        others = compare(weights, maze, baseline.random_mazes, episodes, steps)
        facts["random_mazes"] = leave(places, others, plan, result.rate)
    settings = {"layout": layout, "timesteps": steps, "seed": seed}
    write_facts(
        json_file, "evaluate-agent", facts, **settings, agent=episodes.agent or "the shipped one"
    )
    if picture:
        draw_episode(picture.path, weights, plan, seed, steps)
        print(picture)


def compare(
    weights: Weights, maze: np.ndarray, mazes: int, episodes: Episodes, steps: int
) -> Comparison:
    """Solve random mazes like this one (int8 [H, W])."""
    from qdenv.agent.evaluate import compare_with_random

    with Bar("drawing random mazes") as bar:
        return compare_with_random(
            weights, maze, mazes, episodes.runs, episodes.seed, steps, progress=bar
        )


def leave(places: Places, others: Comparison, plan: Plan, own: float) -> dict[str, Any]:
    """Write random mazes, their table and their picture, say where, and return the facts.

    Args:
        places: where everything goes.
        others: the random mazes and the agent's success on each.
        plan: the maze they are compared with.
        own: the agent's success rate on it.
    """
    # Only here: matplotlib takes half a second to import, and who is refused need not wait.
    from qdenv.view.maze import draw_mazes
    from qdenv.view.style import save_figure

    lengths, folder, domain = [maze.shortest for maze in others.mazes], places.folder, plan.domain
    print(
        f"{len(lengths)} random mazes: {others.mean:.1%} +- {others.standard_error:.1%}, "
        f"{others.walls} walls each, shortest paths of {min(lengths)} to {max(lengths)} moves"
    )
    rows = []
    for number, (maze, one) in enumerate(zip(others.mazes, others.results, strict=True)):
        path = folder.path / f"random_{number:03}.json"
        details = {"walls": others.walls, "shortest": maze.shortest, "success": one.rate}
        write_layout(
            path, maze.layout, domain.tiles, domain.meanings, domain=domain.name, **details
        )
        counts = (*maze.layout.shape, others.walls, maze.shortest, one.runs)
        rows.append([path, *counts, one.rate, one.low, one.high, one.mean_length])
    print(f"{folder}: {len(rows)} layouts")
    write_csv(places.table.path, TABLE, rows)
    print(places.table)
    rates = (own, *others.rates)
    titles = [
        f"{'random' if number else plan.name}: path {maze.shortest}, success {rate:.0%}"
        for number, (maze, rate) in enumerate(
            zip((others.given, *others.mazes), rates, strict=True)
        )
    ]
    save_figure(draw_mazes([others.given, *others.mazes], titles), places.picture.path)
    print(places.picture)
    return {
        "mean": others.mean,
        "standard_error": others.standard_error,
        "mazes": len(rows),
        "walls": others.walls,
        "runs": others.results[0].runs,
        "rates": others.rates,
        "shortest": lengths,
        "table": places.table.path,
    }


def draw_episode(path: Path, weights: Weights, plan: Plan, seed: int, steps: int) -> None:
    """Draw one episode as an animation."""
    from qdenv.study.motion import trace_agent
    from qdenv.view.film import save_film

    motion = trace_agent(plan, seed, steps, weights)
    save_film(path, plan.layout, plan.domain.tiles, motion, (0, motion.steps))
