"""One result whatever compiles it and wherever it runs: jit or plain, one device or another."""

import os
import subprocess
import sys
from functools import partial
from pathlib import Path

import chex
import jax.numpy as jnp
import numpy as np
import pytest

from qdenv import score
from qdenv.grid import parse
from qdenv.search.archive import GridArchive
from qdenv.simulation.mapf.distances import goal_distances
from qdenv.simulation.mapf.planner import UNREACHABLE
from qdenv.types import Measure

pytestmark = pytest.mark.slow

EVERY = partial(
    chex.variants, with_jit=True, without_jit=True, with_device=True, without_device=True
)
LAYOUT = parse(["@@.@", ".@.e", "@..@"], ".@e")


class EveryVariant(chex.TestCase):
    """Closed forms, asked in every variant."""

    @EVERY()
    def test_components(self):
        """Three shelves hang together, three stand alone."""
        found = self.variant(lambda layout: score.components(layout, "@", ".@e"))(
            jnp.asarray(LAYOUT)
        )
        assert int(found) == 4

    @EVERY()
    def test_entropy_of_two_patterns(self):
        """Rows of two tiles in turn show two patterns, equally often: ln 2 / (4 ln 2)."""
        stripes = np.tile(np.array([[0, 0], [1, 1]], np.int8), (2, 2))[:3]
        found = self.variant(lambda area: score.entropy(area, 2))(jnp.asarray(stripes))
        np.testing.assert_allclose(found, 0.25, rtol=1e-6)

    @EVERY()
    def test_distances(self):
        """The goal is the cell of row 1, column 3; the cell of row 1, column 0 is walled in."""
        cells, used = jnp.array([7, 0]), jnp.array([True, False])
        found = self.variant(goal_distances)(jnp.asarray(LAYOUT != 1), cells, used)
        far = UNREACHABLE
        expected = [far, far, 2, far, far, far, 1, 0, far, 3, 2, far]
        np.testing.assert_array_equal(found[0], expected)

    @EVERY()
    def test_insertion_keeps_the_better_of_each_cell(self):
        """Of three solutions in two cells, the better of the first cell and the other stay."""
        measures = (Measure("one", 0, 2, 2),)
        solutions = jnp.array([[1.0], [2.0], [3.0]])
        values = jnp.array([5.0, 7.0, 1.0])

        def insert(solutions, values):
            archive = GridArchive.empty(jnp.zeros(1), measures)
            places, ok = jnp.array([[0.5], [0.5], [1.5]]), jnp.ones(3, bool)
            return archive.insert(solutions, values, places, {}, ok)[0].genotypes

        found = self.variant(insert)(solutions, values)
        np.testing.assert_array_equal(found, [[2.0], [3.0]])


# Evaluates a population on each of two devices, in a process that has two.
TWO_DEVICES = """
import jax, numpy as np, sys
sys.path.insert(0, {here!r})
import toy
from qdenv.pipeline import evaluate, make_pipeline

pipeline = make_pipeline(toy.CONFIG.evaluation)
parameters = jax.random.normal(jax.random.key(3), (4, pipeline.solution_size))
run = jax.jit(lambda some, key: evaluate(pipeline, some, key))
found = []
for device in jax.devices():
    with jax.default_device(device):
        found.append(run(jax.device_put(parameters, device), jax.random.key(4)))
    assert found[-1].repaired.devices() == {{device}}
assert len(found) == 2 and np.asarray(found[0].score.objective).std() > 0
jax.tree.map(np.testing.assert_array_equal, *found)
"""


def test_an_evaluation_is_the_same_on_another_device():
    script = TWO_DEVICES.format(here=str(Path(__file__).parent))
    flags = "--xla_force_host_platform_device_count=2"
    done = subprocess.run(
        [sys.executable, "-c", script],
        env=os.environ | {"XLA_FLAGS": flags, "JAX_PLATFORMS": "cpu"},
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr
