"""Operations on one layout: draw, check and repair it; layouts drawn by hand or tiled."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple

import numpy as np
from tyro.conf import arg

from qdenv.domains.base import DOMAINS, Domain, find_domain
from qdenv.io.files import tidy
from qdenv.io.layouts import aliases, check_size, endings_for
from qdenv.ops import options as args
from qdenv.ops.output import (
    PICTURES,
    Layout,
    Result,
    Table,
    UnsolvedError,
    format_table,
    place,
    save_with_picture,
    say,
)
from qdenv.progress import Bar
from qdenv.repairs.audit import audit, check_allowed, check_built
from qdenv.repairs.rules import impossible
from qdenv.repairs.settings import Polish, RepairConfig
from qdenv.study.diagnosis import diagnose
from qdenv.study.options import describe_growth
from qdenv.study.plans import describe_changes, keep_costs, list_changes, warn_of_changes
from qdenv.types import InputError, RepairStatus, Rules

if TYPE_CHECKING:
    from qdenv.simulation.mapf.environment import Environment, Observe


def render(layout: args.Source, out: args.Out = None, domain: args.DomainName = None) -> Layout:
    """Draw a layout as a picture: PNG, SVG or PDF.

    Args:
        layout: layout file.
        out: picture to write; by default named after the layout file.
        domain: domain of the layout; by default what the file states, or its tiles suggest.

    Returns:
        the layout, which a notebook shows; no picture is written unless `out` is given.

    Raises:
        InputError: it is not a layout, or the place cannot be written to.

    Examples:
        ``qdenv render plan.txt --out plan.svg``
    """
    plan = args.read_plan(layout, domain)
    drawn = Layout(plan.layout, plan.domain, plan.details, costs=plan.costs)
    if target := place(out, f"{plan.name}.png", PICTURES, [layout]):
        drawn.draw(target.path)
        rows, cols = plan.layout.shape
        say(f"{target}: {rows} x {cols}, {plan.whose}")
    return drawn


class Broken(NamedTuple):
    """A broken rule."""

    message: str  # which rule
    row: int  # of the first cell that breaks it
    column: int  # of that cell


def check(
    layout: args.Source,
    domain: args.DomainName = None,
    keep: args.KeepCells = None,
    plot: args.Picture = None,
    **numbers: args.Number,
) -> Table:
    """Check a layout against the rules of its domain (exit code 0 or 1), and remark on risks.

    Remarks are about what breaks no rule: dead-end aisles, cells whose loss cuts the hall in two,
    two-way aisles one robot wide, stations with a single access.

    Args:
        layout: layout file.
        domain: domain whose rules hold; by default what the file states, or its tiles suggest.
        keep: cells that must be as they are: tiles (w), a rectangle of rows and columns, the last
            ones not included (0:7,33:40), or a drawing with ! or a tile there and ? elsewhere; +
            joins several.
        plot: picture to write, of the cells in question.
        **numbers: exact numbers of tiles to demand; by default those that the file states, if any.

    Returns:
        a `Broken` for each broken rule, which names a cell; empty where the layout obeys them all.
        Its facts list the rules on aisles and racks that hold, in words, and the remarks, each with
        its kind, message and cells.

    Raises:
        InputError: it is not a layout, or `keep` names nothing in it.

    Examples:
        ``qdenv check plan.txt --keep w --plot``
    """
    plan, name = args.read_plan(layout, domain), args.name_of(layout)
    fitted = plan.fitted(numbers, keep)
    picture = place(plot, f"{plan.name}_check.png", PICTURES, [layout, keep])
    rules: Any = fitted.rules() if fitted.rules else None
    found = audit(plan.layout, rules) if rules else []
    remarks = diagnose(plan)
    broken = [Broken(one.message, *one.cells[0].tolist()) for one in found]
    say(*(one.message for one in broken))
    if rules is None:
        say(f"{name}: layouts of {fitted.name} have no rules, none is broken")
    elif broken:
        if check_allowed(plan.layout, rules):
            say("(to allow a tile as it stands, mark it with '!' in a drawing, --keep FILE)")
        drawn = {fitted.tiles[kind] for kind in np.unique(plan.layout)}
        if "@" in drawn and "e" in set(fitted.tiles) - drawn:
            say("(no endpoint is drawn: `qdenv repair --keep @` puts them beside the shelves)")
        count = "1 rule" if len(broken) == 1 else f"{len(broken)} rules"
        say(f"{name}, {plan.whose}: {count} broken")
    else:
        say(f"{name}, {plan.whose}: obeys every rule")
    built = check_built(plan.layout, rules) if rules else ()
    holds = [rule for rule, wrong in built if not wrong]
    say(*(f"holds: {one}" for one in holds))
    say(*(f"remark: {one.message}" for one in remarks))
    if picture:
        from qdenv.view.change import draw_diagnosis  # imports matplotlib

        picture.draw(draw_diagnosis(plan, found, remarks), crop=True)
    facts = {
        "valid": not broken,
        "rules": rules is not None,
        "broken": [one._asdict() for one in broken],
        "holds": holds,
        "remarks": [one._asdict() for one in remarks],
        "settings": {"layout": name, "domain": fitted.name, "keep": keep, "numbers": numbers},
    }
    return Table(broken, facts, exit_code=1 if broken else 0)


def repair(
    layout: args.Source,
    domain: args.DomainName = None,
    keep: args.KeepCells = None,
    seed: args.RepairSeed = 0,
    polish: Polish = "full",
    out: args.Out = None,
    plot: Annotated[args.Picture, arg(aliases=("--diff",))] = None,
    **numbers: args.Number,
) -> Layout:
    """Make a layout obey every rule of its domain, with few changes.

    Args:
        layout: layout file.
        domain: domain whose rules hold; by default what the file states, or its tiles suggest.
        keep: what must stay: tiles (w), a rectangle of rows and columns, the last ones not included
            (0:7,33:40), or a drawing where ? may change and ! or a tile stays; + joins several.
        seed: other seeds may give other layouts of about equal cost.
        polish: how hard to try after the first feasible layout.
        out: layout file to write (.json, .txt, .csv, .xlsx, .dxf); by default LAYOUT_repaired.json.
        plot: picture to write, of what changed.
        **numbers: exact numbers of tiles; by default those that the file states, else the layout's.

    Returns:
        the repaired layout, with status, cost and lower bound among its facts.

    Raises:
        InputError: the domain has no rules, they contradict each other, or no feasible layout was
            found.

    Examples:
        ``qdenv repair plan.txt --keep w --plot``
    """
    plan, name = args.read_plan(layout, domain), args.name_of(layout)
    fitted = plan.fitted(numbers, keep)
    if fitted.rules is None:
        raise InputError(f"{name}: layouts of {fitted.name} have no rules: nothing to repair")
    rules: Rules = fitted.rules()
    if reason := impossible(rules):
        raise InputError(f"{name}: no repair exists: {reason}")
    # Everything is refused before the compiler and the solver are imported, which takes seconds.
    inputs, default = [layout, keep], f"{plan.name}_repaired.json"
    endings = endings_for(fitted.tiles, fitted.meanings, plan.costs is not None)
    target = place(out, default, endings, inputs)
    beside = target.path if target else Path(default)
    picture = place(plot, str(beside.with_suffix(PICTURES[0])), PICTURES, inputs)
    say("{}: {} x {}, {}".format(name, *plan.layout.shape, plan.whose))
    # These import jax, a compiler and a solver: refusals are faster without them.
    from qdenv.repairs.milp.feasibility import explain
    from qdenv.repairs.recipe import repair_layout
    from qdenv.score import similarity

    with Bar("repairing") as bar:
        result = repair_layout(plan.layout, rules, seed, RepairConfig(polish=polish), bar)
        if result.status == RepairStatus.IMPOSSIBLE:
            raise InputError(f"{name}: no repair exists: {explain(rules, bar)}")
    repaired = np.asarray(result.layout)
    changes = list_changes(plan.layout, repaired, fitted)
    weights = plan.domain.similarity_weights(plan.layout)
    # The gap of a layout that obeys every rule already, and costs nothing, is 0, not 0 / 0.
    facts = {
        "status": RepairStatus(int(result.status)).name.lower(),
        "hamming": float(result.cost),
        "lower_bound": float(result.lower_bound),
        "gap": float((result.cost - result.lower_bound) / max(result.cost, 1.0)),
        "similarity": float(similarity(plan.layout, result.layout, weights)),
        "cpu_seconds": round(float(result.seconds), 3),
        "broken_before": len(audit(plan.layout, rules)),
        # By the audit, not by the solver that made it.
        "valid": not audit(repaired, rules),
    }
    say(*(f"{key:13} {value}" for key, value in tidy(facts).items()))
    settings = {"layout": name, "domain": fitted.name, "keep": keep, "numbers": numbers}
    facts |= {"changes": changes, "settings": settings | {"seed": seed, "polish": polish}}
    if not facts["valid"]:
        less = ", or keep fewer cells" if fitted.config.keep else ""
        raise UnsolvedError(f"{name}: no feasible layout was found: try another seed{less}", facts)
    say(*describe_changes(changes), *warn_of_changes(changes))
    costs = keep_costs(plan, repaired)
    details = plan.facts.details | {"repaired_from": Path(name).name}
    made = Layout(repaired, fitted, details, facts, costs)
    if target:
        made.save(target.path)
        say(target)
    if picture:
        from qdenv.view.change import draw_change  # imports matplotlib

        picture.draw(draw_change(plan, plan._replace(layout=repaired, costs=costs)), crop=True)
    return made


def layout_human(
    rows: int,
    cols: int,
    domain: Annotated[str, arg(metavar=args.DOMAIN_NAMES)] = "warehouse-even",
    out: args.Out = None,
) -> Layout:
    """Draw a layout like those designed by hand, at any size.

    Args:
        rows: rows of the layout, frame included.
        cols: columns of the layout, frame included.
        domain: domain of the layout.
        out: layout file to write (.json, .txt, .csv, .xlsx, .dxf), with a picture beside it; by
            default layout.json.

    Raises:
        InputError: the size is impossible, or the domain has no such design.

    Examples:
        ``qdenv layout human --rows 33 --cols 36 --out hand.txt``
    """
    check_size(rows, cols)
    found = find_domain(domain).resized(rows, cols)
    target = place(out, "layout.json", endings_for(found.tiles, found.meanings))
    if found.human is None:
        raise InputError(f"{found.name} has no hand-made design: choose another domain")
    drawn = found.human()
    details = {"domain": found.name, "design": "human"}
    made = Layout(drawn, found, details, {"rows": rows, "cols": cols, **details})
    names = [found.names.get(tile, repr(tile)) for tile in found.tiles]
    counts = "".join(f", {(drawn == kind).sum()} {name}" for kind, name in enumerate(names))
    save_with_picture(made, target, f"{rows} x {cols}{counts}")
    # People's designs have other numbers of tiles than the paper's generated layouts.
    for name, number in found.numbers.items():
        has = found.fitted(drawn).numbers[name]
        if found.known.get((rows, cols)) and has != number:
            say(f"generated layouts of this size have {number} {name} unless stated, this {has}")
    return made


def layout_tile(
    layout: args.Source,
    rows: int,
    cols: int,
    domain: args.DomainName = None,
    seed: args.RepairSeed = 0,
    polish: Polish = "full",
    out: args.Out = None,
    **numbers: args.Number,
) -> Layout:
    """Repeat a small layout until it fills a larger one, and repair the result (section E.4).

    Args:
        layout: layout file to repeat.
        rows: rows of the larger layout, frame included.
        cols: columns of the larger layout, frame included.
        domain: domain of the layouts; by default what the file states, or its tiles suggest.
        seed: other seeds give other repairs of about equal cost.
        polish: how hard to repair.
        out: layout file to write (.json, .txt, .csv, .xlsx, .dxf), with a picture beside it; by
            default LAYOUT_tiled.json.
        **numbers: exact numbers of tiles; by default those known for the size, or else scaled
            with the area.

    Returns:
        the layout, with how it was repaired among its facts.

    Raises:
        InputError: the size is smaller than the layout, or no such layout exists.

    Examples:
        ``qdenv layout tile plan.txt --rows 57 --cols 58``
    """
    check_size(rows, cols)
    from qdenv.study import elites as sizes  # imports jax

    plan = args.read_plan(layout, domain)
    if rows < plan.layout.shape[0] or cols < plan.layout.shape[1]:
        size = "{} x {}".format(*plan.layout.shape)
        raise InputError(f"{rows} x {cols} is smaller than the layout it repeats, {size}")
    found, config = plan.domain, RepairConfig(polish=polish)
    endings = endings_for(found.tiles, found.meanings, plan.costs is not None)
    target = place(out, f"{plan.name}_tiled.json", endings, [layout])
    tiled = sizes.tile(plan, (rows, cols), numbers, config, seed)
    say(*filter(None, [describe_growth(found, (rows, cols), ["steps", *numbers])]))
    details = sizes.details(tiled) | {"domain": found.name}
    details["tiled_from"] = Path(args.name_of(layout)).name
    return save_with_picture(Layout(tiled.layout, found, details, details, tiled.costs), target)


def layout_symbols(domain: args.DomainName = None) -> Result:
    """List the symbols of layout files: what each means in each domain.

    Args:
        domain: the only domain to list.

    Returns:
        ``symbols``, a record for each tile of a domain.

    Examples:
        ``qdenv layout symbols --domain hall``
    """
    head = ("symbol", "tile", "robots", "also", "meaning")
    records, domains_of = list[dict[str, str]](), dict[tuple[tuple[str, ...], ...], list[str]]()
    for name in (domain,) if domain else DOMAINS.names():
        rows = tuple(_describe_tiles(find_domain(name)))
        records += [{"domain": name} | dict(zip(head, row, strict=True)) for row in rows]
        domains_of.setdefault(rows, []).append(name)
    for rows, names in domains_of.items():  # domains with the same symbols share a table
        quoted = [(repr(row[0]), *row[1:3], " ".join(map(repr, row[3])), row[4]) for row in rows]
        say(", ".join(names), *(f"  {line}" for line in format_table([head, *quoted])), "")
    return Result({"symbols": records, "settings": {"domain": domain}})


def _describe_tiles(domain: Domain) -> Iterator[tuple[str, ...]]:
    """List each tile's symbol, name, whether robots drive there, other symbols, and meaning."""
    others = aliases(domain.tiles, domain.meanings)
    for symbol in domain.tiles:
        also = "".join(one for one, meant in others.items() if meant == symbol)
        name, drives, about = "", "", ""
        if tile := domain.meanings.get(symbol):
            drives = "drive around it" if tile.obstacle else "drive over it"
            name, about = tile.name, tile.about
        yield symbol, name, drives, also, about


def make_environment(
    layout: args.Source | Sequence[args.Source],
    agents: int = 50,
    timesteps: int = 1000,
    domain: str | None = None,
    observe: Observe | None = None,
    auto_reset: bool = False,
) -> Environment:
    """Make a stepwise environment for learners: one action for every robot.

    Args:
        layout: see `read_plan`; or several of one size and domain, in a list or int [B, H, W].
        agents: number of robots.
        timesteps: number of steps until `Timestep.last`.
        domain: whose tasks they do.
        observe: traceable function of the state; by default positions, goals and services.
        auto_reset: the step that ends a run begins the next one on the same layout.

    Returns:
        the environment, see `reset` and `step`.

    Raises:
        InputError: no fleet can work on a layout, tasks arrive at a rate, or sizes differ.
    """
    from qdenv.simulation.mapf.environment import Environment, observe_plainly  # imports jax

    one: Any = layout  # a list of lists is a layout, too
    several = type(one) in (list, tuple) and len(one) > 0 and not isinstance(one[0], list)
    several |= isinstance(one, np.ndarray) and one.ndim == 3
    fleet = args.Fleet({"domain": domain})
    plans = [fleet.read_plan(each) for each in (one if several else [one])]
    if len({(plan.layout.shape, plan.domain.name) for plan in plans}) > 1:
        raise InputError("layouts of one environment have one size and one domain")
    first = plans[0].domain
    tasks = first.simulator.tasks
    if tasks is None:
        raise InputError(f"no fleet drives in {first.name}")
    layouts = np.stack([plan.layout for plan in plans]) if several else plans[0].layout
    return Environment(layouts, tasks, agents, timesteps, observe or observe_plainly, auto_reset)
