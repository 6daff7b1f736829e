"""A domain's generators in the zoo, chosen from its run: what grown layouts are drawn by."""

from typing import NamedTuple

from experiments import zoo
from experiments.pieces import Folders, Piece, Say
from experiments.runs import SavedRun
from qdenv.run.directory import RunDirectory
from qdenv.shipped import PREFIX, USUAL, named, names

SECONDS = 1200.0  # CPU seconds of choosing and measuring about ten
GROWERS = ("nca", "nca-s")  # makers of layouts that are generators of the zoo


class SavedZoo(NamedTuple):
    """The zoo of one domain."""

    domain: str  # its name

    @property
    def kind(self) -> str:
        """Count it among these."""
        return "zoos"

    @property
    def name(self) -> str:
        """How lists call it."""
        return f"zoo of {self.domain}"

    @property
    def run(self) -> SavedRun:
        """Name the run whose elites are chosen from: that of the preset of the domain's name."""
        return SavedRun(self.domain)

    @property
    def needs(self) -> tuple[Piece, ...]:
        """The run."""
        return (self.run,)

    def done(self, folders: Folders) -> float:
        """Say whether the package has one."""
        return float(self.domain in names())

    def cost(self, folders: Folders) -> float:
        """Estimate the CPU seconds of choosing and measuring."""
        return 0.0 if self.done(folders) else SECONDS

    def make(self, folders: Folders, say: Say) -> None:
        """Choose the generators and write them into the package."""
        say(f"{self.name}: is being chosen; {zoo.ZOO} will hold it")
        zoo.main(self.run.whole(folders, say).path)


def open_generator(domain: str, maker: str) -> RunDirectory:
    """Open the generator of the zoo that draws for a maker.

    Args:
        domain: whose.
        maker: "nca" for the best, "nca-s" for the one that moves most at the trained size.

    Raises:
        InputError: the zoo has no such domain.
    """
    name = USUAL if maker == "nca" else most_at_s(domain)
    return RunDirectory.open(f"{PREFIX}{domain}/{name}")


def most_at_s(domain: str) -> str:
    """Name the generator of the zoo that moves most at the trained size, and flows there.

    Raises:
        InputError: the zoo has no such domain.
    """
    generators = named(domain).collection.generators

    def moved(name: str) -> float:
        driven = generators[name].sizes[0].driven[0]
        return driven.mean if driven.success == 1 else 0.0

    return max(generators, key=moved)
