"""How often the agent solves grown mazes and random ones like them, at both sizes (section 6)."""

import time
from dataclasses import dataclass
from math import prod
from statistics import mean
from typing import Any, NamedTuple

import numpy as np
from matplotlib.axes import Axes

from experiments.layouts import MAZE_S, MAZE_S_EVAL, OfLayout, SavedLayout, checksum, random_like
from experiments.lines import LOOKS, finish, new_panels
from experiments.pieces import Drawn, Experiment, Folders, say, table
from experiments.published import MAZES
from qdenv.agent.evaluate import evaluate_agent, without_ring
from qdenv.io.files import write_csv
from qdenv.io.records import read_table
from qdenv.simulation.maze.policy import Weights, load_weights
from qdenv.simulation.maze.world import WALL
from qdenv.stats import sample_of, wilson_interval

GROWN = -1  # in place of a seed: the maze that the others take after
TELL = 10  # mazes between two lines on the progress


class Solved(NamedTuple):
    """The agent on one maze, a row of the file."""

    agent: str  # checksum of its weights
    like: str  # checksum of the grown maze
    maze: int  # seed of a random maze; `GROWN` for the grown one itself
    walls: int  # of the maze, inside its ring
    shortest: int  # moves of the way to the goal
    runs: int  # of the agent
    successes: int  # how many of them reached the goal
    mean_length: float  # actions, failures counted with the horizon
    cpu_seconds: float  # of drawing the maze and of all runs


@dataclass(frozen=True)
class SavedSuccess(OfLayout):
    """The shipped agent on a grown maze and on random ones like it."""

    kind = "mazes"
    label = "{0.runs} runs of {0.layout.stem} and of {0.mazes} random mazes like it"
    file = "mazes/{0.layout.stem}.csv"
    mazes: int = 100  # how many random ones
    runs: int = 100  # on each maze

    def read(self, folders: Folders) -> list[Solved]:
        """Read what is saved of this agent and this grown maze."""
        if not (self.path(folders).exists() and self.layout.done(folders)):
            return []
        now = (checksum(*load_weights()), checksum(self.layout.read(folders).layout), self.runs)
        wanted = range(GROWN, self.mazes)
        return [
            row
            for row in read_table(self.path(folders), Solved)
            if (row.agent, row.like, row.runs) == now and row.maze in wanted
        ]

    def done(self, folders: Folders) -> float:
        """Return which share of the mazes is saved."""
        return len(self.read(folders)) / (self.mazes + 1)

    def seconds(self, folders: Folders) -> float:
        """Estimate the CPU seconds of all mazes."""
        known = [row.cpu_seconds for row in self.read(folders)]
        return (self.mazes + 1) * mean(known or [0.8e-3 * prod(self.layout.shape)])

    def make(self, folders: Folders) -> None:
        """Evaluate the agent in each maze; each result is saved as it comes."""
        weights, grown = load_weights(), self.layout.read(folders).layout
        known = self.read(folders)
        for maze in sorted(set(range(GROWN, self.mazes)) - {row.maze for row in known}):
            known.append(solve(weights, grown, maze, self.runs))
            write_csv(self.path(folders), Solved._fields, known)
            if maze % TELL == 0:
                left = self.cost(folders)
                say(f"{len(known)} of {self.mazes + 1} mazes, about {left:.0f} s left: {self.name}")


def solve(weights: Weights, grown: np.ndarray, maze: int, runs: int) -> Solved:
    """Evaluate the agent in a grown maze, or in a random one like it."""
    begin = time.process_time()
    inside = without_ring(grown) if maze == GROWN else random_like(grown, maze)
    result = evaluate_agent(weights, inside, max(maze, 0), runs)
    return Solved(
        agent=checksum(*weights),
        like=checksum(grown),
        maze=maze,
        walls=int((inside == WALL).sum()),
        shortest=result.shortest,
        runs=runs,
        successes=round(result.rate * runs),
        mean_length=round(result.mean_length, 2),
        cpu_seconds=round(time.process_time() - begin, 3),
    )


PIECES = tuple(
    SavedSuccess(SavedLayout("maze-walls", "nca", shape)) for shape in (MAZE_S, MAZE_S_EVAL)
)
HEAD = (
    *("size", "grown maze: success (95 %)", "way", "walls", "random mazes: success", "mazes"),
    *("way, mean", "paper: grown, random"),
)
NOTE = (
    "100 runs of the agent that ships in each maze. Random mazes have as many walls, and a way "
    "within 0.8 to 1.2 of the grown one's; ± standard error over mazes."
)


def draw(folders: Folders) -> Drawn:
    """Draw success rates on random mazes over their ways, and on the grown one, for both sizes."""
    sizes = ["{} x {}".format(*saved.layout.shape) for saved in PIECES]
    figure, panels = new_panels(1, len(PIECES), sizes)
    rows: list[tuple[object, ...]] = []
    for axes, saved, size in zip(panels[0], PIECES, sizes, strict=True):
        axes.set(xlabel="moves of the shortest way", ylabel="success rate")
        cells = draw_rates(axes, saved.read(folders))
        rows.append((size, *cells, MAZES.get(saved.layout.shape, "")))
    finish(figure, panels)
    for axes in panels[0]:
        axes.set_ylim(-0.04, 1.04)
    return Drawn(figure, (*table(HEAD, rows), "", NOTE))


def draw_rates(axes: Axes, found: list[Solved]) -> tuple[object, ...]:
    """Draw a point per random maze, the grown one with its Wilson interval; return their row."""
    if not found:
        return ("not made yet", *[""] * 5)
    others = [row for row in found if row.maze != GROWN]
    ways, rates = [row.shortest for row in others], [row.successes / row.runs for row in others]
    axes.plot(ways, rates, "x", color=LOOKS["human"].colour, ms=5, label="random mazes")
    own: tuple[object, ...] = ("not made yet", "", "")
    for row in (row for row in found if row.maze == GROWN):
        rate, (low, high) = row.successes / row.runs, wilson_interval(row.successes, row.runs)
        own = (f"{rate:.0%} ({low:.0%} to {high:.0%})", row.shortest, row.walls)
        ends = np.maximum([[rate - low], [high - rate]], 0)
        look: Any = {"color": LOOKS["nca"].colour, "ms": 8, "capsize": 4, "label": "grown"}
        axes.errorbar([row.shortest], [rate], ends, fmt="o", **look)
    if not others:
        return (*own, "not made yet", 0, "")
    sample = sample_of(np.array(rates))
    moved = f"{100 * sample.mean:.1f} ± {100 * sample.error:.1f} %"
    return (*own, moved, len(others), f"{np.mean(ways):.0f}")


EXPERIMENT = Experiment("the agent in grown and in random mazes", PIECES, draw)
