"""A domain's generators in the zoo, chosen from its run: what grown layouts are drawn by."""

from dataclasses import dataclass

from experiments import zoo
from experiments.pieces import Folders, Piece, Say
from experiments.runs import SavedRun
from qdenv.run.directory import RunDirectory
from qdenv.shipped import PREFIX, USUAL, NamedGenerator, named, names

GROWERS = ("nca", "nca-s")  # makers of layouts that are generators of the zoo


@dataclass(frozen=True)
class SavedZoo(Piece):
    """The zoo of one domain."""

    kind = "zoos"
    label = "zoo of {0.domain}"
    domain: str  # its name

    @property
    def run(self) -> SavedRun:
        """Return the run that elites are chosen from, of the preset of the domain's name."""
        return SavedRun(self.domain)

    @property
    def needs(self) -> tuple[Piece, ...]:
        """The run."""
        return (self.run,)

    def done(self, folders: Folders) -> float:
        """Return 1 if the package has one."""
        return float(self.domain in names())

    def seconds(self, folders: Folders) -> float:
        """Estimate the CPU seconds of choosing and measuring about ten."""
        return 1200.0

    def make(self, folders: Folders, say: Say) -> None:
        """Choose the generators and write them into the package."""
        say(f"{self.name}: is being chosen; {zoo.HOME} will hold it")
        zoo.main(self.run.whole(folders, say).path)


def open_generator(domain: str, maker: str) -> RunDirectory:
    """Open the zoo's generator: its best for the maker "nca", `most_at_s` for "nca-s"."""
    name = USUAL if maker == "nca" else most_at_s(domain)
    return RunDirectory.open(f"{PREFIX}{domain}/{name}")


def most_at_s(domain: str) -> str:
    """Return the name of the generator that moves most at the trained size, and flows there."""

    def moved(one: NamedGenerator) -> float:
        driven = one.sizes[0].driven[0]
        return driven.mean if driven.success == 1 else 0.0

    return max(named(domain).collection.generators, key=moved).name
