"""True evaluations as the surrogate learns from them: a ring of the newest."""

from typing import NamedTuple, Self

import jax
import jax.numpy as jnp


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
        maps = (size, *shape)
        blank = Samples(
            jnp.zeros(maps, jnp.int8),
            jnp.zeros(maps, jnp.int8),
            jnp.zeros(maps, jnp.float16),
            jnp.zeros((size, heads), jnp.float32),
        )
        return cls(blank, jnp.int32(0))

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


def spread_of(numbers: jax.Array, valid: jax.Array) -> tuple[jax.Array, jax.Array]:
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
