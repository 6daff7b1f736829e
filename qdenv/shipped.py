"""Trained generators that ship: for each domain a small run whose elites have names.

qdenv/zoo/DOMAIN/config.json, manifest.json, metrics.csv   of the run they come from
qdenv/zoo/DOMAIN/archive.npz       the chosen elites alone
qdenv/zoo/DOMAIN/generators.json   their names and figures, a `Collection`

`experiments/zoo.py` writes them; most commands that read a run take ``zoo:DOMAIN/NAME``, too.
"""

import os
from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import NamedTuple

from qdenv.io.records import read_json
from qdenv.types import InputError, look_up

PREFIX = "zoo:"
HOME = Path(__file__).parent / "zoo"
TABLE = "generators.json"
USUAL = "best"  # the generator of a domain where none is named


@dataclass(frozen=True)
class Driven:
    """The simulations of one layout under one planner."""

    # "high" effort of our planner, "published" priority-based search, or the "agent" of mazes
    planner: str
    agents: int  # how many drive
    timesteps: int  # horizon T
    runs: int  # how many simulations, seeds 0, 1, ..
    mean: float  # of what is counted (`Origin.counted`), over all runs
    error: float | None  # its standard error; None with one run
    success: float  # share of the runs that did not congest, or reached the goal


@dataclass(frozen=True)
class GrownLayout:
    """A generator's layout of one size."""

    rows: int  # of the layout
    cols: int  # of the layout
    steps: int  # of growth
    numbers: Mapping[str, int]  # exact numbers of tiles, by the settings' names
    repair: str  # how the repair ended
    changed: int  # cells it changed
    # of the repaired layout, as far as they need no simulation, by their names
    measures: Mapping[str, float]
    driven: tuple[Driven, ...]  # simulations, a record for each planner
    # `grid.checksum` of the layout before its repair; empty for an automaton of floats, which draws
    # another elsewhere
    drawing: str = ""


@dataclass(frozen=True)
class NamedGenerator:
    """One generator."""

    name: str  # within its domain
    about: str  # a sentence
    cell: tuple[int, ...]  # in the archive, an index along each measure
    objective: float  # in the search
    sizes: tuple[GrownLayout, ...]  # layouts of it, the trained size first


@dataclass(frozen=True)
class Origin:
    """The run that the generators of a domain come from."""

    run: str  # its name, that of a preset
    algorithm: str  # of the search
    seed: int  # its random seed
    evaluations: int  # done in all
    qdenv: str  # version that searched
    created: str  # when it began
    counted: str  # what is averaged over simulations, with its unit
    further: int = 0  # evaluations of more runs, from other elites, that gave some of these
    start: str = ""  # the generator of the zoo before this one where it began; "" for zeros


@dataclass(frozen=True)
class Collection:
    """The generators of one domain, as the table in its folder holds them."""

    domain: str  # its name
    origin: Origin  # where they come from
    generators: tuple[NamedGenerator, ...]  # the best first


class Shipped(NamedTuple):
    """A generator of the zoo, which stands for the run it comes from."""

    collection: Collection  # the domain's
    generator: NamedGenerator  # of it

    def drawing(self, cell: tuple[int, ...], shape: tuple[int, int], steps: int) -> str:
        """Return the recorded `GrownLayout.drawing` of an elite at a size, or nothing."""
        sizes = (
            size for one in self.collection.generators if one.cell == cell for size in one.sizes
        )
        alike = (one for one in sizes if (one.rows, one.cols, one.steps) == (*shape, steps))
        return next((one.drawing for one in alike), "")

    def __str__(self) -> str:
        """Return its name on command lines."""
        return f"{PREFIX}{self.collection.domain}/{self.generator.name}"


def names() -> dict[str, tuple[str, ...]]:
    """Return the domains of the zoo, each with the names of its generators."""
    domains = sorted(path.parent.name for path in HOME.glob(f"*/{TABLE}"))
    return {name: tuple(one.name for one in _read(name).generators) for name in domains}


@lru_cache(maxsize=16)
def _read(domain: str) -> Collection:
    return read_json(HOME / domain / TABLE, Collection)


def named(text: str) -> Shipped:
    """Find the generator ``DOMAIN/NAME``, or the best one of ``DOMAIN``, or raise InputError."""
    domain, _, name = text.partition("/")
    look_up(names(), domain, "domain of the zoo")
    collection = _read(domain)
    generators = {one.name: one for one in collection.generators}
    return Shipped(collection, look_up(generators, name or USUAL, f"generator of {domain}"))


def find(place: str | Path) -> Shipped | None:
    """Find the generator that ``zoo:DOMAIN/NAME`` or the path of a folder of the zoo stands for.

    Links are followed. None for other places; raises InputError as `named` does.
    """
    text = place.as_posix() if isinstance(place, Path) else str(place)
    if text.startswith(PREFIX):
        return named(text.removeprefix(PREFIX))
    folder = Path(os.path.realpath(text))  # unlike Path.resolve, it never raises
    if folder.parent != Path(os.path.realpath(HOME)) or folder.name not in names():
        return None
    return named(folder.name)


def refuse_inside(path: Path) -> None:
    """Raise InputError if a file or folder to be written lies in the zoo; links are followed."""
    place = Path(os.path.realpath(path))
    if Path(os.path.realpath(HOME)) in (place, *place.parents):
        raise InputError(f"{path}: this folder ships with qdenv: name one of your own")


def file_name(run_dir: Path) -> str:
    """Return the stem of files made from a run: its folder's name, or its name in the zoo."""
    shipped = find(run_dir)
    return str(shipped)[len(PREFIX) :].replace("/", "-") if shipped else run_dir.resolve().name
