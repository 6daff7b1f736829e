"""What a figure is drawn from: pieces of saved results that can be made and say what that costs."""

import csv
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar, NamedTuple, Protocol, TypeAlias, TypeVar, get_type_hints

from matplotlib.figure import Figure

from qdenv.run.executors import Execution

RESULTS = Path(__file__).parent / "results"
Say: TypeAlias = Callable[[str], None]
Row = TypeVar("Row", bound=tuple)


class Folders(NamedTuple):
    """Where everything is, and what makes the rest."""

    results: Path = RESULTS  # what is kept and ships
    runs: Path = Path("runs")  # whole run directories, with all weights: too large to ship
    execution: Execution = Execution()  # where a search evaluates its layouts
    client: Any = None  # of a cluster that simulates; None for this process


class Piece(Protocol):
    """A saved result."""

    kind: ClassVar[str]  # of pieces like it, in the plural: lists count these

    @property
    def name(self) -> str:
        """Return its name in lists."""

    @property
    def needs(self) -> tuple["Piece", ...]:
        """Return what it is made from; nothing unless overridden."""
        return ()

    def done(self, folders: Folders) -> float:
        """Return the share of it that is saved, 0 to 1."""

    def cost(self, folders: Folders) -> float:
        """Estimate the CPU seconds that making the rest takes, without what it needs."""

    def make(self, folders: Folders, say: Say) -> None:
        """Make the rest once what it needs is there, so that an interruption loses little.

        `say` is called with lines on the progress.
        """


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
        return _with_needs(self.pieces, lambda piece: True)

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


def _with_needs(pieces: Sequence[Piece], asks: Callable[[Piece], bool]) -> tuple[Piece, ...]:
    """List pieces, each once, after what those that ask for it need."""
    found: dict[Piece, None] = {}

    def add(piece: Piece) -> None:
        if piece not in found:
            for one in piece.needs if asks(piece) else ():
                add(one)
            found[piece] = None

    for piece in pieces:
        add(piece)
    return tuple(found)


def read_rows(path: Path, record: type[Row]) -> list[Row]:
    """Read the rows of a CSV file that has a column for each field of a NamedTuple."""
    kinds = get_type_hints(record)
    with path.open(newline="") as file:
        rows = list(csv.DictReader(file))
    return [record(**{name: kinds[name](text) for name, text in row.items()}) for row in rows]


def table(head: Sequence[str], rows: Sequence[tuple[object, ...]]) -> tuple[str, ...]:
    """Write a table in markdown."""
    lines = [f"| {' | '.join(head)} |", "| --- " * len(head) + "|"]
    return tuple(lines + [f"| {' | '.join(map(str, row))} |" for row in rows])
