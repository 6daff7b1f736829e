"""A training run of the maze agent: its loop, log, checkpoint and weights."""

import json
import time
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import DTypeLike

from qdenv.agent.evaluate import default_horizon, draw_mazes, run_batch
from qdenv.agent.settings import TrainConfig
from qdenv.agent.update import start, update
from qdenv.io.arrays import read_state, write_arrays, write_state
from qdenv.io.files import write_json
from qdenv.simulate.maze.policy import Weights, load_weights
from qdenv.types import InputError

_FACTS = "facts"
_EXAM_WALLS = (60, 90)  # of the held-out mazes, in a maze of 16 x 16
_EXAM_EPISODES = 8  # in each of them

Progress = Callable[[int, dict[str, Any] | None], None]
Examine = Callable[[Weights], dict[str, float]]

_play = jax.jit(run_batch, static_argnums=(3, 4))
_update = jax.jit(update, static_argnums=1)


class Facts(NamedTuple):
    """What a checkpoint of a training says beside its arrays."""

    cpu_seconds: float = 0.0  # spent so far


def save_weights(weights: Weights, path: Path, dtype: DTypeLike = np.float32) -> None:
    """Write an agent that `policy.load_weights` reads; InputError where that is impossible."""
    named = zip(Weights._fields, weights, strict=True)
    arrays: dict[str, np.ndarray] = {name: np.asarray(array, dtype) for name, array in named}
    write_arrays(path, arrays, compressed=True)


def load_state(path: Path, like: Any) -> tuple[Any, Facts]:
    """Read a checkpoint into the structure of `like`; InputError if damaged or of other sizes."""
    leaves, structure = jax.tree.flatten(like)
    arrays, facts = read_state(path, _FACTS, Facts)
    sizes = {str(number): (leaf.shape, leaf.dtype) for number, leaf in enumerate(leaves)}
    if {name: (leaf.shape, leaf.dtype) for name, leaf in arrays.items()} != sizes:
        raise InputError(f"{path} belongs to a run with other sizes: keep units, lanes and bank")
    return jax.tree.unflatten(structure, [jnp.asarray(arrays[name]) for name in sizes]), facts


def _exam(config: TrainConfig) -> Examine:
    """Prepare the held-out mazes: weights -> success rate for each number of walls."""
    size, batches = config.levels.size, {}
    for walls in _EXAM_WALLS:
        # As many walls as in a maze of 16 x 16, in proportion to the area.
        count = walls * size * size // 256
        mazes = draw_mazes(12345 + count, config.exam, (size, size), count)
        batches[f"exam_{walls}"] = np.array([maze.layout for maze in mazes])
    horizon = default_horizon(next(iter(batches.values()))[0])

    def examine(weights: Weights) -> dict[str, float]:
        key = jax.random.key(99)
        return {
            name: float(
                _play(weights, jnp.asarray(batch), key, _EXAM_EPISODES, horizon).success.mean()
            )
            for name, batch in batches.items()
        }

    return examine


def choose(out: Path, average: int, examine: Examine) -> dict[str, float]:
    """Keep the mean of the last agents of a run, or the last alone where that solves more.

    Late agents of one training lie around a point that does better than they where mazes are
    unlike those of the training (Izmailov et al. 2018, https://arxiv.org/abs/1803.05407).

    Returns:
        the log's columns: success rates of the last agent, and of the mean.

    Raises:
        InputError: a file is damaged, or of an agent of another size.
    """
    paths = sorted((out / "agents").glob("*.npz"))[-average:]
    agents = [load_weights(path) for path in paths]
    for path, weights in zip(paths, agents, strict=True):
        if [part.shape for part in weights] != [part.shape for part in agents[0]]:
            raise InputError(f"{path}: an agent of another size than {paths[0]}")
    mean = Weights(*(np.mean(parts, axis=0) for parts in zip(*agents, strict=True)))
    alone, together = examine(agents[-1]), examine(mean)
    better = mean if sum(together.values()) >= sum(alone.values()) else agents[-1]
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
        resume: go on from the folder's checkpoint; `config` may have more steps or another method,
            but no other sizes.
        report_every: updates between two lines of the log, each with a checkpoint and an exam.
        cpu_seconds: stop after about this many CPU seconds, ready to be resumed.
        progress: called with the number of updates, and after some of them the log's new line.

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
        leaves = {str(n): np.asarray(leaf) for n, leaf in enumerate(jax.tree.leaves(state))}
        write_state(checkpoint, leaves, {"cpu_seconds": spent}, _FACTS)
        save_weights(state.weights, out / "agents" / f"{done:06}.npz")
        row |= choose(out, config.average, examine)
        with (out / "curve.jsonl").open("a") as log:
            log.write(json.dumps(row) + "\n")
        progress(done, row)
        if last:
            break
    return out / "agent.npz"
