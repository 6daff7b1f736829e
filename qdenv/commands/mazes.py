"""Commands about mazes and their agent: train-agent, convert-agent, evaluate-agent."""

from __future__ import annotations

import json
import shlex
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import cattrs
import numpy as np
import tyro

from qdenv import interrupt
from qdenv.agent.settings import TrainConfig
from qdenv.commands.choices import LayoutFile
from qdenv.commands.output import MOVING_PICTURES, JsonFile, place, write_facts
from qdenv.commands.waiting import waiting
from qdenv.study.plans import read_plan
from qdenv.types import InputError

if TYPE_CHECKING:
    from qdenv.simulate.maze.policy import Weights

MOST_RUNS = 1_000_000
MAZES = ("maze-walls", "maze-entropy")


def train_agent(
    config: Annotated[TrainConfig, tyro.conf.arg(name="")] = TrainConfig(),  # noqa: B008 (frozen)
    out: Annotated[Path, tyro.conf.arg(aliases=("--run-dir",))] = Path("runs/agent"),
    resume: bool = False,
    report_every: int = 50,
    cpu_seconds: float = float("inf"),
) -> None:
    """Train an agent for mazes: PPO over a curriculum of random mazes.

    Args:
        config: the run.
        out: folder of the run: log, checkpoint and agent.npz.
        resume: go on from the folder's checkpoint; `qdenv resume FOLDER` does the same.
        report_every: updates between two lines of the log.
        cpu_seconds: stop after about so many CPU seconds, ready to be resumed.
    """
    if report_every < 1:
        raise InputError(f"--report-every {report_every}: give 1 or more")
    if out.exists() and not out.is_dir():
        raise InputError(f"{out}: that is a file: name a folder")
    if not resume and (out / "checkpoint.npz").exists():
        raise InputError(f"{out}: holds a run already; `qdenv resume {out}` continues it")
    if resume and not (out / "checkpoint.npz").exists():
        raise InputError(f"{out}: no run to resume (checkpoint.npz is missing)")
    if resume and config.steps < read_config(out).steps:
        raise InputError(f"{out}: more steps are asked for already: ask for more, or as many")
    from qdenv.agent.train import train_agent as train  # imports jax and optax

    if resume:
        interrupt.advise(f"`qdenv resume {shlex.quote(str(out))}` goes on")
    with waiting("training the agent", config.updates) as bar:
        known = [0]

        def show(done: int, row: dict[str, Any] | None) -> None:
            bar.update(done - known[0])
            known[0] = done
            if row:  # a checkpoint was written before
                interrupt.advise(f"`qdenv resume {shlex.quote(str(out))}` goes on")
                exams = ", ".join(
                    f"{row[name]:.0%} of {name[5:]} walls" for name in row if name[:5] == "exam_"
                )
                bar.print(f"update {done} of {config.updates}: solves {exams}")

        agent = train(config, out, resume, report_every, cpu_seconds, show)
    print(agent)


def is_agent_run(path: Path) -> bool:
    """Tell the folder of an agent's training from that of a search."""
    return (path / "checkpoint.npz").exists() and (path / "config.json").exists()


def resume_agent(path: Path) -> None:
    """Go on with an agent's training as it was configured."""
    train_agent(read_config(path), path, resume=True)


def read_config(path: Path) -> TrainConfig:
    """Read how the training in a folder was configured.

    Raises:
        InputError: its configuration cannot be read.
    """
    try:
        return cattrs.structure(json.loads((path / "config.json").read_text()), TrainConfig)
    except (OSError, ValueError, cattrs.BaseValidationError, KeyError) as error:
        raise InputError(f"{path}/config.json: cannot be read ({error})") from error


def convert_agent(checkpoint: tyro.conf.Positional[Path], out: Path | None = None) -> None:
    """Convert the published agent's checkpoint (model_20000.tar) into an agent of ours.

    Args:
        checkpoint: your copy of the file; read without PyTorch, nothing in it is executed.
        out: the agent to write; agent.npz unless given.
    """
    target = place(out, "agent.npz", (".npz",), [checkpoint])
    from qdenv.agent import convert  # imports jax

    convert.convert_agent(checkpoint, target.path)
    print(target)


@dataclass(frozen=True)
class Episodes:
    """Who walks through the maze, how often, and for how long.

    Attributes:
        agent: an agent.npz; the shipped one unless given.
        runs: independent episodes.
        timesteps: actions per episode; twice the tiles of the ringed maze unless given.
        seed: of headings and actions.
        reference_batching: repeat the published evaluation's two quirks, for comparison.
    """

    agent: str = ""
    runs: int = 100
    timesteps: Annotated[int | None, tyro.conf.arg(aliases=("--horizon",))] = None
    seed: int = 0
    reference_batching: bool = False

    def __post_init__(self) -> None:
        """Refuse numbers that make no episode."""
        if not 1 <= self.runs <= MOST_RUNS:
            raise InputError(f"--runs {self.runs}: give 1 to {MOST_RUNS:,}")
        if self.timesteps is not None and not 1 <= self.timesteps < 2**31:
            raise InputError(f"--timesteps {self.timesteps}: give 1 or more, or leave it out")
        if not 0 <= self.seed < 2**32:
            raise InputError(f"--seed {self.seed}: give 0 to {2**32 - 1}")


def evaluate_agent(
    layout: LayoutFile,
    episodes: Annotated[Episodes, tyro.conf.arg(name="")] = Episodes(),
    random_mazes: int = 0,
    gif: Path | None = None,
    json_file: JsonFile = None,
) -> None:
    """Let the agent solve a maze many times: success rate with its 95 % interval.

    Args:
        layout: layout file of a maze.
        episodes: who walks, how often, for how long.
        random_mazes: also solve so many random mazes with as many walls and a path length within
            0.8 to 1.2 of this one's.
        gif: draw one episode.
        json_file: where to write the numbers; - for standard output.
    """
    plan = read_plan(layout, None)
    if plan.domain.name not in MAZES:
        raise InputError(f"{layout}: a layout of {plan.domain.name}, the agent walks in mazes")
    picture = place(gif, "episode.gif", MOVING_PICTURES, [layout]) if gif else None
    # Only now: what is above answers at once, and these import jax.
    from qdenv.agent.evaluate import compare_with_random, default_horizon
    from qdenv.agent.evaluate import evaluate_agent as measure_success
    from qdenv.simulate.maze.policy import load_weights

    maze, weights, seed = plan.layout, load_weights(episodes.agent), episodes.seed
    steps = episodes.timesteps or default_horizon(maze)
    with waiting(f"solving {layout} {episodes.runs} times"):
        result = measure_success(
            weights, maze, seed, episodes.runs, steps, episodes.reference_batching
        )
    facts = result._asdict()
    print(
        f"success {result.rate:.1%} ({result.low:.1%} to {result.high:.1%}) in {result.runs} runs "
        f"of at most {steps} timesteps, {result.mean_length:.0f} actions on average, shortest path "
        f"{result.shortest} moves"
    )
    if random_mazes:
        with waiting(f"solving {random_mazes} random mazes"):
            others = compare_with_random(weights, maze, mazes=random_mazes, seed=seed)
        facts["random_mazes"] = others._asdict()
        print(f"{others.mazes} random mazes: {others.mean:.1%} +- {others.standard_error:.1%}")
    settings = {"layout": layout, "timesteps": steps, "seed": seed}
    write_facts(
        json_file, "evaluate-agent", facts, **settings, agent=episodes.agent or "the shipped one"
    )
    if picture:
        draw_episode(picture.path, weights, maze, seed, steps)
        print(picture)


def draw_episode(path: Path, weights: Weights, maze: np.ndarray, seed: int, steps: int) -> None:
    """Draw one episode as an animation."""
    import jax
    import jax.numpy as jnp

    from qdenv.plots.maze import save_episode
    from qdenv.simulate.maze.episode import trace_episode
    from qdenv.simulate.maze.tables import prepare

    tables = prepare(weights, jnp.asarray(maze))
    episode, poses = trace_episode(weights, tables, jax.random.key(seed), steps)
    shown = slice(0, int(episode.length) + 1)
    cells, headings = (np.asarray(pose)[shown] for pose in poses)
    save_episode(path, maze, int(tables.course.goal), cells, headings)
