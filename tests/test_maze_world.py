"""The maze's world against recorded traces, 41 measured levels and a plain-numpy oracle."""

import jax
import jax.numpy as jnp
import maze_oracle as oracle
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from qdenv.grid import pad, parse
from qdenv.score import entropy
from qdenv.simulation.maze import world

measure = jax.jit(world.longest_path)


def test_metrics_of_41_levels_are_exact():
    levels = np.load(oracle.DATA / "maze_metrics_fixture.npz")
    courses = jax.jit(jax.vmap(world.longest_path))(levels["grid"].astype(np.int8))
    np.testing.assert_array_equal(courses.length > 0, levels["solvable"] == 1)
    np.testing.assert_array_equal(courses.length, np.maximum(levels["optimal_path_length"], 0))
    good = levels["solvable"] == 1
    for ours, theirs in ((courses.start, levels["start"]), (courses.goal, levels["goal"])):
        np.testing.assert_array_equal(np.asarray(ours)[good], (theirs @ [16, 1])[good])
    measured = [entropy(jnp.asarray(grid, jnp.int8), 2) for grid in levels["grid"]]
    np.testing.assert_allclose(measured, levels["layout_entropy"], atol=1e-6)
    np.testing.assert_array_equal(levels["grid"].sum((1, 2)), levels["num_blocks"])


def replay(layout, goal, start, heading, actions):
    """Drive a recorded list of actions -> poses, views, success at every step."""
    kinds = world.canvas(layout, goal)
    place = pad(start, layout.shape[1], world.REACH)

    def body(pose, action):
        seen = world.view(kinds, pose.position, pose.heading)
        later, success = world.step(kinds, pose, action)
        return later, (pose, seen, success)

    return jax.lax.scan(body, world.Pose(place, heading), actions)[1]


@pytest.mark.slow
def test_environment_agrees_with_3770_recorded_steps():
    traces = np.load(oracle.DATA / "maze_env_traces.npz")
    compared = 0
    replayed = jax.jit(replay)
    for number in range(21):
        trace = {
            name[8:]: traces[name] for name in traces if name.startswith(f"trace{number:02d}_")
        }
        size, steps = len(trace["grid"]), len(trace["actions"])
        course = measure(trace["grid"].astype(np.int8))
        assert int(course.length) == trace["optimal"]
        assert divmod(int(course.start), size) == tuple(trace["start"])
        padded = np.full(648, 3, np.int32)  # doing nothing at the end compiles once per size
        padded[:steps] = trace["actions"]
        pose, seen, success = replayed(
            jnp.asarray(trace["grid"], jnp.int8),
            course.goal,
            course.start,
            jnp.int32(trace["init_dir"]),
            padded,
        )
        place = trace["pos"][:steps].astype(np.int32) @ [size, 1]
        expected = pad(jnp.asarray(place), size, world.REACH)
        np.testing.assert_array_equal(pose.position[:steps], expected)
        np.testing.assert_array_equal(pose.heading[:steps], trace["dir"][:steps])
        image = np.rint(np.asarray(world.image(seen[:steps])) * 10)
        np.testing.assert_array_equal(image, trace["obs"][:steps])
        np.testing.assert_array_equal(success[:steps], trace["reward"] > 0)
        compared += steps
    assert compared == 3770


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 2**31), st.sampled_from([(5, 5), (3, 9), (8, 4)]), st.floats(0, 1))
def test_longest_path_agrees_with_breadth_first_search(seed, shape, density):
    layout = (np.random.default_rng(seed).random(shape) < density).astype(np.int8)
    course = measure(layout)
    length, start, goal = oracle.longest(layout)
    assert int(course.length) == length
    if length:
        assert (int(course.start), int(course.goal)) == (start, goal)


@pytest.mark.parametrize(
    ("drawing", "length", "start", "goal"),
    [
        (["XXX", "XXX"], 0, None, None),
        ([" X ", "X X"], 0, None, None),
        (["   ", "   "], 3, 0, 5),
        (["     "], 4, 0, 4),
        (["  X   ", "XXXXXX", "    XX"], 3, 12, 15),
        ([" X ", " X ", "   "], 6, 0, 2),
    ],
    ids=["all walls", "isolated", "empty, non-square", "one corridor", "disconnected", "bend"],
)
def test_degenerate_levels(drawing, length, start, goal):
    course = measure(parse(drawing, world.TILES))
    assert int(course.length) == length
    if length:
        assert (int(course.start), int(course.goal)) == (start, goal)


def test_a_ring_of_walls_changes_nothing():
    layout = (np.random.default_rng(4).random((7, 9)) < 0.3).astype(np.int8)
    bare, ringed = measure(layout), measure(np.pad(layout, 1, constant_values=world.WALL))
    inside = int(bare.start) // 9 + 1, int(bare.start) % 9 + 1
    assert divmod(int(ringed.start), 11) == inside
    assert int(ringed.length) == int(bare.length)


def test_view_drawn():
    # The agent stands at row 3, column 2 and looks up; beyond the map there is wall.
    layout = parse(["     ", " X   ", "   X ", "     "], world.TILES)
    kinds = world.canvas(jnp.asarray(layout), 4)
    seen = world.view(kinds, pad(3 * 5 + 2, 5, world.REACH), 3)
    picture = ["".join(" XG"[kind] for kind in row) for row in np.asarray(seen).T]
    assert picture == ["XXXXX", "    G", " X   ", "   X ", "     "]
