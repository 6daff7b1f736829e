"""Evaluating the agent: Wilson intervals, random mazes, the shipped agent, the picture."""

import jax
import jax.numpy as jnp
import maze_oracle as oracle
import numpy as np
import pytest
from PIL import Image

from qdenv.agent.convert import pad_units
from qdenv.agent.evaluate import (
    compare_with_random,
    default_horizon,
    evaluate_agent,
    random_mazes,
    run_batch,
    success_rates,
)
from qdenv.plots.maze import save_episode
from qdenv.score.traffic import wilson_interval
from qdenv.simulate.maze.policy import load_weights
from qdenv.types import InputError


@pytest.mark.parametrize(
    ("successes", "runs", "low", "high"),
    [(93, 100, 0.8625, 0.9657), (0, 10, 0.0, 0.2775), (10, 10, 0.7225, 1.0), (1, 1, 0.2065, 1.0)],
)
def test_wilson_interval(successes, runs, low, high):
    np.testing.assert_allclose(wilson_interval(successes, runs), (low, high), atol=5e-5)


def test_random_mazes_have_the_walls_and_the_path_asked_for():
    mazes = random_mazes(0, 6, 8, 5, 12, lambda length: 10 <= length <= 12)
    assert mazes.shape == (6, 8, 5)
    assert (mazes.sum((1, 2)) == 12).all()
    assert all(10 <= oracle.longest(maze)[0] <= 12 for maze in mazes)
    np.testing.assert_array_equal(
        mazes, random_mazes(0, 6, 8, 5, 12, lambda length: 10 <= length <= 12)
    )
    with pytest.raises(InputError, match="widen the bounds"):
        random_mazes(0, 1, 4, 4, 2, lambda length: length > 99, tries=5)
    with pytest.raises(InputError, match="do not fit"):
        random_mazes(0, 1, 4, 4, 17)


@pytest.fixture(scope="module")
def agent():
    return jax.tree.map(jnp.asarray, load_weights())


def test_the_shipped_agent_solves_random_mazes(agent):
    # 20 mazes x 10 episodes; the full figures are in the training report beside the weights.
    for walls, least in ((60, 0.90), (90, 0.80)):
        rates = success_rates(agent, random_mazes(walls, 20, 16, 16, walls), runs=10)
        assert rates.shape == (20,)
        assert rates.mean() >= least


def test_evaluation_of_one_maze(agent):
    layout = np.zeros((5, 9), np.int8)
    assert default_horizon(layout) == 2 * 7 * 11
    found = evaluate_agent(agent, layout, runs=40)
    assert found.runs == 40 and found.shortest == 12
    # In an empty room the agent never fails: Wilson's bounds of 40 of 40 are 1 / (1 + z^2 / 40), 1.
    assert (found.rate, found.high) == (1, 1)
    assert found.low == pytest.approx(1 / (1 + 1.959964**2 / 40))
    assert 12 < found.mean_length < 154
    with pytest.raises(InputError, match="nothing to solve"):
        evaluate_agent(agent, np.ones((5, 9), np.int8), runs=40)
    with pytest.raises(InputError, match="at least one run"):
        evaluate_agent(agent, layout, runs=0)


def test_the_published_loop_is_an_option(agent):
    layout = np.zeros((5, 9), np.int8)
    quirky = evaluate_agent(agent, layout, runs=40, reference_batching=True)
    assert quirky.runs == 40 and quirky.shortest == 12
    assert (quirky.rate, quirky.high) == (1, 1)
    assert quirky.low == pytest.approx(0.912378, abs=1e-6)
    # Ten environments share their first headings: other episodes than the independent ones.
    assert quirky.mean_length != evaluate_agent(agent, layout, runs=40).mean_length


def test_comparison_with_random_mazes_of_like_path_length(agent):
    layout = random_mazes(7, 1, 6, 6, 9)[0]
    found = compare_with_random(agent, layout, mazes=4, runs=10)
    assert (found.walls, found.shortest) == (9, oracle.longest(layout)[0])
    np.testing.assert_allclose(found.mean, np.mean(found.rates))
    np.testing.assert_allclose(found.standard_error, np.std(found.rates, ddof=1) / 2)
    with pytest.raises(InputError, match="two mazes"):
        compare_with_random(agent, layout, mazes=1)


def test_padded_units_change_no_decision(agent):
    # The benchmark's agent of 256 units is the shipped one in disguise.
    mazes = jnp.asarray(random_mazes(3, 2, 6, 6, 9))
    key = jax.random.key(0)
    ours, theirs = (
        run_batch(weights, mazes, key, 5, 60) for weights in (agent, pad_units(agent, 80))
    )
    jax.tree.map(np.testing.assert_array_equal, ours, theirs)


def test_picture_of_an_episode(tmp_path):
    layout = np.array([[0, 0, 0], [1, 1, 0]], np.int8)
    path, cells, turns = tmp_path / "episode.gif", np.array([0, 0, 1, 2]), np.array([3, 0, 0, 1])
    save_episode(path, layout, 5, cells, turns, cell=20)
    with Image.open(path) as film:
        assert (film.n_frames, film.size) == (4, (60, 40))
        film.seek(3)
        last = np.asarray(film.convert("RGB"))
    assert tuple(last[30, 30]) == (128, 128, 128)  # a wall
    assert tuple(last[38, 50]) == (60, 170, 80)  # the goal
    assert tuple(last[10, 50]) == (245, 200, 40)  # the agent, in the corner
    assert tuple(last[16, 50]) == (245, 200, 40)  # pointing down
    save_episode(path, layout, 5, np.zeros(50, int), np.arange(50) % 4, frames=5)
    with Image.open(path) as film:
        assert film.n_frames <= 6
    with pytest.raises(InputError):
        save_episode(path, layout, 5, np.zeros(0, int), np.zeros(0, int))
