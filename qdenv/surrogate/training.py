"""How a network of the surrogate learns: epochs of minibatches, by Adam."""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import optax

from qdenv.surrogate.samples import Ring, Samples, shuffled


class Learner(NamedTuple):
    """One network that learns."""

    variables: Any  # of its Flax module: ``params`` and ``batch_stats``
    moments: Any  # Adam's


# (variables, samples) -> (loss float32, running statistics after it)
Loss = Callable[[Any, Samples], tuple[jax.Array, Any]]


def make_learner(variables: Any, optimiser: optax.GradientTransformation) -> Learner:
    """Begin to learn with fresh moments."""
    # A network without running statistics has none to change, but the same form as the others.
    return Learner({"batch_stats": {}, **variables}, optimiser.init(variables["params"]))


def learn(
    loss: Loss,
    learner: Learner,
    optimiser: optax.GradientTransformation,
    ring: Ring,
    minibatch: int,
    epochs: int | jax.Array,
    key: jax.Array,
    first: int | jax.Array = 0,
) -> tuple[Learner, jax.Array]:
    """Fit one network to all samples of a ring; traceable, with loops over epochs and steps.

    The last minibatch of an epoch is filled up with the epoch's first samples.

    Args:
        loss: what is made small.
        learner: the network; without samples it stays as it is.
        optimiser: Adam.
        ring: the samples.
        minibatch: samples per step.
        epochs: passes over the samples.
        key: consumed.
        first: epoch to begin with: where a fit is cut in pieces makes no difference.

    Returns:
        the network, and the mean loss of its last epoch.
    """
    size, count = ring.samples.numbers.shape[0], ring.known
    steps = (count + minibatch - 1) // minibatch

    def step(learner: Learner, batch: Samples) -> tuple[Learner, jax.Array]:
        def of_weights(params: Any) -> tuple[jax.Array, Any]:
            return loss({**learner.variables, "params": params}, batch)

        params = learner.variables["params"]
        (value, stats), slope = jax.value_and_grad(of_weights, has_aux=True)(params)
        change, moments = optimiser.update(slope, learner.moments, params)
        new = {"params": optax.apply_updates(params, change), "batch_stats": stats}
        return Learner({**learner.variables, **new}, moments), value

    def epoch(number: jax.Array, now: tuple[Learner, jax.Array]) -> tuple[Learner, jax.Array]:
        order = shuffled(jax.random.fold_in(key, number), size, count)

        def once(i: jax.Array, now: tuple[Learner, jax.Array]) -> tuple[Learner, jax.Array]:
            learner, total = now
            rows = order[(i * minibatch + jnp.arange(minibatch)) % jnp.maximum(count, 1)]
            learner, value = step(learner, jax.tree.map(lambda leaf: leaf[rows], ring.samples))
            return learner, total + value

        learner, total = jax.lax.fori_loop(0, steps, once, (now[0], jnp.float32(0)))
        return learner, total / jnp.maximum(steps, 1)

    return jax.lax.fori_loop(first, epochs, epoch, (learner, jnp.float32(0)))
