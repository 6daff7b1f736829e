"""The agent at work: network parity, whole episodes against the oracle, the published loop."""

import jax
import jax.numpy as jnp
import maze_oracle as oracle
import numpy as np
import pytest

from qdenv.agent.convert import from_torch
from qdenv.agent.train import save_weights
from qdenv.grid import parse
from qdenv.simulation.maze import episode as maze
from qdenv.simulation.maze import policy
from qdenv.simulation.maze.episode import FIRST_HEADINGS, reference_episodes
from qdenv.types import InputError

pytestmark = pytest.mark.slow

HORIZON = 60
prepare = jax.jit(policy.prepare)
run = jax.jit(maze.run_episode, static_argnums=(3, 4))
run_many = jax.jit(jax.vmap(maze.run_episode, (None, None, 0, None, None)), static_argnums=(3, 4))
trace = jax.jit(maze.trace_episode, static_argnums=3)
run_dropping = jax.jit(maze.run_episodes, static_argnums=3)
publish = jax.jit(reference_episodes, static_argnums=(3, 4, 5))


@pytest.fixture(scope="module")
def fixture():
    return dict(np.load(oracle.DATA / "policy_random16_fixture.npz"))


@pytest.fixture(scope="module")
def tensors():
    return oracle.recorded_network()


@pytest.fixture(scope="module")
def weights(tensors):
    return jax.tree.map(jnp.asarray, from_torch(tensors))


@pytest.fixture(scope="module")
def level():
    return parse(["  X ", "X   ", "  X "], " X")


@pytest.fixture(scope="module")
def mild(weights):
    """Make the agent hesitate, so that it reaches its goal now and then."""
    return weights._replace(logits=weights.logits * 0.2, logits_bias=weights.logits_bias * 0.2)


def test_network_agrees_over_40_steps(fixture, weights):
    def body(memory, now):
        image, heading, mask = now
        memory = policy.Memory(*(part * mask[:, None] for part in memory))
        gates = policy.encode(weights, image / 10.0, jax.nn.one_hot(heading, 4))
        memory = policy.recur(weights, gates, memory)
        h = memory.hidden
        return memory, (policy.act(weights, h), policy.estimate_value(weights, h), h, memory.cell)

    steps = (fixture["image"].astype(np.float32), fixture["direction"], fixture["mask"])
    _, found = jax.lax.scan(body, policy.Memory(fixture["h0"], fixture["c0"]), steps)
    for name, ours in zip(("logits", "value", "h", "c"), found, strict=True):
        np.testing.assert_allclose(ours, fixture[name], atol=1e-5, err_msg=name)


@pytest.mark.parametrize("seed", range(6))
def test_episodes_agree_with_the_oracle(seed, tensors, weights, level):
    # The same first heading and the same uniform draws: the same walk, tile by tile.
    key = jax.random.key(seed)
    turn_key, draw_key = jax.random.split(key)
    heading = int(jax.random.randint(turn_key, (), 0, 4))
    draws = np.asarray(jax.random.uniform(draw_key, (HORIZON,)))
    success, length, poses = oracle.episode(tensors, level, heading, draws)
    tables = prepare(weights, jnp.asarray(level))
    found, path = trace(weights, tables, key, HORIZON)
    assert (bool(found.success), int(found.length)) == (success, length)
    walked = list(zip(path.position.tolist(), path.heading.tolist(), strict=True))
    if success:
        poses[-1] = (poses[-1][0], walked[length][1])
    assert walked[: length + 1] == poses


def test_loops_batches_and_traces_give_the_same_episodes(mild, level):
    tables = prepare(mild, jnp.asarray(level))
    keys = jax.random.split(jax.random.key(1), 24)
    whole = run_many(mild, tables, keys, HORIZON, maze.all_timesteps)
    early = run_many(mild, tables, keys, HORIZON, maze.until_done)
    alone = [run(mild, tables, key, HORIZON, maze.all_timesteps) for key in keys]
    assert 0 < int(whole.success.sum()) < 24
    dropping = run_dropping(mild, tables, keys, HORIZON)
    for runs in (early, dropping, jax.tree.map(lambda *x: jnp.stack(x), *alone)):
        jax.tree.map(np.testing.assert_array_equal, whole, runs)


def test_usage_is_the_share_of_actions_on_each_cell(mild, level):
    shared = prepare(mild, level)
    keys = jax.random.split(jax.random.key(5), 8)
    dropped = run_dropping(mild, shared, keys, HORIZON)
    for index, key in enumerate(keys):
        episode, poses = trace(mild, shared, key, HORIZON)
        cells = np.asarray(poses.position)[: int(episode.length)]
        expected = np.bincount(cells, minlength=level.size) / len(cells)
        np.testing.assert_allclose(episode.usage, expected.reshape(level.shape), atol=1e-6)
        np.testing.assert_allclose(dropped.usage[index], episode.usage, atol=1e-6)


def test_an_unsolvable_level_is_not_run(weights):
    for drawing in (["XX", "XX"], [" X", "X "]):
        tables = prepare(weights, jnp.asarray(parse(drawing, " X")))
        found = run(weights, tables, jax.random.key(0), 9, maze.all_timesteps)
        assert (bool(found.success), int(found.length), int(found.shortest)) == (False, 0, 0)


def test_goal_next_door_is_reached_and_a_failure_costs_the_horizon(weights):
    tables = prepare(weights, jnp.asarray(parse(["  "], " X")))
    keys = jax.random.split(jax.random.key(0), 200)
    runs = run_many(weights, tables, keys, 200, maze.all_timesteps)
    assert bool(runs.success.all()) and int(runs.length.min()) == 1
    short = run_many(weights, tables, keys, 1, maze.all_timesteps)
    # An untrained agent that faces the goal (1 of 4) drives on with one of 7 actions.
    assert 0 < int(short.success.sum()) < 40
    assert bool((short.length == 1).all())


def test_actions_follow_the_softmax():
    logits = jnp.log(jnp.array([0.5, 0.2, 0.3]))
    draws = (jnp.arange(1000) + 0.5) / 1000
    chosen = maze.choose(jnp.broadcast_to(logits, (1000, 3)), draws)
    np.testing.assert_array_equal(np.bincount(chosen, minlength=3), [500, 200, 300])


def test_one_lane_of_the_published_loop_is_an_ordinary_agent(tensors, mild, level):
    # Alone, the union of headings is the heading, and the first to finish is the only one.
    runs = publish(mild, jnp.asarray(level), jax.random.key(3), 40, HORIZON, 1)
    tables = prepare(mild, jnp.asarray(level))
    keys = jax.random.split(jax.random.key(9), 400)
    plain = run_many(mild, tables, keys, HORIZON, maze.all_timesteps)
    spread = float(plain.length.std()) / 40**0.5
    assert abs(float(runs.length.mean() - plain.length.mean())) < 4 * spread
    # The first episode is the oracle's, step by step.
    _, key = jax.random.split(jax.random.key(3))
    draws = []
    for _ in range(HORIZON):
        key, draw_key = jax.random.split(key)
        draws.append(float(jax.random.uniform(draw_key, (1,))[0]))
    mild_tensors = {
        name: array * (0.2 if name.startswith("actor.1") else 1) for name, array in tensors.items()
    }
    success, length, _ = oracle.episode(mild_tensors, level, FIRST_HEADINGS[0], np.array(draws))
    assert (bool(runs.success[0]), int(runs.length[0])) == (success, length)


def test_the_published_loop_favours_short_episodes(mild, level):
    many = jax.jit(jax.vmap(lambda key: reference_episodes(mild, level, key, 10, 1000, 10)))
    runs = many(jax.random.split(jax.random.key(0), 8))
    assert runs.length.shape == (8, 10)
    # Waiting times without memory: the first ten to end in ten lanes last 0.43 of the mean.
    tables = prepare(mild, jnp.asarray(level))
    keys = jax.random.split(jax.random.key(9), 400)
    plain = run_many(mild, tables, keys, 1000, maze.all_timesteps)
    assert runs.length.mean() < 0.7 * plain.length.mean()
    walled = publish(mild, jnp.ones((3, 4), jnp.int8), jax.random.key(0), 40, HORIZON, 1)
    assert not walled.success.any() and not walled.length.any()


def test_weights_survive_a_file_and_damage_is_refused(tmp_path, weights):
    path = tmp_path / "agent.npz"
    save_weights(weights, path)
    jax.tree.map(np.testing.assert_array_equal, policy.load_weights(path), weights)
    with pytest.raises(InputError, match="there is no agent"):
        policy.load_weights(tmp_path / "none.npz")
    for content in (b"", b"no zip", path.read_bytes()[:1000]):
        (tmp_path / "bad.npz").write_bytes(content)
        with pytest.raises(InputError, match="cannot be read"):
            policy.load_weights(tmp_path / "bad.npz")
    named = weights._asdict()
    for change, reason in (
        ({"actor": named["actor"][:3]}, "actor is"),
        ({"value": named["value"] * jnp.nan}, "not finite"),
        ({"compass": named["compass"].astype(int)}, "compass is"),
        ({"logits": named["logits"][0]}, "matrices"),
    ):
        np.savez(tmp_path / "bad.npz", **{**named, **change})
        with pytest.raises(InputError, match=reason):
            policy.load_weights(tmp_path / "bad.npz")
    del named["critic"]
    np.savez(tmp_path / "bad.npz", **named)
    with pytest.raises(InputError, match="critic is missing"):
        policy.load_weights(tmp_path / "bad.npz")
    np.savez(tmp_path / "bad.npz", **{**weights._asdict(), "critic": np.array([{}], object)})
    with pytest.raises(InputError, match="cannot be read"):
        policy.load_weights(tmp_path / "bad.npz")


def test_published_size():
    count = sum(np.prod(shape) for shape in policy.shapes(256, 7).values())
    assert count + 4 * 256 == 433_953  # PyTorch keeps two biases per gate, we their sum
