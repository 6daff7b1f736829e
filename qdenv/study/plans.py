"""Layouts from files with their domains, tasks and costs of moves, and what a repair changed."""

import contextlib
import os.path
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from itertools import product
from pathlib import Path
from typing import Any, NamedTuple, get_type_hints

import numpy as np

from qdenv.domains.base import DOMAINS, Domain, find_domain, make_domain
from qdenv.grid import draw
from qdenv.guidance import GUIDANCE, existing_moves, fixed_costs
from qdenv.io.demand import demand_in, read_demand
from qdenv.io.facts import FACTS, PlanFacts, make_facts
from qdenv.io.guidance import costs_of
from qdenv.io.layouts import ENDINGS, Drawing, aliases, read_drawing, to_layout
from qdenv.io.records import structured
from qdenv.lazy import ndimage
from qdenv.simulation.mapf.goals import BY_SHELF, rows_of_odds, task_odds
from qdenv.study.options import Keep, keep_from
from qdenv.types import Floor, InputError, about, choices, to_array

USUAL = "hall"  # the domain where nothing says otherwise
_MAZE = "maze-walls"  # what floor and walls alone are; a hall holds more
_NAMED_ONLY = "map"  # the domain that nothing but its name chooses: any drawing could be one
_SHOWN = 3  # cells of a list that are named, the rest is counted


class Plan(NamedTuple):
    """A layout with its domain."""

    name: str  # in tables and messages
    layout: np.ndarray  # int8 [H, W]
    domain: Domain  # whose layout; not always at its size
    assumed: bool  # nothing but the tiles said whose layout it is
    # rows of a drawing of what must stay, as in `DomainConfig`; empty where nothing must
    keep: tuple[str, ...] = ()
    # float [5, H, W], the cost of each move at each cell (`guidance`); None where all are equal
    costs: np.ndarray | None = None
    guidance: str = "none"  # where `costs` come from: a name of `GUIDANCE`, or a file
    facts: PlanFacts = PlanFacts()  # what its file states beside the drawing
    closed: int = 0  # free cells that are obstacles here, see `close_parts`

    @property
    def floor(self) -> Floor:
        """The layout with its costs, as fleets drive on it; InputError if these are impossible."""
        if self.costs is None:
            return Floor(self.layout)
        free = self.domain.drivable(self.layout)
        costs = fixed_costs(self.costs, free)
        # Equal costs prefer no way to another; without them fleets are simulated faster.
        return Floor(self.layout, costs if np.ptp(costs[existing_moves(free)]) else None)

    @property
    def details(self) -> dict[str, Any]:
        """What its file states beside domain and tiles, as in a layout file: facts, what stays."""
        facts = {**self.facts.details.get("facts", {}), **self.domain.details.get("facts", {})}
        facts |= {"shelves": self.facts.shelves} if self.facts.shelves else {}
        return {name: one for name, one in (("facts", facts), ("keep", self.keep)) if one}

    @property
    def whose(self) -> str:
        """Whose layout it is, and how that is known, as commands print it."""
        cut_off = f", {self.closed} cells cut off from the largest part are closed"
        closed = cut_off if self.closed else ""
        if self.domain.name == USUAL:
            return f"a hall{closed}"
        if self.assumed:
            return f"read as {self.domain.name} (--domain chooses another){closed}"
        return f"domain {self.domain.name}{closed}"

    def fitted(self, numbers: Mapping[str, Any] | None = None, keep: Keep | None = None) -> Domain:
        """Make the domain that the plan is measured by: its size, its numbers, what must stay.

        The numbers of tiles are the plan's own unless given, 6 or "3:9"; `keep` says what must stay
        besides what always does and what the plan's file names (`keep_from`). Raises InputError if
        it is malformed, or no layout can have these cells.
        """
        if self.facts.shelves is not None:
            numbers = {"shelves": self.facts.shelves} | dict(numbers or {})
        domain = self.domain.fitted(self.layout, numbers)
        if self.keep:
            with about(f"{self.name}: what its file says must stay"):
                domain = make_domain(replace(domain.config, keep=self.keep))
        return domain if keep is None else keep_from(keep, domain, self.layout)


def read_plan(path: str | Path, domain: str | None = None, drawing: Drawing | None = None) -> Plan:
    """Read a layout in any format, unless its `drawing` is read already, and find its domain.

    Unless `domain` names it: what the file says, else a hall where its tiles fit and are more than
    floor and walls, else the first one whose tiles do. Raises InputError if the file holds no
    layout, or says that it is another domain's.
    """
    rows, stated, keep, weights, details, *_ = drawing or read_drawing(path)
    if not rows and weights is not None:
        raise InputError(f"{path}: costs of moves without a layout: give it as --guidance")
    if stated and domain and stated != domain and stated in DOMAINS.names():
        raise InputError(f"{path}: the file says {stated}: leave --domain out, or change the file")
    if stated and not domain and stated not in DOMAINS.names():
        cure = f"--domain chooses one of {', '.join(DOMAINS.names())}"
        raise InputError(f"{path}: the file says domain {stated!r}, which is unknown: {cure}")
    name = domain or stated
    found = find_domain(name) if name else _guess_domain(set("".join(rows)))
    layout = to_layout(rows, path, found.tiles, found.meanings, found.name)
    plan = Plan(Path(path).stem, layout, found, assumed=not name, keep=keep)
    if "facts" in details:
        plan = _with_facts(plan, make_facts(details["facts"], Path(path)), Path(path))
        found = plan.domain
    if weights is None or found.simulator.tasks is None:
        return plan
    with about(str(path)):
        costs = costs_of(weights, found.drivable(layout))
    return plan._replace(costs=costs, guidance=str(path))


def _with_facts(plan: Plan, facts: PlanFacts, path: Path) -> Plan:
    """Give a plan the facts from its file: settings of its domain, what must stay."""
    domain, settings, source = plan.domain, dict(facts.settings), f"facts of {path}"
    kinds = get_type_hints(type(domain.config))
    hidden = {"rows", "cols", "fleet", "around", "spare_shelves", *FACTS}
    known = sorted(vars(domain.config).keys() - hidden)
    for name in settings:
        if name not in known:
            raise InputError(f"{source}: unknown fact {name!r}: {choices(name, [*FACTS, *known])}")
        if name == "demand":
            settings[name] = demand_in(path.parent, settings[name])
        elif kinds[name] is str and type(settings[name]) in (int, float):
            settings[name] = f"{settings[name]}"  # drop = 5 as well as drop = "w=5,i=20"
        else:
            settings[name] = structured(settings[name], kinds[name], f"{source}, {name}")
    if facts.shelves is not None and "shelves" not in domain.counted:
        raise InputError(f"{source}: {domain.name} has no shelves: leave the fact out")
    tasks = {name: settings.pop(name) for name in domain.task_settings if name in settings}
    with about(source):
        plan = plan._replace(domain=make_domain(replace(domain.config, **settings)), facts=facts)
        plan = with_tasks(plan, tasks)
        if facts.keep:
            kept = keep_from(facts.keep, plan.fitted(), plan.layout, path.parent)
            plan = plan._replace(keep=kept.config.keep)
    return plan


def is_plain(layout: np.ndarray, domain: Domain) -> bool:
    """Return True if the tiles alone tell what a layout (int8 [H, W]) of a domain is.

    Reading the rows finds the same domain, and the same cells that must stay.
    """
    found = _guess_domain(set("".join(draw(layout, domain.tiles))))
    if found.name != domain.name or not domain.config.keep:
        return found.name == domain.name
    return found.fitted(layout).config.keep == domain.config.keep


def with_tasks(plan: Plan, settings: Mapping[str, Any]) -> Plan:
    """Give a plan other settings of its domain that say what robots do at their goals.

    "demand" among them is "shelves", a file or zones (`io.demand`), odds of places (float [H, W]),
    or rows of them as in the domain's settings. Raises InputError if the domain has no such
    setting, or a value is impossible.
    """
    if not settings:
        return plan
    domain, changes = plan.domain, dict(settings)
    for name in changes:
        if name not in domain.task_settings:
            known = ", ".join(domain.task_settings) or "none"
            raise InputError(f"{domain.name} has no setting {name!r} of tasks: it has {known}")
        if isinstance(getattr(domain.config, name), str):  # stations' numbers, or one for all
            changes[name] = str(changes[name])
    demand = changes.get("demand", ())
    if isinstance(demand, str) and demand == BY_SHELF[0]:
        changes["demand"] = demand = BY_SHELF
    if not isinstance(demand, tuple):
        plain = make_domain(replace(domain.config, demand=())).simulator.tasks
        assert plain is not None  # else there is no demand
        if isinstance(demand, str | Path):
            demand = read_demand(demand, np.asarray(plain.cycle[0].weight(plan.layout)) > 0)
        odds = to_array(demand, float)
        if odds.ndim != 2:
            raise InputError("demand: give rows of numbers, one for each cell")
        changes["demand"] = rows_of_odds(odds)
    if changes.get("demand", BY_SHELF) not in ((), BY_SHELF):  # a map of places fits one size
        changes |= dict(zip(("rows", "cols"), plan.layout.shape, strict=True))
    return plan._replace(domain=make_domain(replace(domain.config, **changes)))


def resolve_plan(
    preset: Any, settings: Mapping[str, Any], plan: Plan, keep: Keep | None = None
) -> tuple[Any, str]:
    """Make a search of other floors for a plan out of a preset (`RunConfig`), see `resolve`.

    Size, rules, numbers of tiles and what must stay are the plan's, but for the `settings` and
    `keep`. Raises InputError as `resolve` and `Plan.fitted` do.
    """
    from qdenv.run.config import choose_domain, resolve  # for searches alone

    given = {name.rpartition("__")[2]: value for name, value in settings.items()}
    for name in {"rows", "cols"} & given.keys():
        raise InputError(f"{plan.name} gives the size: leave --{name} out")
    numbers = {name: given[name] for name in plan.domain.counted if name in given}
    config = plan.fitted(numbers, keep).config
    own = {
        f"evaluation__domain__{name}": getattr(config, name)
        for name in vars(config).keys() - (given.keys() - numbers.keys()) - {"fleet"}
    }
    if plan.facts.robots and not {"agents", "fleet"} & given.keys():
        own["evaluation__domain__fleet__agents"] = plan.facts.robots
    others = {
        name: one for name, one in settings.items() if name.rpartition("__")[2] not in numbers
    }
    return resolve(choose_domain(preset, plan.domain.name), own | others)


def keep_costs(
    plan: Plan, layout: np.ndarray, adapt: Callable[[np.ndarray], np.ndarray] | None = None
) -> np.ndarray | None:
    """Transfer a plan's costs to the `layout` (int8 [H, W]) that it was changed into.

    A move that the change makes possible costs what the plan's moves do on average. `adapt` brings
    grids of the plan's shape to that of the layout, where these differ.
    """
    if plan.costs is None:
        return None
    old, new = (existing_moves(plan.domain.drivable(one)) for one in (plan.layout, layout))
    costs, mean = plan.costs, plan.costs[old & np.isfinite(plan.costs)].mean()
    if adapt is not None:
        costs, old = (np.stack([adapt(grid) for grid in grids]) for grids in (costs, old))
    return np.where(new & ~old, mean, costs)


def guide(plan: Plan, guidance: Any = None) -> Plan:
    """Give a plan costs of moves.

    `guidance` is a name of `GUIDANCE`, a file that holds them, the costs themselves (float
    [5, H, W]), or None for what the plan has. Raises InputError if it is none of these, or not for
    this layout.
    """
    if guidance is not None:
        free, name = plan.domain.drivable(plan.layout), str(guidance)
        if not isinstance(guidance, str | Path):
            plan = plan._replace(costs=to_array(guidance, float), guidance="an array")
        elif name in GUIDANCE:
            tasks = plan.domain.simulator.tasks
            assert tasks is not None  # else no cell would be drivable
            with about(plan.name):
                legs = task_odds(plan.layout, tasks)
            plan = plan._replace(costs=GUIDANCE[name](free, legs), guidance=name)
        elif Path(name).suffix.lower() in ENDINGS or os.path.exists(name):
            plan = plan._replace(costs=_read_costs(name, plan), guidance=name)
        else:
            raise InputError(f"unknown guidance {name!r}: {choices(name, GUIDANCE)}, or a file")
    with about(plan.guidance):
        _ = plan.floor  # refuses impossible costs
    return plan


def close_parts(plan: Plan) -> Plan:
    """Close all free cells but the largest connected part, where no repair could join them.

    Maps of benchmarks have such parts, and a fleet drives in one of them.
    """
    tasks = plan.domain.simulator.tasks
    if tasks is None or plan.domain.rules is not None:
        return plan
    free = plan.domain.drivable(plan.layout)
    labels, parts = ndimage.label(free)
    if parts < 2:
        return plan
    cut_off = free & (labels != 1 + np.argmax(np.bincount(labels.ravel())[1:]))
    obstacle = next(kind for kind, tile in enumerate(tasks.tiles) if tile not in tasks.traversable)
    layout = np.where(cut_off, obstacle, plan.layout).astype(np.int8)
    return plan._replace(layout=layout, closed=int(cut_off.sum()))


def name_guidance(plans: Sequence[Plan]) -> str:
    """Name where the costs of moves on some plans come from; "" where there are none."""
    guided = any(plan.costs is not None for plan in plans)
    return ", ".join(dict.fromkeys(plan.guidance for plan in plans)) if guided else ""


def _read_costs(path: str, plan: Plan) -> np.ndarray:
    """Read the costs of a plan's moves from a file, whose layout, if any, has the same cells."""
    rows, _, _, weights = read_drawing(path)[:4]
    if weights is None:
        raise InputError(f'{path}: no costs of moves, which JSON holds under "weights"')
    domain, free = plan.domain, plan.domain.drivable(plan.layout)
    if rows:
        theirs = domain.drivable(to_layout(rows, path, domain.tiles, domain.meanings, domain.name))
        if theirs.shape != free.shape:
            sizes = "{} x {}, {} is {} x {}".format(*theirs.shape, plan.name, *free.shape)
            raise InputError(f"{path}: costs of moves on {sizes}")
        if (theirs != free).any():
            row, column = np.argwhere(theirs != free)[0]
            where = f"row {row}, column {column} is free on one of them alone"
            raise InputError(f"{path}: costs of moves on another floor than {plan.name}: {where}")
    with about(path):
        return costs_of(weights, free)


def _guess_domain(symbols: set[str]) -> Domain:
    """Find the domain whose tiles have these symbols, or else other symbols for the same tiles.

    Plug-ins come last: installing one changes nothing in what a file of ours means.
    """
    if {*" #X"} & symbols and symbols <= {*". #X"}:
        return find_domain(_MAZE)
    shipped = [name for name in DOMAINS.shipped if name != _NAMED_ONLY]
    plugged = [name for name in DOMAINS.names() if name not in DOMAINS.shipped]
    for names, others in product((shipped, plugged), (False, True)):
        for name in names:
            with contextlib.suppress(InputError):  # of a broken plug-in
                domain = find_domain(name)
                known = aliases(domain.tiles, domain.meanings) if others else ()
                if symbols <= {*domain.tiles, *known}:
                    return domain
    return find_domain(USUAL)


def station_tiles(domain: Domain) -> str:
    """Return the tiles of stations: drivable and never drawn, or with a lower bound alone."""
    rules = domain.rules() if domain.rules else None
    at_least = [bound.tiles for bound in rules.counts if bound.high is None] if rules else []
    tasks = domain.simulator.tasks
    # Robots drive onto stations that no generator draws, unlike walls.
    drivable = tasks.traversable if tasks else domain.tiles
    return "".join(sorted((set(drivable) - set(domain.generated)) | set("".join(at_least))))


def list_changes(before: np.ndarray, after: np.ndarray, domain: Domain) -> list[dict[str, Any]]:
    """Compare two layouts (int8 [H, W]) of one domain in JSON-ready values.

    Return for each kind of tile that changed: tile (its symbol), name, station (people decide where
    it stands), before and after (number of cells), removed and placed ((row, column) of the cells
    that hold it no longer, or now).
    """
    stations, changes = station_tiles(domain), []
    for kind, tile in enumerate(domain.tiles):
        held, holds = before == kind, after == kind
        if (held != holds).any():
            change = {
                "tile": tile,
                "name": domain.names.get(tile, repr(tile)),
                "station": tile in stations,
                "before": int(held.sum()),
                "after": int(holds.sum()),
                "removed": [tuple(cell) for cell in np.argwhere(held & ~holds).tolist()],
                "placed": [tuple(cell) for cell in np.argwhere(holds & ~held).tolist()],
            }
            changes.append(change)
    return changes


def describe_changes(changes: Sequence[Mapping[str, Any]]) -> list[str]:
    """Describe what `list_changes` found, a line per kind of tile under a head."""
    if not changes:
        return ["nothing changed"]
    width = max(len("tile"), *(len(change["name"]) for change in changes))
    lines = [f"{'tile':{width}}  before  after  cells as (row, column) from 0"]
    for change in changes:
        removed, placed = (
            ", ".join(map(str, cells[:_SHOWN]))
            + (f" and {len(cells) - _SHOWN} more" if len(cells) > _SHOWN else "")
            for cells in (change["removed"], change["placed"])
        )
        gone, new = len(change["removed"]), len(change["placed"])
        parts = [f"{gone} removed: {removed}"] * bool(gone)
        parts += [f"{new} placed: {placed}"] * bool(new)
        if gone == new:
            parts = [f"{gone} moved: from {removed} to {placed}"]
        numbers = f"{change['before']:6}  {change['after']:5}"
        lines.append(f"{change['name']:{width}}  {numbers}  {'; '.join(parts)}")
    return lines


def warn_of_changes(changes: Sequence[Mapping[str, Any]]) -> list[str]:
    """Warn of stations that are gone, and of new ones, and say how to prevent it."""
    lines = []
    for change in (change for change in changes if change["station"]):
        removed, placed, name = change["removed"], change["placed"], change["name"]
        if removed:
            lines.append(
                f"WARNING: {len(removed)} of the plan's {change['before']} {name} cells changed, "
                f"the first at row {removed[0][0]}, column {removed[0][1]}: "
                f"--keep {change['tile']} keeps them, --keep FILE what a drawing marks with '!'"
            )
        if placed:
            lines.append(
                f"note: {len(placed)} new {name} cells, the first at "
                f"row {placed[0][0]}, column {placed[0][1]}: "
                "a drawing with '!' on these cells, as --keep FILE, prevents that"
            )
    return lines
