"""Saved layouts: grown by an elite of a run, drawn as people do, or tiled; repaired."""

import json
import zlib
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Any, NamedTuple

import jax
import numpy as np

from experiments.ledger import Case
from experiments.pieces import Folders, Piece, say
from experiments.runs import SavedRun, run_of
from qdenv.agent.evaluate import BAND, draw_mazes, without_ring
from qdenv.domains.base import Domain, find_domain
from qdenv.generators import choose_tiles
from qdenv.grid import draw, parse
from qdenv.io.layouts import write_layout
from qdenv.nca import seed_canvas
from qdenv.run.directory import RunDirectory
from qdenv.shipped import PREFIX, USUAL
from qdenv.simulation.maze.world import WALL, longest_path
from qdenv.study import elites as sizes
from qdenv.types import Array, InputError

S, S_EVAL = (33, 36), (101, 102)
MAZE_S, MAZE_S_EVAL = (18, 18), (66, 66)
# Fleets' generators of the first zoo, whose automata are of floats: those that figures simulated.
FIRST_ZOO = Path(__file__).parent / "results" / "zoo"
# Makers of layouts: its best at S_eval, the one that moves most at S where that is another, and the
# best of the zoo that ships.
GROWERS = ("nca", "nca-s", "zoo")
# Makers of warehouses by CMA-MAE, with the seeds of their runs: seed 0's weights are not saved.
CMA_MAE = {"cma-mae": 1, "cma-mae-2": 2}
_longest_path = jax.jit(longest_path)
SECONDS = {S: 4.0, S_EVAL: 10.0}  # CPU seconds of growing and repairing


def open_generator(domain: str, maker: str) -> RunDirectory:
    """Open the run whose best elite draws for one of `GROWERS`; mazes are of the zoo that ships."""
    first = FIRST_ZOO / f"{domain}-{maker}"
    return RunDirectory.open(first if first.exists() else f"{PREFIX}{domain}/{USUAL}")


class Made(NamedTuple):
    """A saved layout."""

    layout: np.ndarray  # int8 [H, W], as it is simulated
    # int8 [H, W], as it was grown or tiled; the same where nothing was repaired
    unrepaired: np.ndarray
    domain: Domain  # at its size
    # what its file says else: steps, cells changed, CPU seconds; "refused": why it has no repair
    facts: dict

    @property
    def free(self) -> np.ndarray:
        """Cells that agents drive on, bool [H, W]; `InputError` where no fleet drives."""
        return self.domain.drivable(self.layout)


@dataclass(frozen=True)
class SavedLayout(Piece):
    """A layout of one domain, maker and size."""

    kind = "layouts"
    label = "layout {0.stem}"
    file = "layouts/{0.stem}.json"
    domain: str  # its name
    # one of `GROWERS`, "human", "tiled", "random-0" and so on (a random maze like that of "nca"),
    # "seed" (what automata grow from), one of `CMA_MAE` or the end of a preset's name: "a0", "a1",
    # "cma-es", "dsage", whose run's best elite draws it
    maker: str
    shape: tuple[int, int] = S  # rows and columns

    @property
    def stem(self) -> str:
        """Name of its file, and of its rows in tables."""
        return "{}-{}-{}x{}".format(self.domain, self.maker, *self.shape)

    @property
    def like(self) -> "SavedLayout":
        """The grown layout that is tiled, or that a random maze takes after."""
        return SavedLayout(self.domain, "nca", S if self.maker == "tiled" else self.shape)

    @property
    def needs(self) -> tuple[Piece, ...]:
        """The run whose elite draws it, or the layout that it takes after."""
        if self.maker == "tiled" or self.maker.startswith("random-"):
            return (self.like,)
        return () if self.maker in ("human", "seed", *GROWERS) else (self.run(),)

    def done(self, folders: Folders) -> float:
        """Return 1 if it is saved, and made from what it would be made from now."""
        path = self.path(folders)
        if not path.exists():
            return 0.0
        return float(json.loads(path.read_text()).get("origin", "") == self.origin(folders))

    def refusal(self, folders: Folders) -> str:
        """Return why it cannot be repaired, and simulated; "" if it can, or is not made yet."""
        return str(self.read(folders).facts.get("refused", "")) if self.done(folders) else ""

    def origin(self, folders: Folders) -> str:
        """Return a checksum of what it is made from; "" if it could be made from nothing else."""
        if self.maker in GROWERS:
            return best_of(self.domain, self.maker)
        if self.like in self.needs:
            return checksum(self.like.read(folders).layout) if self.like.done(folders) else "none"
        return ""

    def run(self) -> SavedRun:
        """Return the run whose best elite draws it."""
        if self.maker in CMA_MAE:
            return replace(run_of(self.domain), seed=CMA_MAE[self.maker])
        return run_of(self.domain, self.maker)

    def seconds(self, folders: Folders) -> float:
        """Estimate the CPU seconds of making it."""
        return 0.0 if self.maker == "human" else SECONDS.get(self.shape, 8.0)

    def make(self, folders: Folders) -> None:
        """Grow, draw or tile it, repair it, and write it with what it was before.

        Where no repair is found the file says so, and holds what could not be repaired.
        """
        say(f"{self.stem}: is being made")
        (grown, seed), refused = self._draw(folders), {}
        try:
            made = sizes.finish(grown, seed)
        except InputError as error:
            say(f"{self.stem}: {error}")
            made = sizes.Sized(grown.layout, grown.steps, {}, "failed", 0, 0.0)
            refused = {"refused": str(error)}
        write_layout(
            self.path(folders),
            made.layout,
            grown.domain.tiles,
            domain=self.domain,
            maker=self.maker,
            origin=self.origin(folders),
            **sizes.details(made),
            **refused,
            unrepaired=draw(grown.layout, grown.domain.tiles),
        )

    def _draw(self, folders: Folders) -> tuple[sizes.Unrepaired, int]:
        """Make the unrepaired layout; return it with the seed of its repair."""
        domain = find_domain(self.domain).resized(*self.shape)
        if self.maker == "human":
            assert domain.human is not None
            layout = domain.human()
            domain = replace(domain, rules=None)  # people obey the rules: nothing is repaired
        elif self.maker == "seed":
            canvas = seed_canvas(domain.seed_block, *domain.generated_shape, domain.generated)
            layout = np.asarray(domain.frame(choose_tiles(canvas)))
            domain = replace(domain, rules=None)  # nothing is repaired here either
        elif self.maker == "tiled":
            layout = np.asarray(domain.frame(sizes.repeat(self.like.read(folders).layout, domain)))
        elif self.maker.startswith("random-"):
            drawn = random_like(self.like.read(folders).layout, int(self.maker[7:]))
            layout = np.asarray(domain.frame(drawn))
        else:
            if self.maker in GROWERS:
                run = open_generator(self.domain, self.maker)
            else:
                run = self.run().best(folders)
            grown = sizes.grow_elite(run, "best", self.shape)
            if self.maker != "zoo":  # annealed as in searches, like all that are saved
                grown = grown._replace(repair=run.config.evaluation.repair)
            return grown, run.config.seed
        return sizes.Unrepaired(domain, None, layout, 0), 0

    def read(self, folders: Folders) -> Made:
        """Read it; raise InputError if it is not saved."""
        path = self.path(folders)
        try:
            about = path.stat()
        except OSError as error:
            raise InputError(f"{path}: not saved yet") from error
        return _read(path, (about.st_mtime_ns, about.st_ino), self.domain, self.shape)


@dataclass(frozen=True)
class OfLayout(Piece):
    """A result on one layout."""

    layout: SavedLayout  # which

    @property
    def needs(self) -> tuple[Piece, ...]:
        """The layout."""
        return (self.layout,)

    def case_of(self, folders: Folders, *settings: Any) -> Case:
        """Return a case of simulations of the layout, with the further fields of a `Case`."""
        made = self.layout.read(folders)
        return Case(self.layout.stem, made.layout, made.domain, *settings)


# Every piece that is made from a layout reads it, again and again.
@lru_cache(maxsize=256)
def _read(path: Path, stamp: tuple[int, int], name: str, shape: tuple[int, int]) -> Made:
    """Read a layout once; `stamp` tells the file from what it was before."""
    del stamp
    content, domain = json.loads(path.read_text()), find_domain(name).resized(*shape)
    layout, unrepaired = (parse(content.pop(key), domain.tiles) for key in ("layout", "unrepaired"))
    return Made(layout, unrepaired, domain.fitted(layout), content)


def best_of(domain: str, maker: str = "nca") -> str:
    """Return a checksum of the generator that draws for one of `GROWERS`."""
    return checksum(open_generator(domain, maker).best.solution)


def checksum(*arrays: Array) -> str:
    """Return a checksum of arrays."""
    return f"{zlib.crc32(b''.join(np.asarray(array).tobytes() for array in arrays)):08x}"


def random_like(layout: np.ndarray, seed: int) -> np.ndarray:
    """Draw a random maze of as many walls and about as long a way as a ringed one, ringless."""
    inside = without_ring(layout)
    low, high = (share * int(_longest_path(inside).length) for share in BAND)
    walls = int((inside == WALL).sum())
    (drawn,) = draw_mazes(seed, 1, inside.shape, walls, lambda length: low <= length <= high)
    return drawn.layout
