"""CMA-MAE on the sphere benchmark against pyribs, a short run of experiments/sphere.py."""

import jax
import jax.numpy as jnp
import numpy as np

from qdenv.search.cma_mae import CmaMaeConfig, cma_mae
from qdenv.types import Measure, Score

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


def sphere(solutions):
    bound, shift = 5.12, 0.4 * 5.12
    dim = solutions.shape[1]
    loss = jnp.square(solutions - shift).sum(axis=1) / (dim * (bound + shift) ** 2)
    inside = jnp.abs(solutions) <= bound
    folded = jnp.where(inside, solutions, bound / jnp.where(inside, 1, solutions))
    measures = folded.reshape(-1, 2, dim // 2).sum(axis=2)
    objective = 100 * (1 - loss)
    return Score(objective, objective, measures, jnp.ones(len(solutions), bool))


def test_a_hundred_iterations_score_as_pyribs_does():
    reach = 5.12 * 50
    grid = [Measure(name, -reach, reach, 100) for name in ("x", "y")]
    config = CmaMaeConfig(15, 36, sigma0=0.5, restart="basic", strategy="iso")
    algorithm = cma_mae(config, 100, grid)

    @jax.jit
    def run(key):
        def step(state, _):
            solutions, state = algorithm.ask(state)
            return algorithm.tell(state, solutions, sphere(solutions), {}), None

        archive = algorithm.archive(jax.lax.scan(step, algorithm.init(key), None, 100)[0])
        return archive.qd_score() / 10_000, 100 * archive.coverage

    ours = np.array([run(jax.random.key(seed)) for seed in range(8)])
    error = np.sqrt(ours.var(axis=0, ddof=1) / 8 + PYRIBS.var(axis=0, ddof=1) / 8)
    assert (np.abs(ours.mean(axis=0) - PYRIBS.mean(axis=0)) < 2 * error).all(), ours.mean(axis=0)
