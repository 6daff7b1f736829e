"""Commands about mazes and their agent: train-agent, convert-agent, evaluate-agent."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import jax
import jax.numpy as jnp
import numpy as np
import tyro

from qdenv.agent import convert, train
from qdenv.agent.evaluate import compare_with_random, default_horizon
from qdenv.agent.evaluate import evaluate_agent as measure_success
from qdenv.agent.update import TrainConfig
from qdenv.files import write_json
from qdenv.formats.layouts import read_layout
from qdenv.plots.maze import save_episode
from qdenv.simulate.maze.episode import trace_episode
from qdenv.simulate.maze.policy import Weights, load_weights
from qdenv.simulate.maze.tables import prepare
from qdenv.simulate.maze.world import TILES


def train_agent(
    config: Annotated[TrainConfig, tyro.conf.arg(name="")],
    out: Path = Path("runs/agent"),
    resume: bool = False,
    report_every: int = 50,
    cpu_seconds: float = float("inf"),
) -> None:
    """Train an agent for mazes: PPO over a curriculum of random mazes.

    Args:
        config: the run.
        out: folder of the run: log, checkpoint and agent.npz.
        resume: go on from the folder's checkpoint.
        report_every: updates between two lines of the log.
        cpu_seconds: stop after about so many CPU seconds, ready to be resumed.
    """
    print(train.train_agent(config, out, resume, report_every, cpu_seconds))


def convert_agent(checkpoint: tyro.conf.Positional[Path], out: Path = Path("agent.npz")) -> None:
    """Convert the published agent's checkpoint (model_20000.tar) into an agent of ours.

    Args:
        checkpoint: your copy of the file; read without PyTorch, nothing in it is executed.
        out: the agent to write.
    """
    print(convert.convert_agent(checkpoint, out))


@dataclass(frozen=True)
class Episodes:
    """Who walks through the maze, how often, and for how long.

    Attributes:
        agent: an agent.npz; the shipped one unless given.
        runs: independent episodes.
        horizon: actions per episode; twice the tiles of the ringed maze unless given.
        seed: of headings and actions.
        reference_batching: repeat the published evaluation's two quirks, for comparison.
    """

    agent: str = ""
    runs: int = 100
    horizon: int | None = None
    seed: int = 0
    reference_batching: bool = False


def evaluate_agent(
    layout: tyro.conf.Positional[Path],
    episodes: Annotated[Episodes, tyro.conf.arg(name="")] = Episodes(),
    random_mazes: int = 0,
    gif: Path | None = None,
    json_file: Annotated[Path | None, tyro.conf.arg(name="json")] = None,
) -> None:
    """Let the agent solve a maze many times: success rate with its 95 % interval.

    Args:
        layout: layout file with ' ' for empty tiles and 'X' for walls.
        episodes: who walks, how often, for how long.
        random_mazes: also solve so many random mazes with as many walls and a path length within
            0.8 to 1.2 of this one's.
        gif: draw one episode.
        json_file: where to write the numbers.
    """
    maze, weights, seed = read_layout(layout, TILES), load_weights(episodes.agent), episodes.seed
    result = measure_success(
        weights, maze, seed, episodes.runs, episodes.horizon, episodes.reference_batching
    )
    print(
        f"success {result.rate:.1%} ({result.low:.1%} to {result.high:.1%}) in {result.runs} runs, "
        f"{result.mean_length:.0f} actions on average, shortest path {result.shortest} moves"
    )
    if random_mazes:
        others = compare_with_random(weights, maze, mazes=random_mazes, seed=seed)
        print(f"{others.mazes} random mazes: {others.mean:.1%} +- {others.standard_error:.1%}")
    if json_file:
        write_json(json_file, result._asdict())
    if gif:
        draw_episode(gif, weights, maze, episodes)
        print(gif)


def draw_episode(path: Path, weights: Weights, maze: np.ndarray, episodes: Episodes) -> None:
    """Draw one episode as an animation."""
    tables = prepare(weights, jnp.asarray(maze))
    steps = episodes.horizon or default_horizon(maze)
    episode, poses = trace_episode(weights, tables, jax.random.key(episodes.seed), steps)
    shown = slice(0, int(episode.length) + 1)
    cells, headings = (np.asarray(pose)[shown] for pose in poses)
    save_episode(path, maze, int(tables.course.goal), cells, headings)
