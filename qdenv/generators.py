"""The interface of generators: one flat parameter vector in, a drawing of tiles out.

A generator is chosen by the type of its settings: `GENERATORS.make(settings, canvas)`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, ClassVar, Literal, NamedTuple, TypeAlias

import numpy as np
import tyro

from qdenv.grid import parse
from qdenv.guidance import NUM_SMOOTH, existing_moves, scaled_costs, smooth_logarithms
from qdenv.lazy import jax, jnp
from qdenv.ranges import PositiveInt, Ranged
from qdenv.registry import Entry, Registry
from qdenv.types import Array, InputError

# Counts the moves of one simulation under some costs, (costs int32 [5, H, W], number of the
# simulation) -> int32 [5, H, W].
Drive: TypeAlias = Callable[[Any, int], Any]
# Draws costs of moves (`guidance`), (solution float32 [P], steps, repaired layout int8 [H, W],
# drive) -> int32 [5, H, W]; traceable, of one layout.
Guide: TypeAlias = Callable[[Any, Any, Any, Drive], Any]
# Rows of a drawing or of numbers, which commands read from a file: no option of its own.
Rows: TypeAlias = tyro.conf.SuppressFixed[tyro.conf.Fixed[tuple[str, ...]]]


class Canvas(NamedTuple):
    """What a generator draws on."""

    rows: int  # rows h of the generated area
    cols: int  # columns w of the generated area
    tiles: str  # symbols that may be drawn; the first one is the empty tile
    seed_block: tuple[str, ...]  # rows of the fixed block in the middle of the empty canvas
    domain: Any = None  # the `Domain` whose area it is, for generators that draw for one


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
    # gives only the end.
    frames: Callable[[jax.Array, int], jax.Array] | None = None
    # what moves cost on the layout when it is repaired; None where only tiles are drawn
    guide: Guide | None = None


# A guidance that any floor can have, by its name in `guidance.GUIDANCE`.
Base: TypeAlias = Literal["none", "crisscross", "crisscross-pairs"]


@dataclass(frozen=True)
class NcaConfig(Ranged):
    """Settings of a neural cellular automaton (appendix C.1.1 of the paper)."""

    steps: PositiveInt = 50  # steps of growth of a drawing, C in the paper
    kernel_sizes: tuple[int, ...] = (3, 3, 3)  # widths of the kernels of its convolutions, in cells
    hidden: PositiveInt = 32  # channels of its hidden layers
    # "exact" draws the same plan on every machine and version, as its sums never round (`nca`);
    # "float" is the paper's, and that of runs from before there was a choice
    arithmetic: Literal["exact", "float"] = "exact"

    def __post_init__(self) -> None:
        """Refuse kernels that are even: without a centre cell the drawing would drift."""
        super().__post_init__()
        sizes = self.kernel_sizes
        # Flax sorts layers by their names: of more, the eleventh would be the third.
        if not 0 < len(sizes) <= 10 or any(size < 1 or size % 2 == 0 for size in sizes):
            raise InputError(f"kernel sizes {tuple(sizes)} must be one to ten positive odd numbers")


@dataclass(frozen=True)
class GuidedNcaConfig(NcaConfig):
    """Settings of an automaton that draws the costs of moves in five more channels."""

    base: Base = "crisscross"  # the costs that it draws factors of
    # whether they are smooth over the floor: thirty numbers more, in place of the channels
    smooth: bool = False


@dataclass(frozen=True)
class CostsConfig(Ranged):
    """Settings of the generator of an existing floor: a solution is the costs themselves."""

    draws: ClassVar[bool] = False  # tiles: nothing is repaired
    # rows of the floor: ``.`` where robots drive, ``#`` where they cannot
    floor: Rows = ()
    base: Base = "crisscross"  # the costs from which the search begins
    # whether they are smooth over the floor, which may be of any size: thirty numbers
    smooth: bool = False


@dataclass(frozen=True)
class UpdateConfig(Ranged):
    """Settings of an update model of the costs of an existing floor.

    A small network reads the costs of moves and how often each was made, and writes new costs,
    several times over (the parameterised iterative update of Zhang et al. 2024, section 5.2,
    https://arxiv.org/abs/2402.01446). It serves floors of any size.
    """

    draws: ClassVar[bool] = False
    rounds: PositiveInt = 5  # updates, each after a simulation
    kernel_sizes: tuple[int, ...] = (3, 1, 3)  # widths of the kernels of its convolutions, in cells
    hidden: PositiveInt = 16  # channels of its hidden layers
    base: Base = "crisscross"  # the costs that are updated first


@dataclass(frozen=True)
class DirectConfig:
    """Settings of the generator that draws nothing: a solution is the tiles themselves."""


@dataclass(frozen=True)
class RacksConfig:
    """Settings of the generator of racks in rows, twelve numbers a solution (`racks`)."""


# An entry's maker is called as make(settings, canvas) and returns a `Generator`.
GENERATORS = Registry(
    "generator",
    "qdenv.generators",
    {
        "nca": Entry(NcaConfig, "qdenv.nca:nca"),
        "direct": Entry(DirectConfig, "qdenv.generators:direct"),
        "racks": Entry(RacksConfig, "qdenv.racks:racks"),
        "guided-nca": Entry(GuidedNcaConfig, "qdenv.nca:nca"),
        "costs": Entry(CostsConfig, "qdenv.generators:costs"),
        "update": Entry(UpdateConfig, "qdenv.nca:update"),
    },
)


def choose_tiles(cells: Array) -> jax.Array:
    """Choose each cell's strongest channel (float32 [..., H, W, K] -> int8 [..., H, W])."""
    return jnp.argmax(cells, axis=-1).astype(jnp.int8)


def direct(config: DirectConfig, canvas: Canvas) -> Generator:
    """Make the generator whose parameters are tile indices, row by row."""
    choices = len(canvas.tiles)

    def read(solutions: jax.Array, steps: jax.Array | int) -> jax.Array:
        tiles = jnp.clip(jnp.round(solutions), 0, choices - 1).astype(jnp.int8)
        return tiles.reshape(-1, canvas.rows, canvas.cols)

    return Generator(canvas.rows * canvas.cols, 0, read, choices)


def draw_nothing(canvas: Canvas) -> Callable[[jax.Array, jax.Array | int], jax.Array]:
    """Make the `grow` of a generator that draws no tiles: all of its floor must stay."""
    shape = canvas.rows, canvas.cols
    return lambda solutions, steps: jnp.zeros((len(solutions), *shape), jnp.int8)


def costs(config: CostsConfig, canvas: Canvas) -> Generator:
    """Make the generator whose parameters are the logarithms of factors of the costs of moves.

    They are in the order of the moves that exist, waiting first, and the cells row by row; smooth
    costs have those of `smooth_logarithms`. Raises InputError if no floor is stated.
    """
    if not config.floor:
        raise InputError("the generator costs needs an existing floor: use qdenv guide")
    moves = existing_moves(parse(config.floor, "#.") == 1)
    places = np.flatnonzero(moves)

    def guide(solution: jax.Array, steps: Any, layout: jax.Array, drive: Drive) -> jax.Array:
        if config.smooth:
            logarithms = smooth_logarithms(solution, layout.shape, config.base)
        else:
            logarithms = jnp.zeros(moves.size).at[places].set(solution).reshape(moves.shape)
        return scaled_costs(logarithms, config.base)

    size = NUM_SMOOTH if config.smooth else len(places)
    return Generator(size, 0, draw_nothing(canvas), guide=guide)
