"""Cross-validation of a surrogate on a run's archive: random splits and their scores."""

import dataclasses
import functools
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from shlex import quote
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from qdenv.domains.base import make_domain
from qdenv.progress import Progress, silent
from qdenv.run.directory import RunDirectory
from qdenv.surrogates.settings import SurrogateConfig
from qdenv.surrogates.surrogate import Ring, Samples, Surrogate
from qdenv.types import Encoding, InputError

_HELD_OUT = 0.2  # share of the elites
FEWEST = 50  # elites: scores of fewer than ten held-out elites are mostly noise
_CHUNK = 64  # layouts predicted at a time


@dataclass(frozen=True)
class Evaluated:
    """The elites of a run with the results of their true evaluations."""

    cells: np.ndarray  # int [N, M], of the archive
    drawn: np.ndarray  # int8 [N, H, W], before the repair
    repaired: np.ndarray  # int8 [N, H, W]
    numbers: np.ndarray  # float32 [N, 1 + M], objective and measures
    names: tuple[str, ...]  # of the numbers
    units: str  # of the objective; may be empty
    kinds: int  # kinds of tile
    repairs: bool  # the domain repairs its layouts


def read_elites(run: RunDirectory) -> Evaluated:
    """Read what a surrogate can learn from a run's archive.

    Raises InputError if nothing is saved yet, or there are fewer than 50 elites.
    """
    archive, domain = run.archive, make_domain(run.config.evaluation.domain)
    if len(archive) < FEWEST:
        cure = f"continue the run: `qdenv resume {quote(str(run))}` with --evaluations N"
        cure = "choose a run of your own" if run.shipped else cure
        few = f"a surrogate needs at least {FEWEST} elites, this archive has {len(archive)}"
        raise InputError(f"{run}: {few}: {cure}")
    columns = archive.columns
    objective, _, units = domain.objective_name.partition(" [")
    return Evaluated(
        cells=archive.cells,
        drawn=columns.get("unrepaired", columns["repaired"]),
        repaired=columns["repaired"],
        numbers=np.column_stack([columns["objective"], columns["measures"]]).astype(np.float32),
        names=(objective, *(axis.name for axis in archive.schema.measures)),
        units=units.rstrip("]"),
        kinds=len(archive.schema.tiles),
        repairs=domain.rules is not None,
    )


def split_elites(count: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the indices of the elites to learn from and of a fifth, held out (int, ascending)."""
    # At random, not by cells: neighbours in an archive are alike, and no whole region may be
    # unknown to the surrogate.
    order = np.random.default_rng(seed).permutation(count)
    held = round(_HELD_OUT * count)
    return np.sort(order[held:]), np.sort(order[:held])


def score_predictions(predicted: np.ndarray, truth: np.ndarray) -> dict[str, float]:
    """Score predictions of one number (float [n] each).

    Return r2: share of the variance of the held-out elites that is explained (1 is perfect, 0 no
    better than their mean, below 0 worse; NaN if they do not vary); rmse: root mean squared error,
    in the number's own units; rank: Spearman's rank correlation (NaN if either side does not vary).
    """
    from scipy import stats  # takes half a second: refusals are faster without it

    predicted, truth = predicted.astype(float), truth.astype(float)
    squared = np.square(predicted - truth).mean()
    varies = truth.max() > truth.min()
    r2 = 1 - squared / truth.var() if varies else float("nan")
    ranked = varies and predicted.max() > predicted.min()
    rank = stats.spearmanr(predicted, truth).statistic if ranked else float("nan")
    return {"r2": float(r2), "rmse": float(np.sqrt(squared)), "rank": float(rank)}


class Split(NamedTuple):
    """The predictions of the held-out elites of one split."""

    seed: int  # of the split and of the networks
    held: np.ndarray  # int [n], indices of the held-out elites
    predicted: np.ndarray  # float32 [n, numbers]
    skills: tuple[dict[str, float], ...]  # of each number, see `score_predictions`
    tiles: float  # share of the tiles of repaired layouts that were predicted; NaN without a repair


def try_surrogate(
    elites: Evaluated, config: SurrogateConfig, seeds: Sequence[int], progress: Progress = silent
) -> list[Split]:
    """Learn from four fifths of the elites and predict the others, once per seed.

    The networks are those of `Surrogate` without the tile usage, which archives do not hold:
    they predict the repaired layout from the drawn one, then objective and measures from that. A
    seed is that of the split and of the networks' initial weights.
    """
    encoding = Encoding(elites.drawn.shape[1:3], elites.kinds, elites.repairs)
    stages, init, fit_part, predict = _compile(config, encoding, elites.numbers.shape[1] - 1)
    parts = [(name, epoch) for name in stages for epoch in range(config.epochs)]
    splits = []
    for number, seed in enumerate(seeds):
        known, held = split_elites(len(elites.numbers), seed)
        first, second = jax.random.split(jax.random.key(seed))
        numbers = elites.numbers[known]
        samples = Samples(
            drawn=jnp.asarray(elites.drawn[known]),
            repaired=jnp.asarray(elites.repaired[known]),
            usage=jnp.zeros(elites.drawn[known].shape, jnp.float16),
            # Archives hold only the result objective, which stands in for the search's own.
            numbers=jnp.asarray(np.column_stack([numbers[:, 0], numbers])),
        )
        fitted, ring = init(first), Ring(samples, jnp.int32(len(known)))
        for done, (name, epoch) in enumerate(parts):
            share = (number + done / len(parts)) / len(seeds)
            progress("learning", share, f"split {number + 1} of {len(seeds)}")
            fitted, loss = fit_part(fitted, ring, second, name, epoch, epoch + 1)
            # jax runs asynchronously: without this all parts would be reported at once.
            loss.block_until_ready()
        # Whole chunks, so that one compiled program predicts all of them.
        rows = np.resize(held, -(-len(held) // _CHUNK) * _CHUNK).reshape(-1, _CHUNK)
        reports = [predict(fitted, jnp.asarray(elites.drawn[chunk])) for chunk in rows]
        columns = [(score.result_objective, score.measures) for score, _, _ in reports]
        predicted = np.concatenate([np.column_stack(one) for one in columns])[: len(held)]
        repaired = np.concatenate([tiles for _, tiles, _ in reports])[: len(held)]
        truth = elites.numbers[held]
        skills = tuple(map(score_predictions, predicted.T, truth.T))
        alike = float((repaired == elites.repaired[held]).mean())
        splits.append(Split(seed, held, predicted, skills, alike if elites.repairs else np.nan))
    return splits


@functools.lru_cache(maxsize=4)
def _compile(
    config: SurrogateConfig, encoding: Encoding, measures: int
) -> tuple[list[str], Callable, Callable, Callable]:
    """Return the surrogate's stages, init, fit_part and predict, compiled at their first calls."""
    surrogate = Surrogate(config, encoding, measures)
    part = jax.jit(surrogate.fit_part, static_argnames="name")
    return surrogate.stages, jax.jit(surrogate.init), part, jax.jit(surrogate.predict)


def average_splits(values: Sequence[float]) -> dict[str, Any]:
    """Average a score over the splits in which it is finite.

    Return mean, spread (the standard deviation; NaN with fewer than two), splits (the values).
    """
    known = np.array([value for value in values if np.isfinite(value)])
    spread = float(known.std(ddof=1)) if len(known) > 1 else float("nan")
    mean = float(known.mean()) if len(known) else float("nan")
    return {"mean": mean, "spread": spread, "splits": values}


def scores_to_dict(
    elites: Evaluated, config: SurrogateConfig, splits: Sequence[Split]
) -> dict[str, Any]:
    """Return each score of each number, averaged over the splits, in JSON-ready values."""
    held = len(splits[0].held)
    skills = {
        name: {
            score: average_splits([split.skills[number][score] for split in splits])
            for score in splits[0].skills[number]
        }
        for number, name in enumerate(elites.names)
    }
    facts = {
        "elites": len(elites.numbers),
        "learnt_from": len(elites.numbers) - held,
        "held_out": held,
        "seeds": [split.seed for split in splits],
        "surrogate": dataclasses.asdict(config),
        "skills": skills,
    }
    if elites.repairs:
        facts["repaired_tiles_predicted"] = average_splits([split.tiles for split in splits])
        facts["repaired_tiles_as_drawn"] = float((elites.drawn == elites.repaired).mean())
    return facts
