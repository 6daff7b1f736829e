"""A training run of the maze agent: its updates, loop, log, checkpoint and weights."""

import json
import time
from collections.abc import Callable
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import optax

from qdenv.agent import levels
from qdenv.agent.evaluate import default_horizon, draw_mazes, run_batch
from qdenv.agent.ppo import Batch, EnvState, Rewards, advantages, collect, learn, reset_env, unroll
from qdenv.agent.settings import TrainConfig, refuse_second_training
from qdenv.devices import check_memory
from qdenv.interrupt import advise
from qdenv.io.arrays import read_state, write_arrays, write_state
from qdenv.io.files import locked, write_json
from qdenv.simulation.maze import policy
from qdenv.simulation.maze.policy import Weights, load_weights
from qdenv.types import InputError

_FACTS = "facts"
_EXAM_WALLS = (60, 90)  # of the held-out mazes, in a maze of 16 x 16
_EXAM_EPISODES = 8  # in each of them

_Examine = Callable[[Weights], dict[str, float]]


class State(NamedTuple):
    """Everything a training run carries from update to update."""

    weights: Weights
    optimiser: optax.OptState
    envs: EnvState  # leading axis E
    buffer: levels.LevelBuffer
    key: jax.Array  # raw key data, uint32 [2]
    update: jax.Array  # int32
    # the policy to stay near, and its memory of what the environments have seen [E, L]
    anchor: tuple[Weights, policy.Memory] | None = None


_new_buffer = jax.jit(levels.new_buffer, static_argnums=(1, 2))
_reset_all = jax.vmap(reset_env, (None, 0, 0, 0, 0))


def _optimiser(config: TrainConfig) -> optax.GradientTransformation:
    """Adam with a clipped gradient; the rate is set from outside so that `steps` may change."""
    adam = optax.inject_hyperparams(optax.adam)(learning_rate=config.rate, eps=1e-5)
    return optax.chain(optax.clip_by_global_norm(1.0), adam)


def start(config: TrainConfig) -> State:
    """Draw the first state of a run; InputError if a warm start has other sizes."""
    keys = jax.random.split(jax.random.key(config.seed), 5)
    weights = policy.draw_weights(keys[0], config.units, config.actions)
    if config.warm_start:
        loaded = load_weights(config.warm_start)
        if any(a.shape != b.shape for a, b in zip(loaded, weights, strict=True)):
            raise InputError(f"{config.warm_start} has other units or actions than configured")
        weights = Weights(*map(jnp.asarray, loaded))
    buffer, lanes = _new_buffer(keys[1], config.bank, config.levels), config.ppo.lanes
    slot = jax.random.randint(keys[2], (lanes,), 0, config.bank)
    heading = jax.random.randint(keys[3], (lanes,), 0, 4)
    level = jax.tree.map(lambda x: x[slot], buffer.level)
    envs = _reset_all(weights, level, slot, buffer.serial[slot], heading)
    anchor = (weights, policy.blank_memory(weights, (lanes,))) if config.anchor else None
    optimiser, key = _optimiser(config).init(weights), jax.random.key_data(keys[4])
    return State(weights, optimiser, envs, buffer, key, jnp.int32(0), anchor)


def _renew(
    key: jax.Array, state: State, config: TrainConfig, on_trial: bool, rewards: Rewards
) -> levels.LevelBuffer:
    """Propose new levels and let them in; `on_trial` after a trial without learning."""
    keys, fresh = jax.random.split(key), config.fresh
    probabilities = levels.replay_probabilities(state.buffer, state.update, on_trial)

    def propose(key: jax.Array) -> levels.Level:
        if config.method != "accel":
            return levels.draw_level(key, config.levels)
        # In half of the cases edit one that is worth replaying.
        keys = jax.random.split(key, 4)
        parent = jax.random.choice(keys[0], probabilities.shape[0], p=probabilities)
        level = jax.tree.map(lambda x: x[parent], state.buffer.level)
        edited = levels.vary_level(keys[1], level, config.levels)
        new, edits = levels.draw_level(keys[2], config.levels), jax.random.bernoulli(keys[3])
        return jax.tree.map(lambda a, b: jnp.where(edits, a, b), edited, new)

    proposed = jax.vmap(propose)(jax.random.split(keys[0], fresh))
    score = jnp.zeros(fresh)
    if on_trial:
        trial, number = jax.random.split(keys[1]), jnp.arange(fresh)
        heading = jax.random.randint(trial[0], (fresh,), 0, 4)
        _, steps, last_value = collect(
            trial[1],
            state.weights,
            _reset_all(state.weights, proposed, number, number, heading),
            lambda _, env: (jax.tree.map(lambda x: x[env], proposed), env, env),  # the same level
            config.ppo.timesteps,
            rewards,
        )
        score = jnp.maximum(advantages(steps, last_value, config.ppo), 0).mean(0)
    return levels.insert(state.buffer, proposed, score, state.update, on_trial)


@partial(jax.jit, static_argnums=1)
def update(state: State, config: TrainConfig) -> tuple[State, dict[str, jax.Array]]:
    """Renew the buffer, play its levels, learn; traceable. Returns also numbers for the log."""
    on_trial = config.method != "dr"
    keys = jax.random.split(jax.random.wrap_key_data(state.key), 4)
    done = jnp.minimum(state.update / config.updates, 1.0)  # share of the training
    novelty: jax.Array | float = config.reward.novelty
    if config.novelty_until < 1:
        novelty = novelty * jnp.clip(2 - 2 * done / config.novelty_until, 0.0, 1.0)
    rewards = novelty, config.reward.progress, config.reward.haste
    buffer = _renew(keys[0], state, config, on_trial, rewards)
    probabilities = levels.replay_probabilities(buffer, state.update, on_trial)
    cumulative = jnp.cumsum(probabilities)

    def next_level(draw: jax.Array, env: jax.Array) -> tuple[levels.Level, jax.Array, jax.Array]:
        # Inverse transform sampling; the sum may miss 1 by a rounding, the slot the last level.
        slot = jnp.searchsorted(cumulative, draw * cumulative[-1], side="right")
        slot = jnp.minimum(slot, probabilities.size - 1)
        return jax.tree.map(lambda x: x[slot], buffer.level), slot, buffer.serial[slot]

    envs, steps, last_value = collect(
        keys[1], state.weights, state.envs, next_level, config.ppo.timesteps, rewards
    )
    advantage = advantages(steps, last_value, config.ppo)
    if on_trial:
        buffer = levels.update_scores(buffer, state.update, steps.slot, steps.serial, advantage)
    # What the anchor would have done at every step, as log probabilities [T, E, N].
    anchor, anchored = state.anchor, jnp.zeros((*steps.action.shape, 0))
    if anchor is not None:
        memory, hidden = unroll(anchor[0], steps, anchor[1])
        anchored = jax.nn.log_softmax(policy.act(anchor[0], hidden))
        anchor = anchor[0], memory
    batch = Batch(steps, state.envs.memory, advantage, advantage + steps.value, anchored)
    clipping, adam = state.optimiser
    rate, entropy = config.rate * (1 - 0.95 * done), config.entropy * (1 - 0.9 * done)
    adam = adam._replace(hyperparams={**adam.hyperparams, "learning_rate": rate})
    learner = _optimiser(config), (clipping, adam)
    weights, optimiser, log = learn(
        keys[2], state.weights, *learner, batch, config.ppo, entropy, config.anchor
    )
    key, ended = jax.random.key_data(keys[3]), steps.done.sum()
    longest = (steps.done & steps.longest).sum()
    log |= {
        "success": steps.success.sum() / jnp.maximum(ended, 1),
        "success_longest": (steps.success & steps.longest).sum() / jnp.maximum(longest, 1),
        "bank_score": buffer.score.mean(),
    }
    return State(weights, optimiser, envs, buffer, key, state.update + 1, anchor), log


def save_weights(weights: Weights, path: Path) -> None:
    """Write an agent that `policy.load_weights` reads; InputError where that is impossible."""
    arrays = {name: np.asarray(one, np.float32) for name, one in weights._asdict().items()}
    write_arrays(path, arrays, compressed=True)


def load_state(path: Path, like: Any) -> tuple[Any, float]:
    """Read a checkpoint into the structure of `like`: (state, CPU seconds spent so far).

    Raises InputError if it is damaged or of other sizes.
    """
    leaves, structure = jax.tree.flatten(like)
    arrays, facts = read_state(path, _FACTS, dict[str, float])
    sizes = {str(number): (leaf.shape, leaf.dtype) for number, leaf in enumerate(leaves)}
    if {name: (leaf.shape, leaf.dtype) for name, leaf in arrays.items()} != sizes:
        raise InputError(f"{path} belongs to a run with other sizes: keep those of its config.json")
    leaves = [jnp.asarray(arrays[name]) for name in sizes]
    return jax.tree.unflatten(structure, leaves), facts.get("cpu_seconds", 0.0)


def _exam(config: TrainConfig) -> _Examine:
    """Prepare the held-out mazes: weights -> success rate for each number of walls."""
    size, batches = config.levels.size, {}
    for walls in _EXAM_WALLS:
        # As many walls as in a maze of 16 x 16, in proportion to the area.
        count = walls * size * size // 256
        mazes = draw_mazes(12345 + count, config.exam, (size, size), count)
        batches[f"exam_{walls}"] = np.array([maze.layout for maze in mazes])
    horizon = default_horizon(np.zeros((size, size)))

    def examine(weights: Weights) -> dict[str, float]:
        key = jax.random.key(99)
        return {
            name: float(
                run_batch(weights, jnp.asarray(batch), key, _EXAM_EPISODES, horizon).success.mean()
            )
            for name, batch in batches.items()
        }

    return examine


def choose(out: Path, average: int, examine: _Examine) -> dict[str, float]:
    """Keep the mean of the last agents of a run, or the last alone where that solves more.

    The mean of late agents may do better than each (Izmailov et al. 2018,
    https://arxiv.org/abs/1803.05407); the exam decides. Returns the log's columns: success rates of
    the last agent, and of the mean. Raises InputError if a file is damaged, or of an agent of
    another size.
    """
    # By number: after a million updates names are longer.
    paths = sorted((out / "agents").glob("*.npz"), key=lambda path: path.stem.zfill(19))[-average:]
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
    progress: Callable[[int, dict[str, Any] | None], None] = lambda done, row: None,
) -> Path:
    """Train an agent and keep its log, checkpoint and weights in a folder (host side).

    The folder gets config.json, curve.jsonl, checkpoint.npz, in agents/ the agent at every line of
    the log by its update, and agent.npz, which `choose` makes of them and which is returned. Every
    `report_every` updates the log gets a line, with a checkpoint and an exam; the run stops after
    about `cpu_seconds`, ready to be resumed. To `resume`, `config` may have more steps or another
    method, but no other sizes. `progress` is called with the number of updates, and after some of
    them the log's new line. Raises InputError without a checkpoint to resume, for one of other
    sizes, or if another process is at work in the folder.
    """
    if not resume:
        refuse_second_training(out)  # before a lock is left there
    check_memory(start, config, "this training", "fewer lanes, units or levels in the bank")
    with locked(out):
        state, used = start(config), 0.0
        checkpoint = out / "checkpoint.npz"
        if resume:
            state, used = load_state(checkpoint, state)
            advise(out)
        else:
            refuse_second_training(out)
        write_json(out / "config.json", asdict(config))
        examine = _exam(config)
        # A run that was killed in its last exam has no agent.
        if int(state.update) >= config.updates and any((out / "agents").glob("*.npz")):
            choose(out, config.average, examine)
        # The log shows the seconds of the whole run, those before an interruption too.
        began, logs = time.process_time() - used, []
        while int(state.update) < config.updates:
            state, numbers = update(state, config)
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
            # First the agent, which a run killed in between writes again; last the log, of which
            # it then misses a line and repeats none.
            save_weights(state.weights, out / "agents" / f"{done:06}.npz")
            leaves = {str(n): np.asarray(leaf) for n, leaf in enumerate(jax.tree.leaves(state))}
            write_state(checkpoint, leaves, {"cpu_seconds": spent}, _FACTS)
            advise(out)  # not before: there was nothing to resume
            row |= choose(out, config.average, examine)
            with (out / "curve.jsonl").open("a") as log:
                log.write(json.dumps(row) + "\n")
            progress(done, row)
            if last:
                break
        return out / "agent.npz"
