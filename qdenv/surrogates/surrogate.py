"""The surrogate: what it learns from; init, fit, predict; its losses and errors.

Three networks in a row, each learnt while those before it are fixed (the surrogate of Zhang et
al. 2023, after Bhatt et al. 2022, https://arxiv.org/abs/2206.04199): the repaired map from the
drawn one, the tile usage from that, objective and measures from both. What a domain does not have,
a repair or a usage map, is left out.
"""

from collections.abc import Callable
from typing import Any, NamedTuple, Self

import jax
import jax.numpy as jnp
import optax

from qdenv.surrogates.networks import MapPredictor, ScorePredictor
from qdenv.surrogates.settings import SurrogateConfig
from qdenv.types import Encoding, InputError, Score


class Samples(NamedTuple):
    """True evaluations of N layouts."""

    drawn: jax.Array  # int8 [N, H, W], before the repair
    repaired: jax.Array  # int8 [N, H, W]
    # float16 [N, H, W], share of agent-steps on each cell; zeros where it is not recorded
    usage: jax.Array
    numbers: jax.Array  # float32 [N, heads], objective, result objective, measures


class Ring(NamedTuple):
    """The newest samples."""

    samples: Samples  # with leading axis N; those from `known` on are blank while it is not full
    added: jax.Array  # int32, samples ever added

    @classmethod
    def empty(cls, size: int, shape: tuple[int, int], heads: int) -> Self:
        """Make a ring for `size` samples of layouts of `shape`."""
        kinds = (jnp.int8, jnp.int8, jnp.float16)
        maps = [jnp.zeros((size, *shape), kind) for kind in kinds]
        return cls(Samples._make([*maps, jnp.zeros((size, heads), jnp.float32)]), jnp.int32(0))

    @property
    def known(self) -> jax.Array:
        """Return the number of samples (int32)."""
        return jnp.minimum(self.added, self.samples.numbers.shape[0])

    def add(self, batch: Samples, valid: jax.Array) -> Self:
        """Add the samples of a batch [B, ...] that are `valid` (bool [B]), over the oldest."""
        # No network would recover from a sample that is not finite.
        valid &= jnp.isfinite(batch.usage).all(axis=(1, 2))
        valid &= jnp.isfinite(batch.numbers).all(axis=-1)
        size = self.samples.numbers.shape[0]
        place = (self.added + jnp.cumsum(valid) - 1) % size
        # Of a batch longer than the ring the last remain.
        newest = valid & (jnp.cumsum(valid[::-1])[::-1] <= size)
        target = jnp.where(newest, place, size)  # others: out of bounds
        samples = jax.tree.map(
            lambda old, new: old.at[target].set(new.astype(old.dtype), mode="drop"),
            self.samples,
            batch,
        )
        return self._replace(samples=samples, added=self.added + valid.sum(dtype=jnp.int32))


def _spread_of(numbers: jax.Array, valid: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Compute mean and variance (float32 [heads]) of the `valid` rows (bool [N]) of [N, heads].

    Both are zeros where no row is valid.
    """
    # Counted from one of the rows: numbers that never vary have a variance of exactly zero.
    origin = jnp.where(valid.any(), numbers[jnp.argmax(valid)], 0.0)
    shifted, counts = numbers - origin[None], valid[:, None]
    total = jnp.maximum(valid.sum(), 1)
    centre = jnp.sum(shifted, axis=0, where=counts) / total
    variance = jnp.sum(jnp.square(shifted - centre[None]), axis=0, where=counts) / total
    return origin + centre, variance


def shuffled(key: jax.Array, size: int, count: jax.Array) -> jax.Array:
    """Order the first `count` of `size` samples at random (int32 [size]); consumes `key`."""
    # Draws are below 1: samples beyond `count` come last.
    draws = jax.random.uniform(key, (size,))
    return jnp.argsort(jnp.where(jnp.arange(size) < count, draws, 2.0)).astype(jnp.int32)


def usage_loss(predicted: jax.Array, usage: jax.Array, kind: str) -> jax.Array:
    """Compare usage maps [B, H, W] with logits ("kl", summed over cells) or numbers ("mse").

    Both are averaged over the batch.
    """
    rows = len(usage)
    flat, usage = predicted.reshape(rows, -1), usage.astype(jnp.float32).reshape(rows, -1)
    # float16 has rounded the shares: they must sum to 1 again.
    share = usage / jnp.maximum(usage.sum(axis=-1, keepdims=True), 1e-12)
    if kind == "kl":
        return optax.losses.kl_divergence(jax.nn.log_softmax(flat, axis=-1), share).mean()
    # In units of an even distribution, as the next network sees them.
    return jnp.square(flat - share * flat.shape[-1]).mean()


class Learner(NamedTuple):
    """One network that learns."""

    variables: Any  # of its Flax module: ``params`` and ``batch_stats``
    moments: Any  # Adam's


STAGES = ("repair", "usage", "score")  # the networks, in the order in which they learn


class Fitted(NamedTuple):
    """What a surrogate has learnt; one pytree."""

    learners: dict[str, Learner]  # its networks, by the names of `STAGES` that there are
    centre: jax.Array  # float32 [heads], what is subtracted from objective and measures
    spread: jax.Array  # float32 [heads], what they are divided by after that
    fits: jax.Array  # int32, how often it was fitted to samples


class Surrogate:
    """A surrogate of true evaluations; all its methods are traceable."""

    def __init__(self, config: SurrogateConfig, encoding: Encoding, measures: int) -> None:
        """Make the networks for layouts of one shape; `measures` is how many are predicted.

        Raises InputError if there is another number of weights than of numbers to predict.
        """
        self.heads = 2 + measures  # numbers: objective, result objective, measures
        if config.weights and len(config.weights) != self.heads:
            those = f"{self.heads}, for objective, result objective and each measure"
            raise InputError(f"{len(config.weights)} weights: give {those}")
        self._config, self._encoding = config, encoding
        present = encoding.repairs, encoding.usage, True
        # The networks that there are, in the order in which they learn.
        self.stages = [name for name, there in zip(STAGES, present, strict=True) if there]
        self._networks: dict[str, Any] = {
            "repair": MapPredictor(config.channels, config.blocks, encoding.kinds),
            "usage": MapPredictor(config.channels, config.blocks, 1),
            "score": ScorePredictor(config.channels, self.heads),
        }
        self._optimiser = optax.adam(config.rate)

    def _inputs(self, learners: dict[str, Learner], drawn: jax.Array) -> dict[str, jax.Array]:
        """Compute the maps that each network takes, up to the first that is not made yet."""
        encoding = self._encoding

        def output(name: str, maps: jax.Array) -> jax.Array:
            return self._networks[name].apply(learners[name].variables, maps, False)

        tiles = jax.nn.one_hot(drawn, encoding.kinds)
        maps = {"repair": tiles}
        if encoding.repairs:
            if "repair" not in learners:
                return maps
            tiles = output("repair", tiles)
        maps["usage"] = tiles
        # The score network sees tiles that are decided, as the simulator does, not their odds.
        decided = jax.nn.one_hot(tiles.argmax(axis=-1), encoding.kinds)
        if not encoding.usage:
            return maps | {"score": decided}
        if "usage" not in learners:
            return maps
        usage = output("usage", tiles)
        if self._config.usage_loss == "kl":
            # A distribution over the cells, in units of an even one.
            flat = usage.reshape(len(usage), -1)
            usage = (jax.nn.softmax(flat, axis=-1) * flat.shape[-1]).reshape(usage.shape)
        return maps | {"score": jnp.concatenate([decided, usage], axis=-1)}

    def _loss(
        self, name: str, learners: dict[str, Learner], scale: tuple[jax.Array, jax.Array]
    ) -> Callable[..., tuple[jax.Array, Any]]:
        """Make the loss of one network; those before it are fixed.

        It takes variables and samples, and returns also the running statistics after it.
        """

        def loss(variables: Any, batch: Samples) -> tuple[jax.Array, Any]:
            maps = self._inputs(learners, batch.drawn)[name]
            result, changed = self._networks[name].apply(
                variables, maps, True, mutable=["batch_stats"]
            )
            stats = changed.get("batch_stats", {})
            if name == "repair":
                # The gradient of looking a label up is a scatter, which XLA compiles for seconds.
                labels = jax.nn.one_hot(batch.repaired, self._encoding.kinds)
                return optax.softmax_cross_entropy(result, labels).mean(), stats
            if name == "usage":
                return usage_loss(result[..., 0], batch.usage, self._config.usage_loss), stats
            target = (batch.numbers - scale[0][None]) / scale[1][None]
            weights = jnp.asarray(self._config.weights or (1.0,) * target.shape[-1])
            return (jnp.square(result - target) * weights[None]).mean(), stats

        return loss

    def init(self, key: jax.Array) -> Fitted:
        """Draw the networks' first parameters; consumes `key`."""
        learners: dict[str, Learner] = {}
        blank = jnp.zeros((1, *self._encoding.shape), jnp.int8)
        for number, name in enumerate(self.stages):
            maps = self._inputs(learners, blank)[name]
            variables = self._networks[name].init(jax.random.fold_in(key, number), maps, False)
            # A network without running statistics has the same form as the others.
            variables = {"batch_stats": {}, **variables}
            learners[name] = Learner(variables, self._optimiser.init(variables["params"]))
        return Fitted(learners, jnp.zeros(self.heads), jnp.ones(self.heads), jnp.int32(0))

    def fit_part(
        self, fitted: Fitted, ring: Ring, key: jax.Array, name: str, first: Any, last: Any
    ) -> tuple[Fitted, jax.Array]:
        """Fit the network `name` from epoch `first` to the one before `last`.

        Returns what is learnt, and the mean loss of the last epoch. This is `fit` in pieces, to
        show progress between them; all take the same key. The last minibatch of an epoch is filled
        up with the epoch's first samples. Without samples the network stays as it is.
        """
        minibatch, size, count = self._config.minibatch, len(ring.samples.numbers), ring.known
        scale = _scale(ring) if self._config.standardise else (fitted.centre, fitted.spread)
        loss = self._loss(name, fitted.learners, scale)
        key = jax.random.fold_in(key, self.stages.index(name))
        steps = (count + minibatch - 1) // minibatch

        def epoch(number: jax.Array, now: tuple[Learner, jax.Array]) -> tuple[Learner, jax.Array]:
            order = shuffled(jax.random.fold_in(key, number), size, count)

            def step(i: jax.Array, now: tuple[Learner, jax.Array]) -> tuple[Learner, jax.Array]:
                (variables, moments), total = now
                rows = order[(i * minibatch + jnp.arange(minibatch)) % jnp.maximum(count, 1)]
                batch = jax.tree.map(lambda leaf: leaf[rows], ring.samples)
                (value, stats), slope = jax.value_and_grad(
                    lambda params: loss({**variables, "params": params}, batch), has_aux=True
                )(variables["params"])
                change, moments = self._optimiser.update(slope, moments, variables["params"])
                params = optax.apply_updates(variables["params"], change)
                variables = {**variables, "params": params, "batch_stats": stats}
                return Learner(variables, moments), total + value

            learner, total = jax.lax.fori_loop(0, steps, step, (now[0], jnp.float32(0)))
            return learner, total / jnp.maximum(steps, 1)

        begin = fitted.learners[name], jnp.float32(0)
        learner, mean = jax.lax.fori_loop(first, last, epoch, begin)
        return Fitted({**fitted.learners, name: learner}, *scale, fitted.fits), mean

    def fit(
        self, fitted: Fitted, ring: Ring, key: jax.Array
    ) -> tuple[Fitted, dict[str, jax.Array]]:
        """Fit all networks; return what is learnt, and each one's mean loss of its last epoch.

        Consumes `key`.
        """
        losses = {}
        for name in self.stages:
            fitted, losses[name] = self.fit_part(fitted, ring, key, name, 0, self._config.epochs)
        return fitted._replace(fits=fitted.fits + (ring.known > 0)), losses

    def predict(self, fitted: Fitted, drawn: jax.Array) -> tuple[Score, jax.Array, jax.Array]:
        """Predict what becomes of layouts as they are drawn (int8 [B, H, W]).

        Returns their `Score`, a success where every number is finite, the repaired maps, and the
        usage in units of an even share, float32 [B, H, W], which is zeros where none is learnt.
        """
        maps = self._inputs(fitted.learners, drawn)
        variables = fitted.learners["score"].variables
        result = self._networks["score"].apply(variables, maps["score"], False)
        numbers = result * fitted.spread[None] + fitted.centre[None]
        success = jnp.isfinite(numbers).all(axis=-1)
        score = Score(numbers[:, 0], numbers[:, 1], numbers[:, 2:], success)
        repaired = maps["usage"].argmax(axis=-1).astype(jnp.int8)
        encoding, usage = self._encoding, jnp.zeros(drawn.shape)
        if encoding.usage:
            usage = maps["score"][..., encoding.kinds]
        return score, repaired, usage


def _scale(ring: Ring) -> tuple[jax.Array, jax.Array]:
    """Compute mean and standard deviation of the samples' numbers, each float32 [heads].

    The deviation of a number that never varies is 1.
    """
    numbers, known = ring.samples.numbers, jnp.arange(len(ring.samples.numbers)) < ring.known
    centre, variance = _spread_of(numbers, known)
    return centre, jnp.where(variance > 0, jnp.sqrt(variance), 1.0)


def errors(predicted: jax.Array, truth: jax.Array, valid: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Compute RMSE and R^2 of numbers [B, heads] over the valid rows, each float32 [heads].

    R^2 is 1 - (mean squared error) / (variance of the truth); 0 where the truth does not vary.
    """
    squared = jnp.mean(jnp.square(predicted - truth), axis=0, where=valid[:, None])
    variance = _spread_of(truth, valid)[1]
    share = jnp.where(variance > 0, 1 - squared / jnp.where(variance > 0, variance, 1), 0.0)
    return jnp.sqrt(squared), share
