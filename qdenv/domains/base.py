"""A domain: what is generated, repaired, simulated and measured, every number bound."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache
from itertools import pairwise
from typing import Any, ClassVar, NamedTuple, Self

import numpy as np

from qdenv import devices, score
from qdenv.generators import Canvas, Rows
from qdenv.grid import draw, inside_frame, of_tiles, parse
from qdenv.lazy import jax, jnp
from qdenv.ranges import NonNegativeInt, Ranged, read_range
from qdenv.registry import Registry
from qdenv.simulation.mapf.goals import BY_SHELF
from qdenv.simulation.mapf.settings import FleetConfig
from qdenv.types import Array, InputError, Measure, Rules, TaskRule, Tile


def environment_entropy(kinds: int, margin: tuple[int, int] = (0, 0)) -> Measure:
    """Make the axis of the environment entropy (section 4) of what is drawn with `kinds` tiles."""

    def value(layout: jax.Array, runs: Any) -> jax.Array:
        area = inside_frame(layout, margin)
        # A tile that no generator draws occurs only in locked cells. It counts as the first tile,
        # because the patterns are numbered over the generated kinds alone.
        return score.entropy(jnp.where(area < kinds, area, 0), kinds)

    return Measure("environment entropy", 0, 1, 100, value)


_DOOR = 4  # most cells of a gap in an outer wall that counts as a door
# In a drawing of cells that must stay: anything may be here, and what the plan beside it holds.
FREE, SAME = "?", "!"


class KnownSize(NamedTuple):
    """The numbers of a domain at a size where they do not scale with the area."""

    steps: int  # steps of growth of an automaton that was trained at another size, C
    timesteps: int  # length of a simulation whose numbers are reported
    agents: int = 1  # how many robots drive, N_a; 1 where no fleet does
    numbers: Mapping[str, int] = {}  # exact numbers of tiles, by the settings' names
    about: str = "the paper's evaluation size"  # what kind of size it is, as commands put it


@dataclass(frozen=True)
class DomainConfig(Ranged):
    """What the settings of every domain hold; a domain's own derive from this."""

    rows: NonNegativeInt = 33  # rows of the whole layout, frame included
    cols: NonNegativeInt = 36  # columns of the whole layout, frame included
    # rows of a drawing of the whole layout, which commands read from a file: a tile where a cell
    # must hold it, ``?`` where anything may be; empty for none
    keep: Rows = field(default=(), kw_only=True)

    # rows of a plan that a search goes around: the archive's only axis is then how many of its
    # racks were moved; empty for the domain's own axes
    around: Rows = field(default=(), kw_only=True)

    # domains with a fleet declare a field of this name
    fleet: ClassVar[FleetConfig | None] = None

    @property
    def horizon(self) -> int | None:
        """Timesteps of one simulation; None if the settings do not limit it."""
        return getattr(self.fleet or self, "timesteps", None)

    def scaled(self, ratio: float, size: KnownSize | None, given: Collection[str]) -> Self:
        """Scale settings other than numbers of tiles: the agents of a fleet, or timesteps.

        `ratio` is the generated area of these settings over that of those they were made from.
        Known numbers of this size replace the scaled ones; settings that are `given` do not change.
        """
        if self.fleet is None or "agents" in given:
            return self
        # The timesteps of a known size are those of reported numbers: a search uses shorter runs.
        agents = size.agents if size else max(1, round(self.fleet.agents * ratio))
        return replace(self, fleet=replace(self.fleet, agents=agents))  # type: ignore


# An entry's maker is called as make(settings) and returns a `Domain`.
DOMAINS = Registry(
    "domain",
    "qdenv.domains",
    {
        "hall": "qdenv.domains.hall:HALL",
        "warehouse-even": "qdenv.domains.warehouse:EVEN",
        "warehouse-uneven": "qdenv.domains.warehouse:UNEVEN",
        "manufacturing": "qdenv.domains.manufacturing:MANUFACTURING",
        "maze-walls": "qdenv.domains.maze:WALLS",
        "maze-entropy": "qdenv.domains.maze:ENTROPY",
        "map": "qdenv.domains.map:MAP",
    },
)


class Simulator(NamedTuple):
    """How one layout is simulated; the pipeline batches it."""

    # layout int8 [H, W] -> tables shared by all runs of this layout; (layout, costs of moves int32
    # [5, H, W]) where generators draw these
    prepare: Callable[..., Any]
    # (tables, key) -> one run (a record of arrays); consumes the key
    run: Callable[[Any, Any], Any]
    tasks: TaskRule | None = None  # what a fleet does; None where no fleet drives
    # (tables, key) -> int32 [5, H, W], how often each move was made; None where no fleet drives
    count_moves: Callable[[Any, Any], Any] | None = None
    # runs computed side by side (vmap) on an accelerator; the rest wait in line (scan)
    accelerator_lanes: int = 128
    # on a CPU, whether all runs of one layout go side by side. Otherwise they go one after the
    # other, which is best where the work per run is data-dependent.
    layout_at_once: bool = False
    # whether runs are computed by host code, which no other device can share
    on_host: Callable[[], bool] = lambda: False

    @property
    def num_devices(self) -> int:
        """The number of devices that share one call."""
        return 1 if self.on_host() else devices.count()


@dataclass(frozen=True)
class Domain:
    """One domain at one size, every number bound."""

    config: Any  # the settings it was made from
    tiles: str  # alphabet of framed layouts
    generated: str  # symbols the generator draws, in channel order; the first tiles of `tiles`
    # rows of the fixed block in the middle of the generator's start canvas
    seed_block: tuple[str, ...]
    # makes the repair's `Rules`, or raises `InputError` where none fit this size; None where
    # nothing is repaired
    rules: Callable[[], Rules] | None
    simulator: Simulator  # what happens in a layout
    # (repaired layout, runs with leading axis S) -> float32, the objective f_res of the result
    # archive; the learning objective adds alpha times the similarity
    objective: Callable[[jax.Array, Any], jax.Array]
    measures: tuple[Measure, ...]  # axes of the archive
    margin: tuple[int, int] = (0, 0)  # (rows, columns) that the frame adds to each side
    # generated area int8 [H - 2 dr, W - 2 dc] -> framed layout int8 [H, W]
    frame: Callable[[Array], Array] = lambda area: area
    # unrepaired layout int8 [H, W] -> float32 [H, W], p_i / max p: how much each cell counts in the
    # similarity
    similarity_weights: Callable[[Array], jax.Array] = lambda layout: jnp.ones(
        layout.shape, jnp.float32
    )
    # draws the hand-made layout int8 [H, W] of this size, the baseline of appendix D.2, or raises
    # `InputError` where nothing fits; None where people design none
    human: Callable[[], np.ndarray] | None = None
    # settings that demand a number of one tile: name -> the tile's symbol. They scale with
    # the generated area, can be read off a layout, and are options of commands.
    counted: Mapping[str, str] = field(default_factory=dict)
    # names of settings that say what robots do at their goals: options of every command that
    # simulates a plan
    task_settings: tuple[str, ...] = ()
    # names of settings that add rules, which commands take beside the numbers of tiles
    rule_settings: tuple[str, ...] = ()
    objective_name: str = "objective"  # what the objective is, with its unit
    # among elites of equal objective the one with the larger number in this column of the archive
    # is the best; None for the first
    tie_break: str | None = None
    # layout int8 [H, W] -> cells that pictures name, like the start and the goal where the layout
    # itself decides them; None for none
    marks: Callable[[np.ndarray], Mapping[str, int]] | None = None
    # what the tiles mean to people, by their symbols
    meanings: Mapping[str, Tile] = field(default_factory=dict)
    # sizes (rows, columns) whose numbers do not follow from those of another size
    known: Mapping[tuple[int, int], KnownSize] = field(default_factory=dict)
    # symbols of tiles that stay wherever a user's layout has them, see `fitted`
    stays: str = ""
    # names what results depend on beside the settings, each with a checksum, like an agent that is
    # read from a file; a run goes on with the same only
    reads: Callable[[], Mapping[str, str]] = dict

    @property
    def names(self) -> dict[str, str]:
        """What legends and tables call the tiles, by their symbols."""
        return {symbol: tile.name for symbol, tile in self.meanings.items()}

    @property
    def name(self) -> str:
        """The name under which the type of the settings is registered."""
        return DOMAINS.name_of(self.config)

    @property
    def details(self) -> dict[str, Any]:
        """What a layout file states about its domain, from its name to what must stay."""
        facts = self._stated(self.rule_settings)
        if spare := getattr(self.config, "spare_shelves", 0):
            facts["shelves"] = f"{self.config.shelves}:{self.config.shelves + spare}"
        stated = {"keep": self.config.keep, "facts": facts | self.tasks}
        return {"domain": self.name} | {name: one for name, one in stated.items() if one}

    @property
    def tasks(self) -> dict[str, Any]:
        """The settings that say what robots do at their goals, without those at their defaults."""
        return self._stated(self.task_settings)

    def _stated(self, names: Sequence[str]) -> dict[str, Any]:
        """Return those of some settings that are not at their defaults."""
        ours, usual = vars(self.config), vars(type(self.config)())
        return {name: ours[name] for name in names if ours[name] != usual[name]}

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns of the framed layout."""
        return self.config.rows, self.config.cols

    @property
    def generated_shape(self) -> tuple[int, int]:
        """Rows and columns of the generated area."""
        return self.shape[0] - 2 * self.margin[0], self.shape[1] - 2 * self.margin[1]

    @property
    def canvas(self) -> Canvas:
        """The area inside the frame, on which a generator draws."""
        return Canvas(*self.generated_shape, self.generated, self.seed_block, self)

    @property
    def area(self) -> int:
        """The number of generated cells."""
        rows, cols = self.generated_shape
        return max(rows, 0) * max(cols, 0)

    def limit_of(self, measure: Measure) -> float | None:
        """Return what `measure` cannot exceed (no spare shelves counted); None if unlimited."""
        if measure.limit == "area":
            return max(self.area, 1)
        return getattr(self.config, measure.limit) if measure.limit else None

    def drivable(self, layout: np.ndarray) -> np.ndarray:
        """Find the cells of `layout` (int8 [..., H, W]) that robots may drive on (bool, the same).

        Raises InputError if no fleet drives in this domain.
        """
        tasks = self.simulator.tasks
        if tasks is None:
            raise InputError(f"no fleet drives in {self.name}: maps need --domain map")
        return np.asarray(of_tiles(layout, tasks.traversable, tasks.tiles))

    def mark_cells(self, layout: np.ndarray) -> dict[str, tuple[int, int]]:
        """Find the cells (row, column) that pictures of `layout` (int8 [H, W]) name."""
        marks = self.marks(layout) if self.marks else {}
        return {name: divmod(int(cell), layout.shape[1]) for name, cell in marks.items()}

    @property
    def numbers(self) -> dict[str, int]:
        """The numbers of tiles that the settings demand, by the settings' names."""
        return {name: getattr(self.config, name) for name in self.counted}

    def resized(self, rows: int, cols: int, numbers: Mapping[str, Any] | None = None) -> Domain:
        """Make the same domain at another size, `rows` x `cols` with the frame.

        What the settings say of single cells stays only if the size is the same. `numbers` are
        numbers of tiles, as 1100 or "1000:1200", and `rule_settings`. Numbers of tiles that it
        leaves out are the known ones of the size, or scale with the generated area. Raises
        InputError for numbers that are not of this domain or no numbers, or if this domain's own
        size has no generated area.
        """
        places = [one for one in ("keep", "around", "demand") if hasattr(self.config, one)]
        if getattr(self.config, "demand", ()) == BY_SHELF:  # which fits any size
            places.remove("demand")
        stays = {} if (rows, cols) == self.shape else dict.fromkeys(places, ())
        empty = make_domain(replace(self.config, rows=rows, cols=cols, **stays))
        if min(self.generated_shape) < 1:
            rows, cols = self.shape
            raise InputError(f"{rows} x {cols}: {self.name} has no room inside its frame")
        scaled = {name: round(one * empty.area / self.area) for name, one in self.numbers.items()}
        size = self.known_size(rows, cols)
        chosen = scaled | dict(size.numbers if size else {}) | dict(numbers or {})
        for name in sorted(chosen.keys() - self.rule_settings):
            if name not in self.counted:
                raise InputError(f"{self.name} has no number of {name}: leave --{name} out")
            low, high = read_range(name, number := chosen[name])
            chosen[name] = low
            spare = f"spare_{name}"
            if hasattr(self.config, spare):
                chosen |= {spare: high - low} if name in (numbers or {}) else {}
            elif high > low:
                raise InputError(f"{name} {number}: a range is for halls: give one number")
        return make_domain(replace(empty.config, **chosen))

    def demand_plan(self) -> None:
        """Raise InputError if a plan is missing that places the tiles that stay."""
        if self.stays and not self.config.keep:
            rows, cols = self.shape
            where = f"walls and stations of a {self.name} of {rows} x {cols}"
            raise InputError(f"{where} come from a plan: `train` and `generate` take --plan FILE")

    def known_size(self, rows: int, cols: int) -> KnownSize | None:
        """Return the known numbers of a size of `rows` and `cols`; None if they scale."""
        return None if (rows, cols) == self.shape else self.known.get((rows, cols))

    def fitted(self, layout: np.ndarray, numbers: Mapping[str, Any] | None = None) -> Domain:
        """Make the same domain at the size of `layout` (int8 [H, W]), with its numbers of tiles.

        `numbers`, as of `resized`, replace those that they name. Cells whose tiles have no other
        place (`stays`) stay as this layout has them, and doors do: gaps of up to four cells in a
        wall along the layout's edge. Neither is added if the settings keep cells of this size.
        """
        own = {
            name: int((layout == self.tiles.index(symbol)).sum())
            for name, symbol in self.counted.items()
        }
        rows, cols = layout.shape
        fitted = self.resized(rows, cols, own | dict(numbers or {}))
        fixed = of_tiles(layout, self.stays, self.tiles)
        if self.stays and self.simulator.tasks:
            fixed = fixed | _doors(np.asarray(fixed) & ~self.drivable(layout))
        if fitted.config.keep or not fixed.any():
            return fitted
        keep = tuple(draw(np.where(fixed, layout, len(self.tiles)), self.tiles + FREE))
        return make_domain(replace(fitted.config, keep=keep))


@lru_cache(maxsize=64)
def make_domain(config: Any) -> Domain:
    """Make the domain that `config` chooses, at the size it states.

    Equal settings give the same object, so that what was compiled for its functions is found
    again; settings must be hashable therefore. Raises InputError if the type of `config` is not
    registered, or the drawing of the cells to keep has another shape, or a cell names no tile.
    """
    domain: Domain = DOMAINS.make(config)
    if config.around:  # the only axis counts the racks of the plan that are elsewhere
        driven = domain.simulator.tasks.traversable if domain.simulator.tasks else ""
        racks = "".join(tile for tile in domain.generated if tile not in driven)
        was = np.asarray(of_tiles(parse(config.around, domain.tiles), racks, domain.tiles))
        most = int(was.sum()) + 1

        def moved(layout: jax.Array, runs: Any) -> jax.Array:
            return (of_tiles(layout, racks, domain.tiles) != was).sum() / 2

        domain = replace(domain, measures=(Measure("racks moved", 0, most, most, moved),))
    frame, make_rules, names = domain.frame, domain.rules, domain.names
    if config.keep:
        check_shape(config.keep, domain.shape)
        known = f"draw {FREE!r} or one of {' '.join(map(repr, domain.tiles))}"
        # The tile that each cell must hold, -1 for any.
        locked = parse(config.keep, FREE + domain.tiles, known) - 1
        domain = replace(domain, frame=lambda area: jnp.where(locked >= 0, locked, frame(area)))
    if make_rules is None:
        return domain

    def rules() -> Rules:
        base = make_rules()._replace(names=names)
        if not config.keep:
            return base
        only = np.eye(len(base.tiles), dtype=bool)[locked]
        return base._replace(allowed=np.where((locked >= 0)[..., None], only, base.allowed))

    return replace(domain, rules=rules)


def _doors(walls: np.ndarray) -> np.ndarray:
    """Find gaps of at most `_DOOR` cells between walls (bool [H, W]) along the four edges."""
    doors = np.zeros_like(walls)
    for row in (0, -1):
        for side, found in ((walls[row], doors[row]), (walls[:, row], doors[:, row])):
            for before, after in pairwise(np.flatnonzero(side)):
                found[before + 1 : after] = after - before <= _DOOR + 1
    return doors


def find_domain(name: str) -> Domain:
    """Make the domain called `name` with all its defaults, or raise InputError if there is none."""
    return make_domain(DOMAINS.config(name))


def check_shape(keep: Sequence[str], shape: tuple[int, int]) -> None:
    """Refuse a drawing of cells to keep that is not of the layouts' shape."""
    rows, cols = len(keep), max(map(len, keep), default=0)
    if (rows, cols) != shape or any(len(row) != cols for row in keep):
        size = "{} x {}".format(*shape)
        raise InputError(
            f"the drawing of cells to keep has {rows} x {cols} cells, the layout {size}: draw all"
        )
