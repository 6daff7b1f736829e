"""Records that cross stage borders, their axis letters and their status codes.

Axis letters, used in every docstring of the package:

    B  layouts (solutions) of a batch     P  parameters of one generator
    S  simulations of one layout          A  agents of one simulation
    H  rows, W  columns of a layout       T  timesteps
    K  kinds of tile                      M  measures
    C  cells of an archive

A layout is an int8 array [H, W] of tile indices into its domain's alphabet (`Rules.tiles`).
A position is ``row * width + column`` (int32). Records describe one item; batches add leading axes.
"""

from __future__ import annotations

import difflib
import importlib.util
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from enum import IntEnum
from typing import TYPE_CHECKING, Any, NamedTuple, TypeAlias

import numpy as np

# What crosses a stage's border: stages run on either side of the host. Code that only ever runs
# traced says `jax.Array`, code that only ever runs on the host `np.ndarray`.
if TYPE_CHECKING:
    import jax

    Array: TypeAlias = jax.Array | np.ndarray
    MeasureFunction: TypeAlias = Callable[[jax.Array, Any], jax.Array]
else:  # a name in annotations is no reason to import jax
    Array: TypeAlias = Any
    MeasureFunction: TypeAlias = Any
Number: TypeAlias = Any  # one, or with leading axes an array of them
Extras: TypeAlias = Mapping[str, Array]  # what an archive stores beside a `Score`: [B, ...] by name

_LONGEST_LINE = 2000  # characters of a message; a damaged file could fill gigabytes


class InputError(ValueError):
    """A mistake the user can mend: one line that says what is wrong and what to do.

    Whatever a file or a command line put into it, the line is printable and of a sensible length.
    """

    def __init__(self, message: str) -> None:
        """Shorten a long message, join its lines, escape what cannot be printed."""
        if len(message) > _LONGEST_LINE:  # the middle is left out
            half = _LONGEST_LINE // 2
            message = f"{message[:half]} ... {message[-half:]}"
        if not message.isprintable():
            message = " ".join(part.strip() for part in message.splitlines() if part.strip())
            message = "".join(one if one.isprintable() else ascii(one)[1:-1] for one in message)
        super().__init__(message)


class DamagedError(InputError):
    """A file's content is damaged, as after a crash of the machine; another may be intact."""


@contextmanager
def about(name: str) -> Iterator[None]:
    """Prefix the message of an `InputError` with what it is about."""
    try:
        yield
    except InputError as error:
        raise InputError(f"{name}: {error}") from error


def look_up(table: Mapping[str, Any], name: str, what: str) -> Any:
    """Look `name` up in a table, or raise InputError, which lists the choices."""
    if name not in list(table):  # it may be anything in Python
        raise InputError(f"unknown {what} {name!r}: {choices(name, table)}")
    return table[name]


def choices(name: str, known: Iterable[str]) -> str:
    """List the choices, the likeliest first if `name` looks like a typing error."""
    known = list(known)
    close = difflib.get_close_matches(str(name), known, 1)
    guess = f"did you mean {close[0]}? " if close else ""
    return f"{guess}choose one of {', '.join(known)}"


def require_package(what: str, package: str, extra: str = "viz") -> None:
    """Raise InputError if a package that `what` ("pages") need is missing: an `extra` has it."""
    if importlib.util.find_spec(package.replace("-", "_")) is None:
        raise InputError(f'{what} need {package}: pip install "qdenv[{extra}]"')


def to_array(values: Any, kind: type | None = None) -> np.ndarray:
    """Make an array; an empty one if rows differ in length, or something is not of a `kind`."""
    try:
        return np.asarray(values, kind)
    except (TypeError, ValueError):
        return np.empty(0)


class Tile(NamedTuple):
    """What one symbol of an alphabet means to people."""

    name: str  # a word or two, for legends and messages
    about: str = ""  # a sentence: what it is for, and where it may stand
    obstacle: bool = False  # nothing drives over it
    also: str = ""  # other symbols that drawings may use for it


class Floor(NamedTuple):
    """A layout, and what moves cost there."""

    layout: np.ndarray  # int8 [H, W]
    # int32 [5, H, W], of each move at each cell (`guidance.fixed_costs`), 0 where it is not
    # allowed; None where every move costs one step
    costs: np.ndarray | None = None

    @classmethod
    def of(cls, layout: np.ndarray | Floor) -> Floor:
        """Take a layout alone as a floor without costs."""
        return layout if isinstance(layout, Floor) else cls(layout)


class Count(NamedTuple):
    """Bound the number of cells that hold one of `tiles`: ``low <= count <= high``."""

    tiles: str  # symbols that count
    low: int  # the fewest cells
    high: int | None = None  # the most cells; None for no bound


class Adjacency(NamedTuple):
    """Demand that every cell holding one of `tiles` has a 4-neighbour holding one of `needs`."""

    tiles: str  # symbols that need a neighbour
    needs: str  # symbols, any of which will do


class Cover(NamedTuple):
    """Demand that every cell holding one of `tiles` lies in a whole rectangle of such cells.

    Squares that cover the driving area make aisles as wide as they are; rectangles that cover the
    shelves make racks; rows of one or two with floor at both ends have aisles on both sides. What
    fixed cells make unavoidable is allowed: a passage with no room to widen, a fixed shelf.
    """

    tiles: str
    shapes: tuple[tuple[int, int], ...]  # rows and columns of the rectangles, any of which will do
    ends: str = ""  # symbols that the first and the last cell hold instead, which are not covered

    def inner(self, shape: tuple[int, int]) -> np.ndarray:
        """Mark the cells of a rectangle that hold `tiles` (bool [rows, columns])."""
        marks = np.ones(shape, bool)
        marks.flat[[0, -1]] = not self.ends
        return marks


class Straight(NamedTuple):
    """Demand straight aisles: at least one of `most` + 1 successive rows holds none of `tiles`.

    The same for columns. Walls may interrupt such a row or column.
    """

    tiles: str
    most: int  # rows, or columns, between two straight aisles


class Rules(NamedTuple):
    """Hard constraints of one domain on one canvas, and what changing a cell costs."""

    tiles: str  # the alphabet; tile ``k`` is drawn as ``tiles[k]``
    counts: tuple[Count, ...]  # bounds on numbers of tiles
    adjacency: tuple[Adjacency, ...]  # neighbourhood demands
    connected: str  # symbols whose cells must form one 4-connected component ("" for none)
    # bool [H, W, K], the tiles each cell may hold. A fixed cell allows one tile, a keep-out cell
    # every tile but obstacles.
    allowed: np.ndarray
    # float [H, W], the cost of changing each cell; 1 for the Hamming distance
    change_cost: np.ndarray
    covers: tuple[Cover, ...] = ()  # widths of aisles, shapes of racks
    names: Mapping[str, str] = {}  # nouns that messages call tiles by; their symbols unless given
    straight: Straight | None = None  # cross aisles

    def name(self, tiles: str, many: bool = False) -> str:
        """Name the symbols `tiles` in a sentence: "floor or endpoint"; in the plural if `many`."""
        nouns = [self.names.get(tile, repr(tile)) for tile in tiles]
        if many:
            known = {"floor": "floor", "shelf": "shelves"}
            # A symbol, and a number at the end, have no plural.
            nouns = [known.get(one, f"{one}s" if one[-1].isalpha() else one) for one in nouns]
        return " or ".join(filter(None, [", ".join(nouns[:-1]), *nouns[-1:]]))

    def buildable(
        self,
        aisle: int = 1,
        rack: tuple[int, int] | None = None,
        of: str = "@",
        cross_aisle: int = 0,
        both_sides: bool = False,
    ) -> Rules:
        """Add that aisles are `aisle` cells wide and tiles `of` stand in racks of rows x columns.

        A rack stands along either axis; where racks meet, they form longer ones. `cross_aisle` is
        the most rows, and columns, between two straight aisles (`Straight`), any number where 0.
        With `both_sides` each lies in a row, or column, of one or two of them with the driving area
        at both ends.
        """
        more = (Cover(self.connected, ((aisle, aisle),)),) * int(aisle > 1)
        if rack is not None:
            more += (Cover(of, tuple(sorted({rack, rack[::-1]}))),)
        if both_sides:
            more += (Cover(of, ((1, 3), (1, 4), (3, 1), (4, 1)), self.connected),)
        straight = Straight(of, cross_aisle) if cross_aisle else None
        return self._replace(covers=self.covers + more, straight=straight)


class RepairStatus(IntEnum):
    """How a repair ended; everything below `IMPOSSIBLE` is feasible."""

    OPTIMAL = 0  # proven, or within the given gap
    NODE_LIMIT = 1  # best layout at the deterministic limit
    TIME_LIMIT = 2  # best layout when the wall-clock safety net fired
    ANNEALED = 3  # feasible, neither proven nor branched on
    IMPOSSIBLE = 4  # the rules contradict each other; the layout is returned as it came
    FAILED = 5  # no feasible layout was found; the layout is returned as it came


class Repair(NamedTuple):
    """A layout made to obey its rules."""

    layout: Array  # int8 [H, W]
    status: Number  # int32, a RepairStatus
    cost: Number  # float32, summed change costs of the changed cells
    lower_bound: Number  # float32, proven bound on `cost`
    seconds: Number  # float32, CPU seconds spent (0 when remembered)


class Goal(NamedTuple):
    """One kind of goal in a task cycle."""

    # function layout int8 [H, W] -> float32 [H, W], the odds of each cell being drawn; 0 where a
    # cell is no goal of this kind
    weight: Callable[[Array], Array]
    # timesteps an agent stays on the goal after arriving, blocking the cell: one number, or a
    # function layout int8 [H, W] -> int [H, W] where they differ from cell to cell
    stay: int | Callable[[Array], Array] = 0
    name: str = "goal"  # what messages call it

    def stays(self, layout: Array) -> Array:
        """Return the timesteps an agent stays on each cell of `layout` (int8 -> int [H, W])."""
        return self.stay(layout) if callable(self.stay) else np.full(layout.shape, self.stay)


class TaskRule(NamedTuple):
    """What agents do: drive on `traversable` tiles and visit goals of `cycle`, again and again."""

    tiles: str  # the alphabet of the layouts
    traversable: str  # symbols agents may drive on
    cycle: tuple[Goal, ...]  # kinds of goal in the order in which every agent visits them
    # tasks that arrive per timestep, in orders of one of each kind; 0 where work never runs out
    rate: float = 0.0


class Traffic(NamedTuple):
    """One lifelong multi-agent simulation."""

    throughput: Array  # float32, finished tasks / T, over the full T
    congested: Array  # bool, more than half of the agents stuck over some window
    end_timestep: Array  # int32, steps simulated (less than T only after congestion)
    finished: Array  # int32 [T], tasks finished at each timestep
    usage: Array  # float32 [H, W], share of agent-steps spent on each cell, sums to 1
    waiting: Array  # float32, share of agent-steps without a move
    path_length: Array  # float32, mean number of moves per finished task
    congested_at: Array | int = 0  # int32, the end of the first such window; 0 for none
    # Both where tasks arrive at a rate.
    idle: Array | None = None  # float32, share of agent-steps without an order
    order_wait: Array | None = None  # float32, mean timesteps that an order waited for an agent


class Measure(NamedTuple):
    """One axis of the archive: `cells` equal intervals between `low` and `high`."""

    name: str  # what plots and tables call it
    low: float  # value at the archive's lower edge
    high: float  # value at its upper edge
    cells: int  # number of cells in between
    # (repaired layout int8 [H, W], runs with leading axis S) -> float32; None where the measures
    # come from elsewhere
    value: MeasureFunction | None = None
    # name of the number that it cannot exceed, with which its axis grows: one of the domain's
    # settings, or "area", the cells of the generated area; "" for none
    limit: str = ""


class Score(NamedTuple):
    """What the search sees of one layout; finite whatever the stages returned."""

    objective: Array  # float32, objective of the learning archive (f_opt)
    result_objective: Array  # float32, objective of the result archive (f_res)
    measures: Array  # float32 [M]
    success: Array  # bool, False when a stage failed: enters no archive


class Encoding(NamedTuple):
    """How solutions encode layouts, and what an evaluation observes of these."""

    shape: tuple[int, int]  # rows H and columns W
    kinds: int  # kinds of tile K
    repairs: bool = False  # layouts are repaired before they are simulated: "repaired" is observed
    usage: bool = False  # "usage", the share of agent-steps on each cell, is observed
    # float [B, P] -> int8 [B, H, W], traceable
    draw: Callable[[jax.Array], jax.Array] = lambda layouts: layouts
    choices: int = 0  # how many tiles each parameter may name; 0 where parameters are real numbers
    margin: tuple[int, int] = (0, 0)  # (rows, columns) that the frame adds to each side
    around: Array | None = None  # int8 [H, W], a plan around which is searched; None for none


class Evaluation(NamedTuple):
    """Everything one evaluation produced."""

    score: Score  # what the search sees of it
    unrepaired: Array  # int8 [H, W]
    repaired: Array  # int8 [H, W]
    similarity: Array  # float32 in [0, 1]
    status: Array  # int32, a RepairStatus
    runs: Any  # Traffic (or the maze's episodes) with a leading axis S
