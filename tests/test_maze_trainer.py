"""The agent's trainer: levels, buffer, advantages, gradients, learning, resuming."""

import json
from dataclasses import replace
from functools import partial
from typing import get_args

import chex
import jax
import jax.numpy as jnp
import maze_oracle as oracle
import numpy as np
import optax
import pytest

from qdenv.agent import levels, ppo
from qdenv.agent import train as training
from qdenv.agent.settings import Method, TrainConfig
from qdenv.agent.train import choose, load_state, save_weights, start, train_agent, update
from qdenv.interrupt import advice
from qdenv.simulation.maze import policy
from qdenv.simulation.maze.policy import Memory, draw_weights, load_weights
from qdenv.simulation.maze.world import GOAL, WALL
from qdenv.types import InputError

pytestmark = pytest.mark.slow

SMALL = levels.LevelConfig(size=6, most_walls=20, horizon=(20, 40))
CONFIG = TrainConfig(
    method="accel",
    steps=3 * 128, units=4, bank=16, fresh=4, exam=2, levels=SMALL,
    ppo=ppo.PPOConfig(lanes=8, timesteps=16, minibatches=2),
)  # fmt: skip
REWARDS = CONFIG.reward.novelty, CONFIG.reward.progress, CONFIG.reward.haste


@pytest.fixture(scope="module")
def buffer():
    return jax.jit(levels.new_buffer, static_argnums=(1, 2))(jax.random.key(0), 16, SMALL)


@pytest.fixture(scope="module")
def recorded():
    """Play a few steps with an untrained agent."""
    state = start(CONFIG)

    def next_level(draw, env):
        del draw
        return jax.tree.map(lambda x: x[env], state.buffer.level), env, env

    _, steps, last = jax.jit(
        lambda: ppo.collect(jax.random.key(3), state.weights, state.envs, next_level, 48, REWARDS)
    )()
    return state, steps, last


def test_levels_are_solvable_and_half_are_longest_paths():
    config = replace(SMALL, textured=0.5)
    first, second = jax.random.split(jax.random.key(0), (2, 200))
    drawn = jax.jit(jax.vmap(lambda key: levels.draw_level(key, config)))(first)
    edited = jax.jit(jax.vmap(lambda key, level: levels.vary_level(key, level, config)))(
        second, drawn
    )
    for batch in (drawn, edited):
        for number in range(80):
            level = jax.tree.map(lambda x, n=number: np.asarray(x)[n], batch)
            assert (level.kinds == GOAL).sum() == 1
            goal = int(np.flatnonzero(level.kinds.reshape(-1) == GOAL)[0])
            layout = (level.kinds == WALL).astype(np.int8)
            moves = oracle.bfs(layout, goal)
            assert level.distance[int(level.start)] == moves[int(level.start)] > 0
            if level.longest:
                assert level.distance[level.start] == oracle.longest(layout[4:10, 4:10])[0]
            assert 20 <= level.horizon <= 40
    changed = (np.asarray(drawn.kinds == WALL) != np.asarray(edited.kinds == WALL)).sum((1, 2))
    assert 1 < changed.mean() <= config.edits + 2
    assert 70 < int(drawn.longest.sum()) < 130
    walls = (np.asarray(drawn.kinds[:, 4:10, 4:10]) == WALL).sum((1, 2))
    assert walls.min() <= 1 and walls.max() >= 19


def test_levels_of_many_sizes_keep_walls_and_horizon_in_proportion():
    config = levels.LevelConfig(size=9, smallest=4, most_walls=40, horizon=(121, 242))
    keys = jax.random.split(jax.random.key(2), 120)
    sides = np.arange(120) % 6 + 4
    layouts = jax.jit(jax.vmap(lambda key, side: levels.draw_layout(key, config, side)))(
        keys, sides
    )
    for layout, side in zip(np.asarray(layouts), sides, strict=True):
        assert layout[side:].all() and layout[:, side:].all()
        assert layout[:side, :side].sum() <= 40 * side**2 // 81
    # Without walls the free tiles tell the side: 121 to 242 steps at 9 x 9, less at fewer tiles.
    empty = replace(config, most_walls=0)
    draw = jax.jit(
        lambda keys, how: jax.vmap(lambda key: levels.draw_level(key, how))(keys), static_argnums=1
    )
    drawn = draw(keys, empty)
    sides = np.sqrt((np.asarray(drawn.kinds) != WALL).sum((1, 2))).astype(int)
    assert set(sides.tolist()) == {4, 5, 6, 7, 8, 9}
    low = (sides + 2) ** 2
    assert ((low <= drawn.horizon) & (drawn.horizon <= 2 * low)).all()
    fixed = draw(keys[:20], replace(empty, smallest=0))
    assert ((np.asarray(fixed.kinds) != WALL).sum((1, 2)) == 81).all()
    assert draw(keys, replace(config, horizon=(1, 3))).horizon.min() == 1
    with pytest.raises(InputError, match="in order"):
        replace(config, smallest=10)


def test_haste_takes_from_the_reward_of_the_goal(recorded):
    state, _, _ = recorded
    env = jax.tree.map(lambda x: x[0], state.envs)._replace(elapsed=jnp.int32(9))
    env = env._replace(level=env.level._replace(horizon=jnp.int32(20)))
    found = [
        float(ppo._reward(env, env.pose, jnp.bool_(True), (0.0, 0.0, haste)))
        for haste in (0.0, 0.5, 0.9)
    ]
    np.testing.assert_allclose(found, [1, 0.75, 0.55], atol=1e-6)


def test_the_buffer_keeps_the_worthy_and_replaces_the_oldest(buffer):
    buffer = jax.tree.map(lambda x: x[:8], buffer)
    fresh = jax.tree.map(lambda x: x[:3], buffer.level)
    buffer = buffer._replace(score=jnp.arange(8.0))
    new = levels.insert(buffer, fresh, jnp.array([0.5, 9.0, -1.0]), jnp.int32(4), on_trial=True)
    np.testing.assert_array_equal(np.sort(new.score), [1, 2, 3, 4, 5, 6, 7, 9])
    assert int((new.last_seen == 4).sum()) == 1
    new = levels.insert(buffer, fresh, jnp.zeros(3), jnp.int32(4), on_trial=False)
    np.testing.assert_array_equal(np.sort(new.serial), np.arange(3, 11))
    probabilities = levels.replay_probabilities(buffer, jnp.int32(0), True, staleness=0.5)
    np.testing.assert_allclose(probabilities, 0.5 * np.arange(8) / 28 + 0.5 / 8, atol=1e-6)
    np.testing.assert_allclose(levels.replay_probabilities(buffer, jnp.int32(0), False), 1 / 8)


def test_scores_are_mean_positive_advantages_of_levels_still_there(buffer):
    buffer = jax.tree.map(lambda x: x[:4], buffer)._replace(score=jnp.full(4, 7.0))
    slot = jnp.array([[0, 1], [0, 1], [2, 3]])
    serial = jnp.array([[0, 1], [0, 99], [2, 98]])
    advantage = jnp.array([[3.0, 4.0], [-1.0, 50.0], [-2.0, 60.0]])
    buffer = levels.update_scores(buffer, jnp.int32(5), slot, serial, advantage)
    np.testing.assert_allclose(buffer.score, [1.5, 4.0, 0.0, 7.0])
    np.testing.assert_array_equal(buffer.last_seen, [5, 5, 5, 0])


def test_advantages_agree_with_the_definition(recorded):
    _, steps, last = recorded
    config = ppo.PPOConfig(discount=0.9, trace=0.8)
    found = np.asarray(ppo.advantages(steps, last, config))
    reward, value, done = (np.asarray(x, float) for x in (steps.reward, steps.value, steps.done))
    values = np.concatenate([value, np.asarray(last)[None]])
    assert 0 < done.sum() < done.size
    for env in range(8):
        for t in range(48):
            total, weight = 0.0, 1.0
            for s in range(t, 48):
                after = 0.9 * values[s + 1, env] * (1 - done[s, env])
                total += weight * (reward[s, env] + after - value[s, env])
                weight *= 0.72
                if done[s, env]:
                    break
            np.testing.assert_allclose(found[t, env], total, atol=1e-5)


def test_replay_repeats_what_was_played_and_rewards_are_right(recorded):
    state, steps, _ = recorded
    _, hidden = ppo.unroll(state.weights, steps, state.envs.memory)
    logs = jax.nn.log_softmax(policy.act(state.weights, hidden))
    taken = jnp.take_along_axis(logs, steps.action[..., None], -1)[..., 0]
    np.testing.assert_allclose(taken, steps.log_prob, atol=1e-5)
    np.testing.assert_allclose(policy.estimate_value(state.weights, hidden), steps.value, atol=1e-5)
    won = np.asarray(steps.success)
    reward = np.asarray(steps.reward)
    assert won.any() and (reward[won] >= 0.1).all()
    novelty = np.float32(CONFIG.reward.novelty)
    assert set(np.unique(reward[~won])) <= {np.float32(0), novelty}


def test_learning_raises_the_odds_of_rewarded_actions(recorded):
    state, steps, _ = recorded
    advantage = jnp.where(steps.action == 2, 1.0, -1.0)
    batch = ppo.Batch(steps, state.envs.memory, advantage, steps.value, jnp.zeros((48, 8, 0)))
    optimiser = optax.adam(3e-3)
    weights, _, log = jax.jit(
        lambda weights: ppo.learn(
            jax.random.key(0), weights, optimiser, optimiser.init(weights), batch, CONFIG.ppo,
            jnp.float32(0.0),
        )
    )(state.weights)  # fmt: skip
    before, after = (
        jax.nn.softmax(policy.act(some, ppo.unroll(some, steps, state.envs.memory)[1]))[..., 2]
        for some in (state.weights, weights)
    )
    assert float(after.mean()) > float(before.mean()) + 0.005
    chex.assert_tree_all_finite((weights, log))


def test_an_anchor_pulls_the_policy_back(recorded):
    state, steps, _ = recorded
    anchor = draw_weights(jax.random.key(5), 4, 4)
    anchor = anchor._replace(logits_bias=jnp.array([0.0, 1.0, 2.0, 0.0]))
    blank = Memory(jnp.zeros((8, 4)), jnp.zeros((8, 4)))
    # Half after half, with the memory carried over, is as good as all at once.
    unroll = jax.jit(ppo.unroll)
    halves = [jax.tree.map(lambda x, p=part: x[p], steps) for part in (slice(24), slice(24, 48))]
    memory, first = unroll(anchor, halves[0], blank)
    _, second = unroll(anchor, halves[1], memory)
    _, hidden = unroll(anchor, steps, blank)
    np.testing.assert_allclose(jnp.concatenate([first, second]), hidden, atol=1e-6)
    known = jax.nn.log_softmax(policy.act(anchor, hidden))

    @jax.jit
    def divergence(weights):
        _, hidden = ppo.unroll(weights, steps, state.envs.memory)
        found = jax.nn.log_softmax(policy.act(weights, hidden))
        return (jnp.exp(known) * (known - found)).sum(-1).mean()

    # Without any advantage nothing but the anchor moves the policy, and 0 moves it not at all.
    nothing = jnp.zeros_like(steps.value)
    batch = ppo.Batch(steps, state.envs.memory, nothing, steps.value, known)
    optimiser = optax.adam(1e-2)

    @partial(jax.jit, static_argnums=1)
    def learn(weights, weight):
        return ppo.learn(
            jax.random.key(0), weights, optimiser, optimiser.init(weights), batch,
            replace(CONFIG.ppo, critic=0.0), jnp.float32(0.0), weight,
        )[0]  # fmt: skip

    after = [divergence(learn(state.weights, weight)) for weight in (0.0, 1.0)]
    before = divergence(state.weights)
    np.testing.assert_allclose(after[0], before, atol=1e-6)
    assert after[1] < 0.9 * before


def test_far_pairs_are_nearly_the_longest():
    config = levels.LevelConfig(size=8, most_walls=28)
    keys = jax.random.split(jax.random.key(4), 40)
    drawn = jax.jit(jax.vmap(lambda key: levels.draw_layout(key, config, jnp.int32(8))))(keys)
    layouts, find = np.asarray(drawn), jax.jit(levels.far_pair)
    found = jax.jit(jax.vmap(levels.far_pair))(keys, layouts)
    ratios = []
    for layout, one, two, length in zip(layouts, *map(np.asarray, found), strict=True):
        assert oracle.bfs(layout, int(two))[int(one)] == length
        ratios.append(length / oracle.longest(layout)[0])
    assert max(ratios) == 1 and np.mean(ratios) > 0.95
    assert int(find(keys[0], jnp.ones((8, 8), jnp.int8)).length) == 0


@pytest.mark.parametrize(("size", "most"), [(16, 999), (300, 90_000)])
def test_large_mazes_have_up_to_as_many_walls_as_tiles(size, most):
    config = levels.LevelConfig(size=size, most_walls=most, textured=0.0)
    draw = jax.jit(jax.vmap(lambda key: levels.draw_layout(key, config, jnp.int32(size))))
    shares = np.asarray(draw(jax.random.split(jax.random.key(0), 16)).mean(axis=(1, 2)))
    assert shares.min() < 0.2 and shares.max() > 0.8 and 0.3 < shares.mean() < 0.7


def test_trials_fill_the_buffer_with_scores():
    state, go = start(CONFIG), jax.jit(update, static_argnums=1)
    for _ in range(3):
        state, numbers = go(state, CONFIG)
    assert int(state.update) == 3
    assert int((state.buffer.score > 0).sum()) > 0
    assert int(state.buffer.serial.max()) > 15  # new levels were admitted
    assert np.isfinite(list(numbers.values())).all()


def test_a_checkpoint_holds_the_anchor_the_run_began_with(tmp_path):
    first = draw_weights(jax.random.key(6), 4, 4)
    save_weights(first, tmp_path / "first.npz")
    config = replace(CONFIG, method="dr", warm_start=str(tmp_path / "first.npz"), anchor=0.5)
    train_agent(config, tmp_path / "run", report_every=1, cpu_seconds=0)
    state, _ = load_state(tmp_path / "run/checkpoint.npz", start(config))
    chex.assert_trees_all_equal(state.anchor[0], first)
    assert np.abs(state.anchor[1].hidden).max() > 0
    assert (state.weights.actor != first.actor).any()


@pytest.mark.parametrize("method", get_args(Method))
def test_a_run_may_change_its_method(method):
    state = jax.eval_shape(lambda: start(CONFIG))
    later, _ = jax.eval_shape(lambda state: update(state, replace(CONFIG, method=method)), state)
    assert jax.tree.map(lambda x: (x.shape, x.dtype), later) == jax.tree.map(
        lambda x: (x.shape, x.dtype), state
    )


def test_a_resumed_run_equals_an_uninterrupted_one(tmp_path, monkeypatch):
    config = replace(CONFIG, average=1)  # for a run in parts has more lines to take the mean of
    advised = []
    with monkeypatch.context() as patch:
        patch.setattr(training, "choose", lambda *args: advised.append(advice()) or choose(*args))
        whole = np.load(train_agent(config, tmp_path / "whole", report_every=2))
    assert advised == [f"`qdenv resume {tmp_path / 'whole'}` goes on"] * 2  # in the exams
    part = tmp_path / "part"
    train_agent(config, part, report_every=2, cpu_seconds=0)
    assert len((part / "curve.jsonl").read_text().splitlines()) == 1
    resumed = np.load(train_agent(config, part, resume=True, report_every=2))
    for name in whole.files:
        np.testing.assert_array_equal(whole[name], resumed[name])
    rows = [json.loads(row) for row in (part / "curve.jsonl").read_text().splitlines()]
    assert [row["update"] for row in rows] == [1, 2, 3]
    kept = sorted((part / "agents").iterdir())
    assert [path.name for path in kept] == ["000001.npz", "000002.npz", "000003.npz"]
    np.testing.assert_array_equal(np.load(kept[-1])["kernel"], whole["kernel"])
    assert (np.load(kept[0])["kernel"] != whole["kernel"]).any()
    assert all(0 <= row["exam_90"] <= 1 for row in rows)
    (part / "agent.npz").rename(made := tmp_path / "made.npz")  # as if killed in the last exam
    resumed = np.load(train_agent(config, part, resume=True))
    for name, array in np.load(made).items():
        np.testing.assert_array_equal(resumed[name], array)
    for path in (part / "agents").iterdir():  # who has the agent may do without those before it
        path.unlink()
    assert train_agent(config, part, resume=True) == part / "agent.npz"
    with pytest.raises(InputError, match="holds a run already"):
        train_agent(CONFIG, part)
    with pytest.raises(InputError, match="other sizes"):
        train_agent(replace(CONFIG, units=5), part, resume=True)
    (part / "checkpoint.npz").write_bytes(b"no")
    with pytest.raises(InputError, match=r"checkpoint\.npz: cannot be read"):
        train_agent(CONFIG, part, resume=True)


@pytest.mark.parametrize("best", ["mean", "last"])
def test_the_mean_of_the_last_agents_is_kept_unless_the_last_solves_more(tmp_path, best):
    agents = [draw_weights(jax.random.key(seed), 4, 3) for seed in range(3)]
    for number, agent in enumerate(agents):
        save_weights(agent, tmp_path / "agents" / f"{999_998 + number:06}.npz")
    means = jax.tree.map(lambda one, other: (one + other) / 2, *agents[1:])
    expected = {"mean": means, "last": agents[2]}[best]

    def examine(weights):
        return {"exam_60": float(np.allclose(weights.kernel, expected.kernel))}

    row = choose(tmp_path, 2, examine)
    assert row == {"exam_60": best == "last", "mean_exam_60": best == "mean"}
    chex.assert_trees_all_close(load_weights(tmp_path / "agent.npz"), expected, rtol=1e-6)


def test_agents_of_different_sizes_have_no_mean(tmp_path):
    for units in (4, 5):
        agent = draw_weights(jax.random.key(0), units, 3)
        save_weights(agent, tmp_path / "agents" / f"{units}.npz")
    with pytest.raises(InputError, match=r"5\.npz: an agent of another size"):
        choose(tmp_path, 2, lambda weights: {})


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        ({"method": "magic"}, "choose one of dr, plr, accel"),
        ({"actions": 2}, "actions must be at least 3"),
        ({"fresh": 17}, "fresh must be at most bank"),
        ({"ppo": ppo.PPOConfig(lanes=8, minibatches=3)}, "divide"),
        ({"warm_start": "/nowhere.npz"}, "there is no agent"),
        ({"anchor": 0.5}, "add --warm-start"),
        ({"ppo": ppo.PPOConfig(lanes=100_000_000)}, "GiB of memory: choose fewer lanes"),
        ({"units": 1_000_000}, "GiB of memory"),
        ({"bank": 2_000_000_000}, "GiB of memory"),
    ],
)
def test_impossible_runs_are_refused(tmp_path, change, reason):
    with pytest.raises(InputError, match=reason):
        train_agent(replace(CONFIG, **change), tmp_path)
    assert not list(tmp_path.iterdir())


def test_gradients_flow_through_time(recorded):
    # The reward of the last action must reach what was seen in the first step.
    weights = draw_weights(jax.random.key(1), 4, 3)
    _, steps, _ = recorded
    steps = steps._replace(fresh=jnp.zeros_like(steps.fresh))
    blank = Memory(jnp.zeros((8, 4)), jnp.zeros((8, 4)))

    @jax.jit
    def late(scale):
        moved = weights._replace(kernel=weights.kernel * scale)
        return ppo.unroll(moved, jax.tree.map(lambda x: x[:6], steps), blank)[1][-1].sum()

    slope = (late(1.001) - late(0.999)) / 0.002
    np.testing.assert_allclose(jax.jit(jax.grad(late))(1.0), slope, rtol=0.05, atol=1e-3)
