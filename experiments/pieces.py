"""What a figure is drawn from: pieces of saved results that can be made and say what that costs."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, ClassVar, NamedTuple, Protocol

from matplotlib.figure import Figure

from qdenv.run.executors import Execution

RESULTS = Path(__file__).parent / "results"
say = partial(print, flush=True)  # a line on the progress, which a pipe would hold back


class Folders(NamedTuple):
    """Where everything is, and what makes the rest."""

    results: Path = RESULTS  # what is kept and ships
    runs: Path = Path("runs")  # whole run directories, with all weights: too large to ship
    execution: Execution = Execution()  # where a search evaluates its layouts
    client: Any = None  # of a cluster that simulates; None for this process


class Piece(Protocol):
    """A saved result."""

    kind: ClassVar[str]  # of pieces like it, in the plural: lists count these
    # Its name in lists, and its file below `Folders.results`; {0} is the piece.
    label: ClassVar[str] = ""
    file: ClassVar[str] = ""

    @property
    def name(self) -> str:
        """Return its name in lists."""
        return self.label.format(self)

    def path(self, folders: Folders) -> Path:
        """Return the path of its file, or of its folder."""
        return folders.results / self.file.format(self)

    @property
    def needs(self) -> tuple["Piece", ...]:
        """Return what it is made from; nothing unless overridden."""
        return ()

    def done(self, folders: Folders) -> float:
        """Return the share of it that is saved, 0 to 1."""

    def seconds(self, folders: Folders) -> float:
        """Estimate the CPU seconds of making all of it without its needs; 0 unless overridden."""
        return 0.0

    def cost(self, folders: Folders) -> float:
        """Estimate the CPU seconds of making the rest."""
        left = 1 - self.done(folders)
        return left * self.seconds(folders) if left else 0.0

    def make(self, folders: Folders) -> None:
        """Make the rest once what it needs is there, so that an interruption loses little."""


class Drawn(NamedTuple):
    """What an experiment shows."""

    figure: Figure | None  # the picture; None for a table alone
    lines: tuple[str, ...] = ()  # a table in markdown, ours beside the paper's


@dataclass(frozen=True)
class Experiment:
    """A figure or a table of the paper."""

    shows: str  # what, in one line
    pieces: tuple[Piece, ...]  # what it is drawn from
    draw: Callable[[Folders], Drawn]  # draws what is saved of the pieces; at least one is

    @property
    def everything(self) -> tuple[Piece, ...]:
        """List its pieces and what they are made from, each once, nothing before what it needs."""
        return tuple(_with_needs(self.pieces, lambda piece: True))

    def missing(self, folders: Folders) -> list[Piece]:
        """List what is not whole, but for what nothing missing is made from."""
        needed = _with_needs(self.pieces, lambda piece: piece.done(folders) < 1)
        return [piece for piece in needed if piece.done(folders) < 1]

    def ready(self, folders: Folders) -> list[Piece]:
        """List what is not whole and can be made now, the cheapest first."""
        missing = self.missing(folders)
        able = [piece for piece in missing if not set(piece.needs) & set(missing)]
        return sorted(able, key=lambda piece: piece.cost(folders))

    def drawable(self, folders: Folders) -> bool:
        """Return True if anything is saved to draw from."""
        return any(piece.done(folders) > 0 for piece in self.pieces)


def _with_needs(pieces: Sequence[Piece], needy: Callable[[Piece], bool]) -> dict[Piece, None]:
    """List pieces, each once, after what those that are `needy` need."""
    found: dict[Piece, None] = {}
    for piece in pieces:
        found |= _with_needs(piece.needs if needy(piece) else (), needy) | {piece: None}
    return found


def table(head: Sequence[str], rows: Sequence[tuple[object, ...]]) -> tuple[str, ...]:
    """Write a table in markdown."""
    lines = [f"| {' | '.join(head)} |", "| --- " * len(head) + "|"]
    return tuple(lines + [f"| {' | '.join(map(str, row))} |" for row in rows])
