"""How well a surrogate predicts true evaluations, by how many it has learnt from.

    qdenv train laptop --algorithm cma-mae-screened --screen 1 --refit 100000 --evaluations 2000 \
        --out runs/recorded        # CMA-MAE as it is, every evaluation remembered
    python -m experiments.surrogate runs/recorded

`qdenv surrogate` learns from the elites of any run. This learns from everything that a run with a
surrogate (`dsage`, `cma-mae-screened`) remembers, elites or not, tile usage included. A fifth is
held out, drawn at random; the others are learnt from, all of them and fewer.
"""

import time
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Any, Literal

import jax
import jax.numpy as jnp
import numpy as np
import tyro

import qdenv
from experiments.program import run_program
from qdenv.io.files import write_csv
from qdenv.ranges import PositiveInt
from qdenv.run.checkpoint import load_newest
from qdenv.search.base import growing
from qdenv.study.options import find_surrogate
from qdenv.study.surrogate import score_predictions, split_elites
from qdenv.surrogates.settings import SurrogateConfig
from qdenv.surrogates.surrogate import Ring, Samples, Surrogate
from qdenv.types import Encoding

CHUNK = 50  # layouts predicted at a time
HEAD = ("size", "learnt_from", "held_out", "seed", "number", "r2", "rmse", "rank", "cpu_seconds")


def remembered(run: qdenv.RunDirectory) -> tuple[Samples, Encoding, list[str]]:
    """Read all that a run's surrogate may learn from, and what its numbers are called.

    Raises InputError if the run's algorithm remembers nothing.
    """
    experiment = qdenv.make_experiment(run.config)
    domain = experiment.pipeline.domain
    initial = growing(experiment.algorithm).init(experiment.search_key)
    _, state = load_newest(run.path, initial, {})
    if not hasattr(state, "model"):
        raise qdenv.InputError(f"{run.path}: its algorithm has no surrogate: use `qdenv surrogate`")
    ring = state.model.ring
    samples = jax.tree.map(lambda leaf: np.asarray(leaf)[: int(ring.known)], ring.samples)
    measures = [axis.name for axis in experiment.measures]
    usage = bool(samples.usage.any())
    encoding = Encoding(domain.shape, len(domain.tiles), domain.rules is not None, usage)
    objective = domain.objective_name.partition(" [")[0]
    return samples, encoding, ["learning objective", objective, *measures]


def try_once(
    config: SurrogateConfig, encoding: Encoding, samples: Samples, counts: list[int], seed: int
) -> Iterator[tuple[int, int, np.ndarray, np.ndarray, float]]:
    """Learn from some of the samples and predict those held out; yields one result per count."""
    known, held = split_elites(len(samples.numbers), seed)
    known = np.random.default_rng(seed).permutation(known)
    surrogate = Surrogate(config, encoding, samples.numbers.shape[1] - 2)
    fit, predict = jax.jit(surrogate.fit), jax.jit(surrogate.predict)
    rows = np.resize(held, -(-len(held) // CHUNK) * CHUNK).reshape(-1, CHUNK)
    for count in counts:
        begun = time.process_time()
        first, second = jax.random.split(jax.random.key(seed))
        # Every ring has the same size, so that one program learns from all of them.
        chosen = np.resize(known[:count], len(known))
        learnt = jax.tree.map(lambda leaf, at=chosen: jnp.asarray(leaf[at]), samples)
        fitted, _ = fit(surrogate.init(first), Ring(learnt, jnp.int32(count)), second)
        scores: Any = [predict(fitted, jnp.asarray(samples.drawn[one]))[0] for one in rows]
        columns = [(one.objective, one.result_objective, one.measures) for one in scores]
        predicted = np.concatenate([np.column_stack(one) for one in columns])[: len(held)]
        spent = time.process_time() - begun
        true = np.asarray(samples.numbers[held])
        yield min(count, len(known)), len(held), predicted, true, spent


def main(
    run: Annotated[Path, tyro.conf.Positional],
    sizes: tuple[Literal["small", "published"], ...] = ("small",),
    counts: tuple[int, ...] = (400, 800, 1600),
    seeds: PositiveInt = 3,
    out: Path = Path("runs/surrogate.csv"),
) -> None:
    """Print and write R^2, RMSE and rank correlation on held-out evaluations.

    Args:
        run: folder of a run whose algorithm has a surrogate.
        sizes: of the surrogate.
        counts: evaluations to learn from; more than there are means all.
        seeds: of the split and the networks.
        out: table to write.
    """
    samples, encoding, names = remembered(qdenv.RunDirectory.open(run))
    rows: list[tuple] = []
    for size in sizes:
        for seed in range(seeds):
            for known, held, predicted, truth, spent in try_once(
                find_surrogate(size, {}), encoding, samples, list(counts), seed
            ):
                for place, name in enumerate(names):
                    skill = score_predictions(predicted[:, place], truth[:, place])
                    figures = [f"{value:.4g}" for value in (*skill.values(), spent)]
                    rows.append((size, known, held, seed, name, *figures))
                print(*(" ".join(map(str, row)) for row in rows[-len(names) :]), sep="\n")
                write_csv(out, HEAD, rows)
    print(out)


if __name__ == "__main__":
    run_program(main, "python -m experiments.surrogate")
