"""What the surrogate's networks make small, as published."""

import jax
import jax.numpy as jnp
import optax


def map_loss(logits: jax.Array, tiles: jax.Array) -> jax.Array:
    """Average the cross entropy of tiles int8 [B, H, W] under logits [B, H, W, K]."""
    # The gradient of looking a label up is a scatter: XLA takes seconds to compile it, and says so.
    return optax.softmax_cross_entropy(logits, jax.nn.one_hot(tiles, logits.shape[-1])).mean()


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


def score_loss(predicted: jax.Array, target: jax.Array, weights: jax.Array) -> jax.Array:
    """Average the weighted squared errors of numbers [B, heads] over batch and heads."""
    return (jnp.square(predicted - target) * weights[None]).mean()
