"""What the domains measure alike."""

from __future__ import annotations

from typing import Any

from qdenv import score
from qdenv.generate.decode import inside_frame
from qdenv.lazy import jax, jnp
from qdenv.types import Array, Measure


def environment_entropy(kinds: int, margin: tuple[int, int] = (0, 0)) -> Measure:
    """Make the axis of the environment entropy of the generated area (section 4 of the paper).

    Args:
        kinds: kinds of tile the generator can draw.
        margin: rows and columns of the frame on each side.
    """

    def value(layout: jax.Array, runs: Any) -> jax.Array:
        del runs
        area = inside_frame(layout, margin)
        # A tile that no generator draws is there only where somebody keeps it: it counts as the
        # first, since a pattern of it has no number.
        return score.entropy(jnp.where(area < kinds, area, 0), kinds)

    return Measure("environment entropy", 0, 1, 100, value)


def weigh_alike(layout: Array) -> jax.Array:
    """Weigh every cell 1 in the similarity (int8 [H, W] -> float32 [H, W])."""
    return jnp.ones(layout.shape, jnp.float32)
