"""The surrogate as a record of functions: init, fit, predict.

Three networks in a row, each learnt while those before it stand still (the surrogate of Zhang et
al. 2023, after Bhatt et al. 2022, https://arxiv.org/abs/2206.04199): the repaired map from the
drawn one, the tile usage from that, objective and measures from both. What a domain does not have,
a repair or a usage map, is left out.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import optax

from qdenv.surrogate.losses import map_loss, score_loss, usage_loss
from qdenv.surrogate.networks import MapPredictor, ScorePredictor
from qdenv.surrogate.samples import Ring, Samples, spread_of
from qdenv.surrogate.settings import SurrogateConfig
from qdenv.surrogate.training import Learner, Loss, learn, make_learner
from qdenv.types import InputError, Score

STAGES = ("repair", "usage", "score")


class Aspect(NamedTuple):
    """What the surrogate sees of layouts."""

    shape: tuple[int, int]  # rows H and columns W
    kinds: int  # kinds of tile K
    measures: int  # how many measures are predicted
    repairs: bool = True  # layouts are repaired before they are simulated
    usage: bool = True  # samples say how much each cell is used


def stages_of(aspect: Aspect) -> list[str]:
    """List the networks that there are, in the order in which they learn."""
    present = {"repair": aspect.repairs, "usage": aspect.usage, "score": True}
    return [name for name in STAGES if present[name]]


class Chain(NamedTuple):
    """The networks in a row, fixed while they learn."""

    config: SurrogateConfig
    aspect: Aspect
    networks: dict[str, Any]  # Flax modules by the names of `STAGES`


class Fitted(NamedTuple):
    """What the surrogate has learnt; one pytree."""

    learners: dict[str, Learner]  # its networks, by the names of `STAGES` that there are
    centre: jax.Array  # float32 [heads], what is subtracted from objective and measures
    spread: jax.Array  # float32 [heads], what they are divided by after that
    fits: jax.Array  # int32, how often it was fitted to samples


class Prediction(NamedTuple):
    """What the surrogate says of layouts."""

    score: Score  # `Score` with leading axis B; a success where every number is finite
    repaired: jax.Array  # int8 [B, H, W]
    usage: jax.Array  # float32 [B, H, W], in units of an even share; zeros where no usage is learnt


class Surrogate(NamedTuple):
    """A surrogate of true evaluations."""

    init: Callable[[jax.Array], Fitted]  # key -> `Fitted` that knows nothing; consumes the key
    # (fitted, ring, key) -> (fitted, mean losses of each network's last epoch by the names of
    # `STAGES`); consumes the key
    fit: Callable[[Fitted, Ring, jax.Array], tuple[Fitted, dict[str, jax.Array]]]
    # (fitted, ring, key, one of `STAGES`, first epoch, the one after the last) -> (fitted, mean
    # loss): the same in pieces, for one who waits; all with the same key
    fit_part: Callable[..., tuple[Fitted, jax.Array]]
    # (fitted, drawn layouts int8 [B, H, W]) -> `Prediction`
    predict: Callable[[Fitted, jax.Array], Prediction]
    heads: int  # numbers predicted of a layout: objective, result objective, measures


def make_surrogate(config: SurrogateConfig, aspect: Aspect) -> Surrogate:
    """Make the surrogate of layouts of one shape.

    Raises:
        InputError: there is another number of weights than of numbers to predict.
    """
    heads = 2 + aspect.measures
    if config.weights and len(config.weights) != heads:
        raise InputError(
            f"{len(config.weights)} weights: give {heads}, for objective, result objective and "
            "each measure"
        )
    networks: dict[str, Any] = {
        "repair": MapPredictor(config.channels, config.blocks, aspect.kinds),
        "usage": MapPredictor(config.channels, config.blocks, 1),
        "score": ScorePredictor(config.channels, heads),
    }
    chain, stages = Chain(config, aspect, networks), stages_of(aspect)
    optimiser = optax.adam(config.rate)

    def init(key: jax.Array) -> Fitted:
        learners: dict[str, Learner] = {}
        blank = jnp.zeros((1, *aspect.shape), jnp.int8)
        for number, name in enumerate(stages):
            maps = _inputs(chain, learners, blank)[name]
            variables = networks[name].init(jax.random.fold_in(key, number), maps, False)
            learners[name] = make_learner(variables, optimiser)
        return Fitted(learners, jnp.zeros(heads), jnp.ones(heads), jnp.int32(0))

    def fit_part(
        fitted: Fitted, ring: Ring, key: jax.Array, name: str, first: Any, last: Any
    ) -> tuple[Fitted, jax.Array]:
        scale = _scale(ring) if config.standardise else (fitted.centre, fitted.spread)
        loss = _loss(chain, name, fitted.learners, scale)
        learner, key = fitted.learners[name], jax.random.fold_in(key, stages.index(name))
        learner, mean = learn(loss, learner, optimiser, ring, config.minibatch, last, key, first)
        return Fitted({**fitted.learners, name: learner}, *scale, fitted.fits), mean

    def fit(fitted: Fitted, ring: Ring, key: jax.Array) -> tuple[Fitted, dict[str, jax.Array]]:
        losses = {}
        for name in stages:
            fitted, losses[name] = fit_part(fitted, ring, key, name, 0, config.epochs)
        return fitted._replace(fits=fitted.fits + (ring.known > 0)), losses

    def predict(fitted: Fitted, drawn: jax.Array) -> Prediction:
        seen = _inputs(chain, fitted.learners, drawn)
        heads = networks["score"].apply(fitted.learners["score"].variables, seen["score"], False)
        numbers = heads * fitted.spread[None] + fitted.centre[None]
        success = jnp.isfinite(numbers).all(axis=-1)
        score = Score(numbers[:, 0], numbers[:, 1], numbers[:, 2:], success)
        repaired = seen["usage"].argmax(axis=-1).astype(jnp.int8)
        usage = seen["score"][..., aspect.kinds] if aspect.usage else jnp.zeros(drawn.shape)
        return Prediction(score, repaired, usage)

    return Surrogate(init, fit, fit_part, predict, heads)


def _inputs(chain: Chain, learners: dict[str, Learner], drawn: jax.Array) -> dict[str, jax.Array]:
    """Compute what each network is given, by those before it; stops where one is not made yet."""
    config, aspect = chain.config, chain.aspect

    def output(name: str, maps: jax.Array) -> jax.Array:
        return chain.networks[name].apply(learners[name].variables, maps, False)

    tiles = jax.nn.one_hot(drawn, aspect.kinds)
    seen = {"repair": tiles}
    if aspect.repairs:
        if "repair" not in learners:
            return seen
        tiles = output("repair", tiles)
    seen["usage"] = tiles
    chosen = jax.nn.one_hot(tiles.argmax(axis=-1), aspect.kinds)
    if not aspect.usage:
        return seen | {"score": chosen}
    if "usage" not in learners:
        return seen
    used = output("usage", tiles)
    if config.usage_loss == "kl":
        # A distribution over the cells, in units of an even one.
        flat = used.reshape(len(used), -1)
        used = (jax.nn.softmax(flat, axis=-1) * flat.shape[-1]).reshape(used.shape)
    return seen | {"score": jnp.concatenate([chosen, used], axis=-1)}


def _loss(
    chain: Chain, name: str, learners: dict[str, Learner], scale: tuple[jax.Array, jax.Array]
) -> Loss:
    """Make the loss of one network; those before it stand still."""

    def loss(variables: Any, batch: Samples) -> tuple[jax.Array, Any]:
        maps = _inputs(chain, learners, batch.drawn)[name]
        result, changed = chain.networks[name].apply(variables, maps, True, mutable=["batch_stats"])
        stats = changed.get("batch_stats", {})
        if name == "repair":
            return map_loss(result, batch.repaired), stats
        if name == "usage":
            return usage_loss(result[..., 0], batch.usage, chain.config.usage_loss), stats
        target = (batch.numbers - scale[0][None]) / scale[1][None]
        weights = jnp.asarray(chain.config.weights or (1.0,) * target.shape[-1])
        return score_loss(result, target, weights), stats

    return loss


def _scale(ring: Ring) -> tuple[jax.Array, jax.Array]:
    """Compute mean and standard deviation of the samples' numbers, each float32 [heads].

    The deviation of a number that never varies is 1.
    """
    numbers, known = ring.samples.numbers, jnp.arange(len(ring.samples.numbers)) < ring.known
    centre, variance = spread_of(numbers, known)
    return centre, jnp.where(variance > 0, jnp.sqrt(variance), 1.0)
