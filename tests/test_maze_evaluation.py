"""Evaluating the agent: Wilson intervals, random mazes, the shipped agent, the picture."""

import csv
import json

import jax
import jax.numpy as jnp
import maze_oracle as oracle
import numpy as np
import pytest
from conftest import read_layout
from PIL import Image

from experiments.benchmarks.simulation import pad_units
from qdenv.agent.evaluate import (
    compare_with_random,
    default_horizon,
    draw_mazes,
    evaluate_agent,
    run_batch,
    without_ring,
)
from qdenv.cli.main import run
from qdenv.simulation.maze.policy import load_weights
from qdenv.types import InputError
from qdenv.view.layouts import COLOURS, MARKS
from qdenv.view.layouts import draw_mazes as draw_panels
from qdenv.view.style import save_figure

pytestmark = pytest.mark.slow


def random_mazes(seed, count, rows, cols, walls, *which, **how) -> np.ndarray:
    drawn = draw_mazes(seed, count, (rows, cols), walls, *which, **how)
    return np.array([maze.layout for maze in drawn])


def success_rates(agent, layouts, runs) -> np.ndarray:
    rates = [evaluate_agent(agent, one, seed, runs).rate for seed, one in enumerate(layouts)]
    return np.array(rates)


def test_random_mazes_have_the_walls_and_the_path_asked_for():
    mazes = random_mazes(0, 6, 8, 5, 12, lambda length: 10 <= length <= 12)
    assert mazes.shape == (6, 8, 5)
    assert (mazes.sum((1, 2)) == 12).all()
    assert all(10 <= oracle.longest(maze)[0] <= 12 for maze in mazes)
    np.testing.assert_array_equal(
        mazes, random_mazes(0, 6, 8, 5, 12, lambda length: 10 <= length <= 12)
    )
    with pytest.raises(InputError, match="draw fewer, or none"):
        random_mazes(0, 1, 4, 4, 2, lambda length: length > 99, tries=5)
    with pytest.raises(InputError, match="do not fit"):
        random_mazes(0, 1, 4, 4, 17)


@pytest.fixture(scope="module")
def agent():
    return jax.tree.map(jnp.asarray, load_weights())


def test_the_shipped_agent_solves_random_mazes(agent):
    # 20 mazes x 10 episodes; the full figures are in the training report beside the weights.
    for walls in (60, 90):
        rates = success_rates(agent, random_mazes(walls, 20, 16, 16, walls), runs=10)
        assert rates.mean() >= 0.95


@pytest.mark.usefixtures("optimized")
def test_the_shipped_agent_solves_mazes_larger_than_those_it_learned_in(agent):
    # 8 mazes x 4 episodes, with walls and ways like those of the published 64 x 64 maze
    mazes = draw_mazes(5, 8, (64, 64), 1681, lambda way: 181 <= way <= 271)
    rates = success_rates(agent, np.array([maze.layout for maze in mazes]), runs=4)
    assert rates.mean() >= 0.85


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


def test_a_ring_of_walls_counts_once(agent):
    maze = random_mazes(7, 1, 16, 16, 60)[0]
    ringed = np.pad(maze, 1, constant_values=1)
    assert default_horizon(maze) == default_horizon(ringed) == 648
    assert default_horizon(np.zeros((64, 64), np.int8)) == 8712
    assert default_horizon(np.pad(np.zeros((64, 64), np.int8), 1, constant_values=1)) == 8712
    np.testing.assert_array_equal(without_ring(ringed), maze)
    # One gap in its border, and a maze has no ring.
    ringed[0, 3] = 0
    np.testing.assert_array_equal(without_ring(ringed), ringed)
    ringed[0, 3] = 1
    assert evaluate_agent(agent, maze, runs=20) == evaluate_agent(agent, ringed, runs=20)
    ones = [compare_with_random(agent, one, mazes=2, runs=5, seed=3) for one in (maze, ringed)]
    assert ones[0].results == ones[1].results
    assert ones[1].mazes[0].layout.shape == (16, 16)
    assert [one.walls for one in ones] == [60, 60]


def test_comparison_with_random_mazes_of_like_path_length(agent, monkeypatch):
    layout = random_mazes(7, 1, 6, 6, 9)[0]
    found = compare_with_random(agent, layout, mazes=4, runs=10, horizon=40)
    length = oracle.longest(layout)[0]
    assert (found.walls, found.given.shortest) == (9, length)
    for maze, result in zip(found.mazes, found.results, strict=True):
        assert maze.layout.sum() == 9
        assert (maze.shortest, maze.start, maze.goal) == oracle.longest(maze.layout)
        assert 0.8 * length <= maze.shortest == result.shortest <= 1.2 * length
        assert result.runs == 10 and result.mean_length <= 40
    np.testing.assert_allclose(found.mean, np.mean(found.rates))
    np.testing.assert_allclose(found.standard_error, np.std(found.rates, ddof=1) / 2)
    # A single action reaches no goal: the horizon holds for random mazes, too.
    assert compare_with_random(agent, layout, mazes=2, runs=10, horizon=1).mean == 0
    # Unless given it is that of the maze as it comes, however much of that is a ring.
    ringed = np.pad(layout, 1, constant_values=1)
    usual = "qdenv.agent.evaluate.default_horizon"
    monkeypatch.setattr(usual, lambda maze: 1 if maze is ringed else 40)
    assert compare_with_random(agent, ringed, mazes=2, runs=10).mean == 0
    with pytest.raises(InputError, match="two mazes"):
        compare_with_random(agent, layout, mazes=1)


def test_the_command_leaves_the_random_mazes_beside_their_table(folder, capsys):
    maze = random_mazes(7, 1, 8, 8, 20)[0]
    rows = ["".join(" X"[tile] for tile in row) for row in np.pad(maze, 1, constant_values=1)]
    (folder / "maze.txt").write_text("\n".join(rows))
    line = "evaluate-agent maze.txt --random-mazes 3 --runs 4 --horizon 150 --json facts.json"
    assert run(line.split()) == 0
    said = capsys.readouterr().out
    assert "in 4 runs of at most 150 timesteps" in said
    for written in ("maze_random: 3 layouts", "maze_random.csv", "maze_random.png", "facts.json"):
        assert f"{written}\n" in said
    facts = json.loads((folder / "facts.json").read_text())["random_mazes"]
    assert (facts["mazes"], facts["walls"], facts["runs"]) == (3, 20, 4)
    with open("maze_random.csv", newline="") as table:
        listed = list(csv.DictReader(table))
    assert [float(row["success"]) for row in listed] == facts["rates"]
    for row, shortest in zip(listed, facts["shortest"], strict=True):
        found = read_layout(row["file"], " X")
        assert found.shape == (8, 8) and found.sum() == 20
        assert oracle.longest(found)[0] == int(row["shortest"]) == shortest
        assert float(row["actions"]) <= 150
    with Image.open("maze_random.png") as picture:
        assert picture.size[0] > 2 * picture.size[1]  # four panels in a row
    # Never over what exists, unless --out names it.
    assert run(line.split()[:-2]) == 0
    assert "maze_random-2.csv" in capsys.readouterr().out
    assert run([*line.split()[:-2], "--out", "maze_random.csv"]) == 0
    assert "maze_random.csv (replaced)" in capsys.readouterr().out


def test_padded_units_change_no_decision(agent):
    # The benchmark's agent of 256 units is the shipped one in disguise.
    mazes = jnp.asarray(random_mazes(3, 2, 6, 6, 9))
    key = jax.random.key(0)
    ours, theirs = (
        run_batch(weights, mazes, key, 5, 60) for weights in (agent, pad_units(agent, 80))
    )
    jax.tree.map(np.testing.assert_array_equal, ours, theirs)


def test_picture_of_many_mazes(tmp_path):
    path, mazes = tmp_path / "mazes.png", draw_mazes(3, 8, (6, 6), 9)
    save_figure(draw_panels(mazes, [str(number) for number in range(8)]), path)
    with Image.open(path) as picture:
        shown = np.asarray(picture.convert("RGB"))
    # Six panels in the first row, two in the second; one start and one goal in each.
    levels = {
        name: tuple(bytes.fromhex(colour[1:]))
        for name, colour in {**MARKS, "wall": COLOURS["X"]}.items()
    }
    colours, counts = np.unique(shown.reshape(-1, 3), axis=0, return_counts=True)
    seen = {tuple(colour): count for colour, count in zip(colours.tolist(), counts, strict=True)}
    tile = seen[levels["start"]] / 8
    assert seen[levels["reached"]] / 8 == pytest.approx(tile, rel=0.1)
    assert seen[levels["wall"]] / 8 == pytest.approx(9 * tile, rel=0.1)
    assert (shown[-1, : shown.shape[1] // 2] == 255).all()
