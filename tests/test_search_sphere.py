"""CMA-MAE on the sphere benchmark against pyribs, a short run of experiments/sphere.py."""

import runpy
from pathlib import Path

import jax
import numpy as np
import pytest

from qdenv.search.cma_mae import CmaMaeConfig

pytestmark = pytest.mark.slow

SPHERE = runpy.run_path(str(Path(__file__).parents[1] / "experiments" / "sphere.py"))

# pyribs 0.12, cma_es, 15 x 36, sigma0 0.5, learning rate 0.01, imp, mu, basic; 100 iterations,
# eight seeds: normalised QD-score and coverage in per cent.
PYRIBS = np.array(
    [
        (21.91, 25.05),
        (20.73, 23.10),
        (23.16, 25.96),
        (22.58, 25.65),
        (20.96, 23.42),
        (21.80, 24.36),
        (19.89, 22.26),
        (21.03, 23.33),
    ]
)


@pytest.mark.usefixtures("optimized")
def test_a_hundred_iterations_score_as_pyribs_does():
    config = CmaMaeConfig(15, 36, sigma0=0.5, restart="basic", strategy="iso")
    search = SPHERE["search_sphere"](config, 100, 100)
    archives = [search(jax.random.key(seed)) for seed in range(8)]
    ours = np.array([(a.qd_score / a.objectives.size, 100 * a.coverage) for a in archives])
    error = np.sqrt(ours.var(axis=0, ddof=1) / 8 + PYRIBS.var(axis=0, ddof=1) / 8)
    assert (np.abs(ours.mean(axis=0) - PYRIBS.mean(axis=0)) < 2 * error).all(), ours.mean(axis=0)


def test_the_sphere_is_100_at_its_optimum_and_0_in_the_far_corner():
    bound, shift = 5.12, 0.4 * 5.12
    score = SPHERE["sphere"](np.array([[shift] * 6, [-bound] * 6, [2 * bound] * 6], np.float32))
    np.testing.assert_allclose(score.objective[:2], [100, 0], atol=1e-4)
    # Inside the box the halves are summed; a parameter x outside of it counts bound / x.
    expected = [[3 * shift] * 2, [-3 * bound] * 2, [1.5] * 2]
    np.testing.assert_allclose(score.measures, expected, rtol=1e-6)
