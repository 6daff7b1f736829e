"""Commands that make an agent for mazes: train-agent, convert-agent."""

from __future__ import annotations

import shlex
from pathlib import Path
from typing import Annotated, Any

import tyro
from annotated_types import Interval

from qdenv import interrupt
from qdenv.agent.settings import TrainConfig
from qdenv.commands.output import place
from qdenv.io.records import read_json
from qdenv.progress import Bar
from qdenv.ranges import PositiveInt
from qdenv.types import InputError


def train_agent(
    config: Annotated[TrainConfig, tyro.conf.arg(name="")] = TrainConfig(),  # noqa: B008 (frozen)
    out: Annotated[Path, tyro.conf.arg(aliases=("--run-dir",))] = Path("runs/agent"),
    resume: bool = False,
    report_every: PositiveInt = 50,
    cpu_seconds: Annotated[float, Interval(gt=0)] = float("inf"),
) -> None:
    """Train an agent for mazes: PPO over a curriculum of random mazes.

    Args:
        config: the run.
        out: folder of the run: log, checkpoint, agent.npz, and the agents it averages in agents/.
        resume: go on from the folder's checkpoint; `qdenv resume FOLDER` does the same.
        report_every: updates between two lines of the log.
        cpu_seconds: stop after about so many CPU seconds, ready to be resumed.
    """
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
    with Bar("training the agent", config.updates) as bar:
        known = [0]

        def show(done: int, row: dict[str, Any] | None) -> None:
            bar.update(done - known[0])
            known[0] = done
            if row:  # a checkpoint was written before
                interrupt.advise(f"`qdenv resume {shlex.quote(str(out))}` goes on")
                exams = ", ".join(
                    f"{row[name]:.0%} (mean {row[f'mean_{name}']:.0%}) of {name[5:]} walls"
                    for name in row
                    if name[:5] == "exam_"
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
    return read_json(path / "config.json", TrainConfig)


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
