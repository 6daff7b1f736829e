"""What a figure is drawn from: pieces of saved results that can be made and say what that costs."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple, Protocol, TypeAlias

from matplotlib.figure import Figure

RESULTS = Path(__file__).parent / "results"
Say: TypeAlias = Callable[[str], None]


class Folders(NamedTuple):
    """Where everything lies.

    Attributes:
        results: what is kept and ships.
        runs: whole run directories, with all weights: too large to ship.
    """

    results: Path = RESULTS
    runs: Path = Path("runs")


class Piece(Protocol):
    """A saved result."""

    @property
    def name(self) -> str:
        """How lists call it."""

    def done(self, folders: Folders) -> float:
        """Say which share of it is saved, 0 to 1."""

    def cost(self, folders: Folders) -> float:
        """Estimate the CPU seconds that making the rest takes."""

    def make(self, folders: Folders, say: Say) -> None:
        """Make the rest, so that an interruption loses little; `say` hears how far it is."""


class Drawn(NamedTuple):
    """What an experiment shows.

    Attributes:
        figure: the picture; None for a table alone.
        lines: a table in markdown, ours beside the paper's.
    """

    figure: Figure | None
    lines: tuple[str, ...] = ()


@dataclass(frozen=True)
class Experiment:
    """A figure or a table of the paper.

    Attributes:
        shows: what, in one line.
        pieces: what it is drawn from.
        draw: draws what is saved of the pieces; at least one is.
    """

    shows: str
    pieces: tuple[Piece, ...]
    draw: Callable[[Folders], Drawn]

    def missing(self, folders: Folders) -> list[Piece]:
        """List the pieces that are not whole."""
        return [piece for piece in self.pieces if piece.done(folders) < 1]

    def drawable(self, folders: Folders) -> bool:
        """Tell whether anything is saved to draw from."""
        return any(piece.done(folders) > 0 for piece in self.pieces)


def table(head: Sequence[str], rows: Sequence[tuple[object, ...]]) -> tuple[str, ...]:
    """Write a table in markdown."""
    lines = [f"| {' | '.join(head)} |", "| --- " * len(head) + "|"]
    return tuple(lines + [f"| {' | '.join(map(str, row))} |" for row in rows])
