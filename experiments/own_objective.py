"""Search with an objective of your own, in plain numpy, between ask and tell.

    python -m experiments.own_objective --iterations 200

Bends a chain of twelve links so that its tip reaches many different places while its joints are
bent as evenly as possible. Saves the archive as a table for pandas and as a picture.
"""

from pathlib import Path

import jax
import numpy as np

from experiments.program import run_program
from qdenv.run.archive import ArchiveSchema, SavedArchive
from qdenv.search.base import Problem
from qdenv.search.registry import ALGORITHMS, make_algorithm
from qdenv.types import Measure, Score
from qdenv.view.archive import draw_archive
from qdenv.view.style import new_figure, save_figure

LINKS = 12
MEASURES = (Measure("tip x", -LINKS, LINKS, 60), Measure("tip y", -LINKS, LINKS, 60))


def evaluate(angles: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Score joint angles [B, links]: objective [B] in [.., 1], place of the tip [B, 2]."""
    directions = np.cumsum(angles, axis=1)
    tip = np.stack([np.cos(directions).sum(axis=1), np.sin(directions).sum(axis=1)], axis=1)
    return 1 - angles.var(axis=1), tip


def main(
    algorithm: str = "cma-mae", iterations: int = 200, seed: int = 0, out: Path = Path("chain")
) -> None:
    """Run the search.

    Args:
        algorithm: cma-mae, cma-me, map-elites, cma-es or random.
        iterations: of ask, evaluate, tell.
        seed: of the search.
        out: files ``OUT.csv`` and ``OUT.png`` are written.
    """
    config = ALGORITHMS.config(algorithm)
    search = make_algorithm(config, Problem(LINKS, MEASURES, {"tip": np.zeros(2, np.float32)}))
    ask, tell = jax.jit(search.ask), jax.jit(search.tell, donate_argnums=0)
    state = search.init(jax.random.key(seed))
    for _ in range(iterations):
        solutions, state = ask(state)
        objective, tip = evaluate(np.asarray(solutions))
        success = np.isfinite(objective)  # rows that fail enter no archive
        state = tell(state, solutions, Score(objective, objective, tip, success), {"tip": tip})
    archive = search.archive(state)
    print(f"{algorithm}: QD-score {archive.qd_score:.1f}, coverage {archive.coverage:.1%}")
    table = SavedArchive(archive.elites(), ArchiveSchema(MEASURES, "", {}), str(out))
    table.write_table(out.with_suffix(".csv"), solutions=True)
    figure = draw_archive(new_figure(6, 4.8), archive.objectives, MEASURES, "bent chain")
    save_figure(figure, out.with_suffix(".png"))
    print(f"{out.with_suffix('.csv')}, {out.with_suffix('.png')}")


if __name__ == "__main__":
    run_program(main, "python -m experiments.own_objective")
