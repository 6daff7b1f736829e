"""The face of a generator: one flat parameter vector in, a drawing of tiles out.

A generator is chosen by the type of its settings: `GENERATORS.make(settings, canvas)`.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

from qdenv.lazy import jax
from qdenv.registry import Registry


class Canvas(NamedTuple):
    """What a generator draws on."""

    rows: int  # rows h of the generated area
    cols: int  # columns w of the generated area
    tiles: str  # symbols that may be drawn; the first one is the empty tile
    seed_block: tuple[str, ...]  # rows of the fixed block in the middle of the empty canvas


class Generator(NamedTuple):
    """A way to draw, addressed by one flat parameter vector."""

    size: int  # number of parameters P
    steps: int  # steps of growth at the size it was configured for; 0 where nothing grows
    # (solutions float32 [B, P], steps) -> tiles int8 [B, h, w]; traceable. Generators that do not
    # grow ignore the number of steps.
    grow: Callable[[jax.Array, jax.Array | int], jax.Array]
    choices: int = 0  # where each parameter names a tile, how many there are; 0 for real numbers
    # (solutions float32 [B, P], steps) -> tiles int8 [B, steps + 1, h, w], the canvas from the
    # start to the layout that `grow` draws; the number of steps is static. None where a generator
    # tells only how it ends.
    frames: Callable[[jax.Array, int], jax.Array] | None = None


# An entry's maker is called as make(settings, canvas) and returns a `Generator`.
GENERATORS = Registry(
    "generator",
    "qdenv.generators",
    {
        "nca": "qdenv.generate.settings:NCA_GENERATOR",
        "direct": "qdenv.generate.settings:DIRECT_GENERATOR",
    },
)
