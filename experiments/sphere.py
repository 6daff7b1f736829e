"""Train CMA-MAE on the sphere benchmark of quality diversity; no grid world in sight.

    python -m experiments.sphere                                  # seconds
    python -m experiments.sphere --iterations 10000 --seeds 3 --strategy full iso sep --out FILE

Prints the normalised QD-score (per cell) and the coverage in per cent of every seed, their mean
and the standard error; `--picture FILE` draws the archive of the last one. What was measured is
in results/sphere-500.csv and -10000.csv, and stands in experiments/README.md.
"""

import time
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from experiments.program import run_program
from qdenv.io.files import write_csv
from qdenv.ranges import PositiveInt
from qdenv.search.base import Problem
from qdenv.search.cma_mae import CmaMaeConfig, cma_mae
from qdenv.search.settings import StrategyName
from qdenv.stats import standard_error
from qdenv.types import Array, Measure, Score
from qdenv.view.archive import draw_archive
from qdenv.view.style import new_figure, save_figure

BOUND = 5.12  # where the measures begin to fold back
SHIFT = 0.4 * BOUND  # of the optimum


def sphere(solutions: Array) -> Score:
    """Score solutions [B, P] on the sphere with linear projections as measures.

    The objective is 100 at the optimum and 0 at the far corner of the box; parameters outside the
    box count less in the measures the further out they are (Fontaine et al. 2020).
    """
    dim = solutions.shape[1]
    objective = 100 * (1 - jnp.square(solutions - SHIFT).sum(axis=1) / (dim * (BOUND + SHIFT) ** 2))
    inside = jnp.abs(solutions) <= BOUND
    folded = jnp.where(inside, solutions, BOUND / jnp.where(inside, 1, solutions))
    halves = folded[:, : dim // 2].sum(axis=1), folded[:, dim // 2 :].sum(axis=1)
    everyone = jnp.ones(len(solutions), bool)
    return Score(objective, objective, jnp.stack(halves, axis=1), everyone)


def search_sphere(config: CmaMaeConfig, dim: int, iterations: int) -> Any:
    """Make the function key -> archive that runs a whole search as one compiled loop."""
    reach = BOUND * dim / 2
    measures = [Measure(name, -reach, reach, 100) for name in ("first half", "second half")]
    algorithm = cma_mae(config, Problem(dim, measures))

    def step(state: Any, _: None) -> tuple[Any, None]:
        solutions, state = algorithm.ask(state)
        return algorithm.tell(state, solutions, sphere(solutions), {}), None

    return jax.jit(
        lambda key: algorithm.archive(jax.lax.scan(step, algorithm.init(key), None, iterations)[0])
    )


def main(
    iterations: PositiveInt = 500,
    seeds: PositiveInt = 1,
    dim: PositiveInt = 100,
    strategy: tuple[StrategyName, ...] = ("full",),
    emitters: int = 15,
    batch: int = 36,
    picture: Path | None = None,
    out: Path | None = None,
) -> None:
    """Run the benchmark.

    Args:
        iterations: of each search.
        seeds: how many searches.
        dim: parameters of a solution.
        strategy: one or several of iso, sep, full, lm_ma, and names of evosax.
        emitters: of CMA-MAE.
        batch: solutions per emitter and iteration.
        picture: where to draw the last archive.
        out: table to write, a row for each search.
    """
    table = []
    for name in strategy:
        config = CmaMaeConfig(emitters, batch, sigma0=0.5, restart="basic", strategy=name)
        compiled = search_sphere(config, dim, iterations).lower(jax.random.key(0)).compile()
        rows = []
        for seed in range(seeds):
            start = time.process_time()
            archive = jax.block_until_ready(compiled(jax.random.key(seed)))
            spent = 1000 * (time.process_time() - start) / iterations
            qd_score = float(archive.qd_score) / len(archive.objectives)
            rows.append([float(f"{one:.6g}") for one in (qd_score, 100 * float(archive.coverage))])
            figures = "{:6.2f} {:6.2f} %".format(*rows[-1])
            print(f"seed {seed}: {figures}   {spent:.2f} CPU ms per iteration", flush=True)
        score, coverage = (
            f"{one:.2f}" + (f" ± {half:.2f}" if np.isfinite(half) else "")  # unknown of one seed
            for one, half in zip(np.mean(rows, axis=0), standard_error(rows), strict=True)
        )
        table += [(name, iterations, seed, *row) for seed, row in enumerate(rows)]
        about = f"{name}, {iterations} iterations, {seeds} seed{'s' * (seeds != 1)}"
        print(f"{about}: normalised QD-score {score}, coverage {coverage} %")
    if out:
        write_csv(out, ("strategy", "iterations", "seed", "qd_score", "coverage"), table)
    if picture:
        figure = draw_archive(new_figure(6, 4.8), archive.objectives, archive.measures, "sphere")
        save_figure(figure, picture)


if __name__ == "__main__":
    run_program(main, "python -m experiments.sphere")
