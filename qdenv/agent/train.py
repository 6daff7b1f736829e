"""Train the maze agent: the loop around `update`, its log, checkpoints and held-out exam."""

import json
import time
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from qdenv.agent.baseline import random_mazes
from qdenv.agent.evaluate import default_horizon, run_batch
from qdenv.agent.files import load_state, mean_weights, save_state, save_weights
from qdenv.agent.settings import TrainConfig
from qdenv.agent.update import start, update
from qdenv.io.files import write_json
from qdenv.simulate.maze.policy import Weights, load_weights
from qdenv.types import InputError

Progress = Callable[[int, dict[str, Any] | None], None]
Examine = Callable[[Weights], dict[str, float]]
EXAM_WALLS = (60, 90)
EXAM_EPISODES = 8


_play = jax.jit(run_batch, static_argnums=(3, 4))
_update = jax.jit(update, static_argnums=1)


def _exam(config: TrainConfig) -> Examine:
    """Prepare the held-out mazes: weights -> success rate for each number of walls."""
    size = config.levels.size
    share = [walls * size * size // 256 for walls in EXAM_WALLS]
    mazes = [random_mazes(12345 + walls, config.exam, size, size, walls) for walls in share]
    horizon = default_horizon(mazes[0][0])

    def examine(weights: Weights) -> dict[str, float]:
        key = jax.random.key(99)
        rates = [
            _play(weights, jnp.asarray(batch), key, EXAM_EPISODES, horizon).success.mean()
            for batch in mazes
        ]
        return {f"exam_{walls}": float(rate) for walls, rate in zip(EXAM_WALLS, rates, strict=True)}

    return examine


def choose(out: Path, average: int, examine: Examine) -> dict[str, float]:
    """Keep the mean of the last agents of a run, or the last alone where that solves more.

    Returns:
        the log's columns: success rates of the last agent, and of the mean.
    """
    last = load_weights((kept := sorted((out / "agents").glob("*.npz"))[-average:])[-1])
    mean = mean_weights(kept)
    alone, together = examine(last), examine(mean)
    better = mean if sum(together.values()) >= sum(alone.values()) else last
    save_weights(better, out / "agent.npz")
    return alone | {f"mean_{name}": rate for name, rate in together.items()}


def train_agent(
    config: TrainConfig,
    out: Path,
    resume: bool = False,
    report_every: int = 50,
    cpu_seconds: float = float("inf"),
    progress: Progress = lambda done, row: None,
) -> Path:
    """Train an agent and keep its log, checkpoint and weights in a folder (host side).

    Args:
        config: the run.
        out: folder; gets config.json, curve.jsonl, checkpoint.npz, in agents/ the agent at every
            line of the log by its update, and agent.npz, the mean of the last of these.
        resume: go on from the folder's checkpoint; `config` may ask for more steps or another
            method, not for other sizes.
        report_every: updates between two lines of the log, each with a checkpoint and an exam on
            held-out mazes.
        cpu_seconds: stop after about so many CPU seconds, ready to be resumed.
        progress: told the number of updates done, and after some of them the new line of the log.

    Returns:
        the weights' file, out/agent.npz.

    Raises:
        InputError: impossible numbers, no checkpoint to resume, or one of other sizes.
    """
    state, used = start(config), 0.0
    checkpoint = out / "checkpoint.npz"
    if resume:
        state, facts = load_state(checkpoint, state)
        used = facts.cpu_seconds
    elif checkpoint.exists():
        raise InputError(f"{out}: holds a run already; `qdenv resume {out}` continues it")
    out.mkdir(parents=True, exist_ok=True)
    write_json(out / "config.json", asdict(config))
    examine = _exam(config)
    # The log shows the seconds of the whole run, those before an interruption too.
    began, logs = time.process_time() - used, []
    while int(state.update) < config.updates:
        state, numbers = _update(state, config)
        logs.append(numbers)
        done = int(state.update)
        progress(done, None)
        spent = time.process_time() - began
        last = done >= config.updates or spent - used > cpu_seconds
        if done % report_every and not last:
            continue
        mean = {name: float(np.mean([log[name] for log in logs])) for name in logs[0]}
        row = {
            "update": done,
            "steps": done * config.ppo.lanes * config.ppo.timesteps,
            "cpu_seconds": round(spent, 1),
            "method": config.method,
            **mean,
        }
        logs = []
        # The log comes last: a run killed in between misses a line of it and repeats none.
        save_state(checkpoint, state, {"cpu_seconds": spent})
        save_weights(state.weights, out / "agents" / f"{done:06}.npz")
        row |= choose(out, config.average, examine)
        with (out / "curve.jsonl").open("a") as log:
            log.write(json.dumps(row) + "\n")
        progress(done, row)
        if last:
            break
    return out / "agent.npz"
