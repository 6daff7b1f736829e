"""What is predicted of elites that were held out: how a run's archive is split, and the figures."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple, TypeAlias

import jax
import jax.numpy as jnp
import numpy as np

from qdenv.domains.base import make_domain
from qdenv.progress import Progress, silent
from qdenv.run.directory import RunDirectory
from qdenv.surrogate.samples import Ring, Samples
from qdenv.surrogate.settings import SurrogateConfig
from qdenv.surrogate.surrogate import Aspect, make_surrogate, stages_of
from qdenv.types import InputError

HELD_OUT = 0.2  # share of the elites
FEWEST = 50  # elites; ten held out tell little, fewer tell nothing


@dataclass(frozen=True)
class Evaluated:
    """The elites of a run with what a true evaluation said of them."""

    cells: np.ndarray  # int [N, M], where each stands in the archive
    drawn: np.ndarray  # int8 [N, H, W], before the repair
    repaired: np.ndarray  # int8 [N, H, W]
    numbers: np.ndarray  # float32 [N, 1 + M], objective and measures
    names: tuple[str, ...]  # of the numbers
    units: str  # of the objective; empty where it has none
    kinds: int  # kinds of tile
    repairs: bool  # the domain repairs its layouts

    def __len__(self) -> int:
        """Count the elites."""
        return len(self.numbers)


class Skill(NamedTuple):
    """How well one number of held-out elites is predicted."""

    # share of the variance of the held-out elites that is explained: 1 is perfect, 0 no better than
    # their mean, below 0 worse; NaN where they do not vary
    r2: float
    rmse: float  # root mean squared error, in the number's own units
    rank: float  # Spearman's rank correlation; NaN where either side does not vary


def read_elites(run: RunDirectory) -> Evaluated:
    """Read what a surrogate can learn from a run's archive.

    Raises:
        InputError: nothing is saved yet, or there are fewer than 50 elites.
    """
    archive, domain = run.archive, make_domain(run.config.evaluation.domain)
    if len(archive) < FEWEST:
        cure = (
            "choose a run of your own"
            if run.shipped
            else f"continue the run with `qdenv resume {run} --evaluations N`"
        )
        raise InputError(
            f"{run}: a surrogate needs at least {FEWEST} elites, this archive has {len(archive)}: "
            + cure
        )
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


def split(count: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Split `count` elites at random; the same seed splits alike.

    Returns:
        the elites to learn from and those held out, a fifth (int [.] each, in order).
    """
    order = np.random.default_rng(seed).permutation(count)
    held = round(HELD_OUT * count)
    return np.sort(order[held:]), np.sort(order[:held])


def judge(predicted: np.ndarray, truth: np.ndarray) -> Skill:
    """Compare predictions with the truth, float [n] each, against the truth's own variance."""
    from scipy import stats  # here: takes half a second, and who is refused need not wait

    predicted, truth = predicted.astype(float), truth.astype(float)
    squared = np.square(predicted - truth).mean()
    varies = truth.max() > truth.min()
    r2 = 1 - squared / truth.var() if varies else float("nan")
    ranked = varies and predicted.max() > predicted.min()
    rank = stats.spearmanr(predicted, truth).statistic if ranked else float("nan")
    return Skill(float(r2), float(np.sqrt(squared)), float(rank))


CHUNK = 64  # layouts predicted at a time
LEARNING = "learning"

# (elites to learn from, those held out, seed, told which share is done) -> (numbers, repaired
# layouts) predicted of those held out
Predictor: TypeAlias = Callable[
    [np.ndarray, np.ndarray, int, Callable[[float], None]], tuple[np.ndarray, np.ndarray]
]


class Trial(NamedTuple):
    """One split: what was predicted of the elites that were held out."""

    seed: int  # of the split and of the networks
    held: np.ndarray  # int [n], which elites were held out
    predicted: np.ndarray  # float32 [n, numbers]
    skills: tuple[Skill, ...]  # of each number
    tiles: float  # share of the tiles of repaired layouts that were predicted; NaN without a repair


class Mean(NamedTuple):
    """A number over all splits."""

    mean: float  # over the splits in which it is known; NaN where there is none
    spread: float  # its standard deviation from split to split; NaN with fewer than two


def try_surrogate(
    elites: Evaluated,
    config: SurrogateConfig,
    seeds: Sequence[int],
    progress: Progress = silent,
) -> list[Trial]:
    """Learn from four fifths of the elites and predict the others, once per seed.

    The networks are those of `make_surrogate` but for the tile usage, which no archive keeps:
    the repaired layout from the drawn one, then objective and measures from that.

    Args:
        elites: of a run.
        config: the surrogate's size, and how it learns.
        seeds: each decides its split and its networks' first weights.
        progress: told which share is done.
    """
    predict = make_predictor(elites, config)
    trials = []
    for number, seed in enumerate(seeds):
        note = f"split {number + 1} of {len(seeds)}"

        def tell(share: float, done: int = number, note: str = note) -> None:
            progress(LEARNING, (done + share) / len(seeds), note)

        known, held = split(len(elites), seed)
        predicted, repaired = predict(known, held, seed, tell)
        truth = elites.numbers[held]
        skills = tuple(judge(*pair) for pair in zip(predicted.T, truth.T, strict=True))
        alike = float((repaired == elites.repaired[held]).mean())
        trials.append(Trial(seed, held, predicted, skills, alike if elites.repairs else np.nan))
    return trials


def make_predictor(elites: Evaluated, config: SurrogateConfig) -> Predictor:
    """Make a function that learns from some elites and predicts others.

    It compiles once for all archives of one size.
    """
    shape = elites.drawn.shape[1], elites.drawn.shape[2]
    measures = elites.numbers.shape[1] - 1
    aspect = Aspect(shape, elites.kinds, measures, elites.repairs, usage=False)
    init, fit_part, predict = _programs(config, aspect)
    parts = [(name, epoch) for name in stages_of(aspect) for epoch in range(config.epochs)]

    def learn_and_predict(
        known: np.ndarray, held: np.ndarray, seed: int, tell: Callable[[float], None]
    ) -> tuple[np.ndarray, np.ndarray]:
        first, second = jax.random.split(jax.random.key(seed))
        fitted, ring = init(first), _ring(elites, known)
        for done, (name, epoch) in enumerate(parts):
            tell(done / len(parts))
            fitted, loss = fit_part(fitted, ring, second, name, epoch, epoch + 1)
            loss.block_until_ready()  # else nothing would tell how far it is
        # Whole chunks, so that one program predicts all of them.
        rows = np.resize(held, -(-len(held) // CHUNK) * CHUNK).reshape(-1, CHUNK)
        said: list[Any] = [predict(fitted, jnp.asarray(elites.drawn[chunk])) for chunk in rows]
        objective = np.concatenate([one.score.result_objective for one in said])
        measures = np.concatenate([one.score.measures for one in said])
        repaired = np.concatenate([one.repaired for one in said])
        return np.column_stack([objective, measures])[: len(held)], repaired[: len(held)]

    return learn_and_predict


@functools.lru_cache(maxsize=4)
def _programs(config: SurrogateConfig, aspect: Aspect) -> tuple[Callable, Callable, Callable]:
    """Make the surrogate's init, fit_part and predict, compiled when they are first called."""
    surrogate = make_surrogate(config, aspect)
    part = jax.jit(surrogate.fit_part, static_argnames="name")
    return jax.jit(surrogate.init), part, jax.jit(surrogate.predict)


def _ring(elites: Evaluated, known: np.ndarray) -> Ring:
    """Put elites where a surrogate learns from."""
    numbers = elites.numbers[known]
    samples = Samples(
        drawn=jnp.asarray(elites.drawn[known]),
        repaired=jnp.asarray(elites.repaired[known]),
        usage=jnp.zeros(elites.drawn[known].shape, jnp.float16),
        # An archive keeps the result objective alone: it stands for the search's own, too.
        numbers=jnp.asarray(np.column_stack([numbers[:, 0], numbers])),
    )
    return Ring(samples, jnp.int32(len(known)))


def mean_of(values: Sequence[float]) -> Mean:
    """Average a number over splits, those without it left out."""
    known = np.array([value for value in values if np.isfinite(value)])
    spread = float(known.std(ddof=1)) if len(known) > 1 else float("nan")
    return Mean(float(known.mean()) if len(known) else float("nan"), spread)


def facts_of(elites: Evaluated, config: SurrogateConfig, trials: Sequence[Trial]) -> dict[str, Any]:
    """List what was found out: each figure of each number, its mean and its spread over splits."""
    held = len(trials[0].held)
    skills = {}
    for number, name in enumerate(elites.names):
        mine = [trial.skills[number] for trial in trials]
        figures = {one: [getattr(skill, one) for skill in mine] for one in Skill._fields}
        skills[name] = {
            one: mean_of(values)._asdict() | {"splits": values} for one, values in figures.items()
        }
    facts = {
        "elites": len(elites),
        "learnt_from": len(elites) - held,
        "held_out": held,
        "seeds": [trial.seed for trial in trials],
        "surrogate": dataclasses.asdict(config),
        "skills": skills,
    }
    if elites.repairs:
        tiles = [trial.tiles for trial in trials]
        facts["repaired_tiles_predicted"] = mean_of(tiles)._asdict() | {"splits": tiles}
        facts["repaired_tiles_as_drawn"] = float((elites.drawn == elites.repaired).mean())
    return facts
