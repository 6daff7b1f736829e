"""Operations on one layout: draw, check and repair it; layouts drawn by hand or tiled."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import numpy as np
import tyro

from qdenv.domains.base import DOMAINS, Domain, find_domain
from qdenv.io.files import tidy
from qdenv.io.layouts import aliases, check_size, endings_for
from qdenv.ops.options import (
    DomainName,
    Number,
    Out,
    Picture,
    RepairSeed,
    Source,
    domain_names,
    read_plan,
    stem_of,
)
from qdenv.ops.output import PICTURES, Place, format_table, place, say
from qdenv.ops.results import Broken, Layout, UnsolvedError
from qdenv.progress import Bar
from qdenv.repair.audit import audit, check_allowed
from qdenv.repair.rules import impossible
from qdenv.repair.settings import RepairConfig
from qdenv.study.options import describe_growth
from qdenv.study.plans import USUAL, describe_changes, list_changes, warn_of_changes
from qdenv.types import InputError, RepairStatus, Rules

if TYPE_CHECKING:
    from qdenv.simulate.mapf.environment import Environment, Observe

Polish = Literal["none", "quick", "full"]


def render(layout: Source, out: Out = None, domain: DomainName = None) -> Layout:
    """Draw a layout as a picture: PNG, SVG or PDF.

    Args:
        layout: layout file.
        out: picture to write; named after the layout file unless given.
        domain: whose layout; what the file says, or its tiles tell, unless given.

    Returns:
        the layout, which a notebook shows; no picture is written unless `out` is given.

    Raises:
        InputError: it is no layout, or the place cannot be written to.
    """
    plan = read_plan(layout, domain)
    drawn = Layout(plan.layout, plan.domain)
    if out is not None:
        target = place(out, f"{stem_of(layout)}.png", PICTURES, [layout])
        drawn.draw(target.path)
        rows, cols = plan.layout.shape
        say(f"{target}: {rows} x {cols}, {plan.whose}")
    return drawn


class Check(list):
    """The broken rules of a layout, each a `Broken`; empty where it obeys them all."""

    def __init__(self, broken: list[Broken], facts: Mapping[str, Any]) -> None:
        """List broken rules, with the facts that ``--json`` writes."""
        super().__init__(broken)
        self.facts = facts
        self.exit_code = 1 if broken else 0


def check(
    layout: Source, domain: DomainName = None, keep: Path | None = None, **numbers: Number
) -> Check:
    """Check a layout against its domain's rules: exit code 0, or 1 and what is broken.

    Args:
        layout: layout file.
        domain: whose rules; what the file says, or its tiles tell, unless given.
        keep: drawing of cells that are meant to be as they are: ! or a tile, ? elsewhere.
        **numbers: exact numbers of tiles to demand; not checked unless given.

    Returns:
        a `Broken` for each broken rule, which names a cell.

    Raises:
        InputError: it is no layout, or `keep` is no drawing of its shape.
    """
    plan = read_plan(layout, domain)
    kind = plan.fitted(numbers, keep)
    rules: Any = kind.rules() if kind.rules else None
    found = audit(plan.layout, rules) if rules else []
    broken = [Broken(one.message, *map(int, one.cell)) for one in found]
    for one in broken:
        say(f"{one.message} (row {one.row}, column {one.column})")
    name = layout if isinstance(layout, str | Path) else plan.name
    if rules is None:
        say(f"{name}: layouts of {kind.name} have no rules, none is broken")
    elif broken:
        if check_allowed(plan.layout, rules):
            say("(--keep FILE allows what a drawing marks with '!' to stand where it stands)")
        count = "1 rule" if len(broken) == 1 else f"{len(broken)} rules"
        say(f"{name}: {count} broken, {plan.whose}")
    else:
        say(f"{name}: obeys every rule, {plan.whose}")
    listed = [one._asdict() for one in broken]
    settings = {"layout": name, "domain": kind.name, "keep": keep, "numbers": numbers}
    facts = {"valid": not broken, "rules": rules is not None, "broken": listed}
    return Check(broken, facts | {"settings": settings})


def repair_layout(
    layout: Source,
    domain: DomainName = None,
    keep: Path | None = None,
    seed: RepairSeed = 0,
    polish: Polish = "full",
    out: Out = None,
    plot: Annotated[Picture, tyro.conf.arg(aliases=("--diff",))] = None,
    **numbers: Number,
) -> Layout:
    """Repair a layout: the closest one that obeys every rule of its domain.

    Args:
        layout: layout file.
        domain: whose rules; what the file says, or its tiles tell, unless given.
        keep: drawing of the layout's shape: ? may change, ! stays, a tile must be this tile.
        seed: other seeds may give other, equally good layouts.
        polish: how hard to try after the first feasible layout.
        out: layout file to write (.json, .txt, .csv); LAYOUT_repaired.json unless given.
        plot: picture of what changed to write.
        **numbers: exact numbers of tiles; as many as the layout has unless given.

    Returns:
        the repaired layout, with status, cost and lower bound among its facts.

    Raises:
        InputError: the domain has no rules, they contradict each other, or no feasible layout was
            found.
    """
    plan = read_plan(layout, domain)
    kind, name = plan.fitted(numbers, keep), plan.name
    if isinstance(layout, str | Path):
        name = str(layout)
    rules = _possible_rules(kind, name)
    inputs, endings = [layout, keep], endings_for(kind.tiles, kind.meanings)
    default = f"{stem_of(layout)}_repaired.json"
    target = None if out is None else place(out, default, endings, inputs)
    beside = target or Place(Path(default), False)
    picture = plot and place(plot, str(beside.path.with_suffix(PICTURES[0])), PICTURES, inputs)
    rows, cols = plan.layout.shape
    say(f"{name}: {rows} x {cols}, {plan.whose}")
    # These import jax, a compiler and a solver: refusals are faster without them.
    from qdenv.repair.recipe import repair_layout as repair
    from qdenv.score import similarity

    with Bar("repairing") as bar:
        result = repair(plan.layout, rules, seed, RepairConfig(polish=polish), bar)
    repaired = np.asarray(result.layout)
    changes = list_changes(plan.layout, repaired, kind)
    weights = plan.domain.similarity_weights(plan.layout)
    facts = {
        "status": RepairStatus(int(result.status)).name.lower(),
        "hamming": float(result.cost),
        "lower_bound": float(result.lower_bound),
        "gap": float((result.cost - result.lower_bound) / max(result.cost, 1.0)),
        "similarity": float(similarity(plan.layout, result.layout, weights)),
        "cpu_seconds": round(float(result.seconds), 3),
        "broken_before": len(audit(plan.layout, rules)),
        "valid": not audit(repaired, rules),
    }
    say(*(f"{name:13} {value}" for name, value in tidy(facts).items()))
    settings: dict[str, Any] = {"layout": name, "domain": kind.name, "keep": keep, "seed": seed}
    settings |= {"polish": polish, "numbers": numbers}
    facts |= {"changes": changes, "settings": settings}
    if not facts["valid"]:
        less = ", or keep fewer cells" if kind.config.keep else ""
        raise UnsolvedError(f"{name}: no feasible layout was found: try another seed{less}", facts)
    say(*describe_changes(changes), *warn_of_changes(changes))
    made = Layout(repaired, kind, {"repaired_from": Path(name).name}, facts)
    if target:
        made.save(target.path)
        say(target)
    if picture:
        from qdenv.view.layouts import save_difference  # imports matplotlib

        save_difference(picture.path, plan.layout, repaired, kind.tiles, kind.names)
        say(picture)
    return made


def _possible_rules(domain: Domain, name: str) -> Rules:
    """Return the rules of a layout's domain; refuse where there is none or no layout obeys them."""
    if domain.rules is None:
        raise InputError(f"{name}: layouts of {domain.name} have no rules: nothing to repair")
    rules: Rules = domain.rules()
    if reason := impossible(rules):
        raise InputError(f"{name}: no repair exists: {reason}")
    return rules


def human_layout(
    rows: int,
    cols: int,
    domain: Annotated[str, tyro.conf.arg(metavar=domain_names())] = USUAL,
    out: Out = None,
) -> Layout:
    """Draw a layout as people design it by hand, at any size.

    Args:
        rows: rows of the layout, frame included.
        cols: columns of the layout, frame included.
        domain: whose layouts.
        out: layout file to write (.json, .txt, .csv), a picture is drawn beside it; layout.json
            unless given.

    Raises:
        InputError: the size is impossible, or the domain has no such design.
    """
    check_size(rows, cols)
    from qdenv.study import elites as sizes  # imports jax

    found = find_domain(domain).resized(rows, cols)
    endings = endings_for(found.tiles, found.meanings)
    target = None if out is None else place(out, "layout.json", endings)
    drawn = sizes.human_layout(found)
    details = {"domain": found.name, "design": "human"}
    made = Layout(drawn, found, details, {"rows": rows, "cols": cols, **details})
    counts = ", ".join(
        f"{(drawn == k).sum()} {found.names.get(tile, repr(tile))}"
        for k, tile in enumerate(found.tiles)
    )
    if target:
        save_with_picture(made, target, counts=f"{rows} x {cols}, {counts}")
    for name, number in found.numbers.items():
        has = found.fitted(drawn).numbers[name]
        if found.known.get((rows, cols)) and has != number:
            say(f"generated layouts of this size have {number} {name} unless stated, this {has}")
    return made


def tile_layout(
    layout: Source,
    rows: int,
    cols: int,
    domain: DomainName = None,
    seed: RepairSeed = 0,
    polish: Polish = "quick",
    out: Out = None,
    **numbers: Number,
) -> Layout:
    """Repeat a small layout until it fills a larger one, and repair that (section E.4).

    Args:
        layout: layout file to repeat.
        rows: rows of the larger layout, frame included.
        cols: columns of the larger layout, frame included.
        domain: whose layouts; what the file says, or its tiles tell, unless given.
        seed: other seeds give other, equally good repairs.
        polish: how hard to repair.
        out: layout file to write (.json, .txt, .csv), a picture is drawn beside it;
            LAYOUT_tiled.json unless given.
        **numbers: exact numbers of tiles; unless given what is known of the size, or else scaled
            with the area.

    Raises:
        InputError: the size is smaller than the layout, or no such layout exists.
    """
    check_size(rows, cols)
    from qdenv.study import elites as sizes  # imports jax

    plan = read_plan(layout, domain)
    if rows < plan.layout.shape[0] or cols < plan.layout.shape[1]:
        size = "{} x {}".format(*plan.layout.shape)
        raise InputError(f"{rows} x {cols} is smaller than the layout it repeats, {size}")
    found, config, target = plan.domain, RepairConfig(polish=polish), None
    if out is not None:
        endings = endings_for(found.tiles, found.meanings)
        target = place(out, f"{stem_of(layout)}_tiled.json", endings, [layout])
    tiled = sizes.tile(found, plan.layout, (rows, cols), numbers, config, seed)
    say(*filter(None, [describe_growth(found, (rows, cols), ["steps", *numbers])]))
    source = Path(layout).name if isinstance(layout, str | Path) else plan.name
    details = sizes.details(tiled) | {"domain": found.name, "tiled_from": source}
    made = Layout(tiled.layout, found, details, details)
    if target:
        save_with_picture(made, target)
    return made


def save_with_picture(layout: Layout, target: Place, counts: str = "") -> None:
    """Write a layout and a picture beside it, and log their names.

    Args:
        layout: the layout.
        target: of the layout file.
        counts: what is logged of the layout; its details unless given.
    """
    layout.save(target.path)
    picture = target.beside(PICTURES[0])
    layout.draw(picture.path)
    say(picture)
    details = ", ".join(f"{name} {value}" for name, value in layout.details.items())
    say(f"{target}: {counts or details}")


def layout_symbols(domain: DomainName = None) -> None:
    """List the symbols of layout files: what each means in each domain.

    Args:
        domain: only this one.
    """
    domains_of: dict[tuple[tuple[str, ...], ...], list[str]] = {}
    for name in (domain,) if domain else DOMAINS.names():
        domains_of.setdefault(tuple(symbols_of(find_domain(name))), []).append(name)
    for rows, names in domains_of.items():
        table = format_table([("symbol", "tile", "robots", "also", "meaning"), *rows])
        say(", ".join(names), *(f"  {line}" for line in table), "")


def symbols_of(domain: Domain) -> list[tuple[str, ...]]:
    """List a domain's tiles: symbol, name, whether robots drive there, other symbols, meaning."""
    also: dict[str, list[str]] = {}
    for other, symbol in aliases(domain.tiles, domain.meanings).items():
        also.setdefault(symbol, []).append(repr(other))
    rows: list[tuple[str, ...]] = []
    for symbol in domain.tiles:
        name, drives, about = "", "", ""
        if tile := domain.meanings.get(symbol):
            drives = "drive around it" if tile.obstacle else "drive over it"
            name, about = tile.name, tile.about
        rows.append((repr(symbol), name, drives, " ".join(also.get(symbol, [])), about))
    return rows


def make_environment(
    layout: Source,
    agents: int = 50,
    timesteps: int = 1000,
    domain: str | None = None,
    observe: Observe | None = None,
) -> Environment:
    """Make a stepwise environment for learners: one action for every robot.

    Args:
        layout: see `read_plan`.
        agents: number of robots.
        timesteps: steps until `Timestep.last`.
        domain: whose tasks they do.
        observe: traceable function of the state; positions, goals and services unless given.

    Raises:
        InputError: no fleet drives in this domain, or not on this layout.
    """
    from qdenv.simulate.mapf.environment import Environment, observe_plainly  # imports jax

    plan = read_plan(layout, domain)
    tasks = plan.domain.simulator.tasks
    if tasks is None:
        raise InputError(f"no fleet drives in {plan.domain.name}")
    return Environment(plan.layout, tasks, agents, timesteps, observe or observe_plainly)
