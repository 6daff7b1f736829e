"""A domain's generators in the zoo, chosen from its run: what grown layouts are drawn by."""

from typing import NamedTuple

from experiments import zoo
from experiments.pieces import Folders, Piece, Say
from experiments.runs import SavedRun
from qdenv.zoo import shipped

SECONDS = 1200.0  # CPU seconds of choosing and measuring about ten


class SavedZoo(NamedTuple):
    """The zoo of one domain.

    Attributes:
        domain: its name.
    """

    domain: str

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
        return float(self.domain in shipped.names())

    def cost(self, folders: Folders) -> float:
        """Estimate the CPU seconds of choosing and measuring."""
        return 0.0 if self.done(folders) else SECONDS

    def make(self, folders: Folders, say: Say) -> None:
        """Choose the generators and write them into the package."""
        say(f"{self.name}: is being chosen; {zoo.ZOO} will hold it")
        zoo.main(self.run.whole(folders, say).path)
