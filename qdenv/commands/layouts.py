"""Commands about layouts: repair, check."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
import tyro

from qdenv.commands import output
from qdenv.commands.choices import DomainName, LayoutFile, Numbers
from qdenv.domains.base import Domain
from qdenv.io.files import tidy
from qdenv.io.layouts import endings_for, write_layout
from qdenv.progress import Bar
from qdenv.repair.audit import Violation, audit, check_allowed
from qdenv.repair.rules import impossible
from qdenv.repair.settings import RepairConfig
from qdenv.study.changes import describe_changes, list_changes, warn_of_changes
from qdenv.study.plans import Plan, read_plan
from qdenv.types import InputError, Repair, RepairStatus, Rules


@dataclass(frozen=True)
class Results:
    """What a repair leaves behind."""

    # layout file to write (.json, .txt, .csv); LAYOUT_repaired.json unless given
    out: Path | None = None
    # picture of what changed to write
    plot: Annotated[Path | None, tyro.conf.arg(aliases=("--diff",))] = None
    json_file: output.JsonFile = None  # facts to write; - for standard output


def repair(
    layout: LayoutFile,
    numbers: Numbers,
    domain: DomainName = None,
    keep: Path | None = None,
    seed: Annotated[int, tyro.conf.arg(aliases=("--repair-seed",))] = 0,
    polish: Literal["none", "quick", "full"] = "full",
    results: Annotated[Results, tyro.conf.arg(name="")] = Results(),
) -> None:
    """Repair a layout: the closest one that obeys every rule of its domain.

    Args:
        layout: layout file.
        numbers: exact numbers of tiles; as many as the layout has unless given.
        domain: whose rules; what the file says, or its tiles tell, unless given.
        keep: drawing of the layout's shape: ? may change, ! stays, a tile must be this tile.
        seed: other seeds may give other, equally good layouts.
        polish: how hard to try after the first feasible layout.
        results: what to write.
    """
    plan = read_plan(layout, domain)
    kind = plan.fitted(numbers.given(), keep)
    rules = possible_rules(kind, layout)
    endings, read = endings_for(kind.tiles, kind.meanings), [layout, *([keep] if keep else [])]
    place = output.place(results.out, f"{layout.stem}_repaired.json", endings, read)
    picture = place_plot(results.plot, place, read)
    rows, cols = plan.layout.shape
    print(f"{layout}: {rows} x {cols}, {plan.whose}", flush=True)
    # Only here: the repair imports a compiler and a solver.
    from qdenv.repair.recipe import repair_layout

    with Bar("repairing") as bar:
        result = repair_layout(plan.layout, rules, seed, RepairConfig(polish=polish), bar)
    after = np.asarray(result.layout)
    facts, changes = facts_of(plan, result, rules), list_changes(plan.layout, after, kind)
    print("\n".join(f"{name:13} {value}" for name, value in tidy(facts).items()))
    settings = {"layout": layout, "domain": kind.name, "keep": keep, "seed": seed, "polish": polish}
    listed = {"changes": [change._asdict() for change in changes]}
    output.write_facts(
        results.json_file, "repair", facts | listed, **settings, numbers=numbers.given()
    )
    if not facts["valid"]:
        less = ", or keep fewer cells" if kind.config.keep else ""
        raise InputError(f"{layout}: no feasible layout was found: try another seed{less}")
    print("\n".join([*describe_changes(changes), *warn_of_changes(changes)]))
    details = kind.details | {"repaired_from": layout.name}
    write_layout(place.path, after, kind.tiles, kind.meanings, **details)
    print(place)
    if picture is not None:
        # Only here: matplotlib takes half a second to import, as long as many a repair.
        from qdenv.view.layouts import save_difference

        save_difference(picture.path, plan.layout, after, kind.tiles, kind.names)
        print(picture)


def place_plot(plot: Path | None, beside: output.Place, inputs: list[Path]) -> output.Place | None:
    """Choose where the picture of a command's result goes; None where none is asked for.

    Args:
        plot: what the command line says; "auto" for the result's name.
        beside: where the result goes.
        inputs: files that are read.

    Raises:
        InputError: the name is no picture's.
    """
    if plot is None:
        return None
    named = None if str(plot) == "auto" else plot
    default = beside.path.with_suffix(output.PICTURES[0])
    return output.place(named, str(default), output.PICTURES, inputs)


def possible_rules(domain: Domain, path: Path) -> Rules:
    """State the rules of a layout's canvas.

    Raises:
        InputError: the domain has none, or no layout obeys them.
    """
    if domain.rules is None:
        raise InputError(f"{path}: layouts of {domain.name} have no rules: nothing to repair")
    rules = domain.rules()
    if reason := impossible(rules):
        raise InputError(f"{path}: no repair exists: {reason}")
    return rules


def facts_of(plan: Plan, result: Repair, rules: Rules) -> dict[str, Any]:
    """List what is known of a repair."""
    # Only here: jax takes long to import, and who is refused need not wait.
    from qdenv.score import similarity

    weights = plan.domain.similarity_weights(plan.layout)
    return {
        "status": RepairStatus(int(result.status)).name.lower(),
        "hamming": float(result.cost),
        "lower_bound": float(result.lower_bound),
        "gap": float((result.cost - result.lower_bound) / max(result.cost, 1.0)),
        "similarity": float(similarity(plan.layout, result.layout, weights)),
        "cpu_seconds": round(float(result.seconds), 3),
        "broken_before": len(audit(plan.layout, rules)),
        "valid": not audit(np.asarray(result.layout), rules),
    }


def check(
    layout: LayoutFile,
    numbers: Numbers,
    domain: DomainName = None,
    keep: Path | None = None,
    json_file: output.JsonFile = None,
) -> int | None:
    """Check a layout against its domain's rules: exit code 0, or 1 and what is broken.

    Args:
        layout: layout file.
        numbers: exact numbers of tiles to demand; not checked unless given.
        domain: whose rules; what the file says, or its tiles tell, unless given.
        keep: drawing of cells that are meant to be as they are: ! or a tile, ? elsewhere.
        json_file: facts to write; - for standard output.
    """
    plan = read_plan(layout, domain)
    kind = plan.fitted(numbers.given(), keep)
    rules = kind.rules() if kind.rules else None
    broken = audit(plan.layout, rules) if rules else []
    facts = {"valid": not broken, "rules": rules is not None, "broken": list_broken(broken)}
    settings = {"layout": layout, "domain": kind.name, "keep": keep, "numbers": numbers.given()}
    output.write_facts(json_file, "check", facts, **settings)
    for violation in broken:
        row, column = violation.cell
        print(f"{violation.message} (row {row}, column {column})")
    if rules is None:
        print(f"{layout}: layouts of {kind.name} have no rules, none is broken")
    elif broken:
        if check_allowed(plan.layout, rules):
            print("(--keep FILE allows what a drawing marks with '!' to stand where it stands)")
        broke = "1 rule" if len(broken) == 1 else f"{len(broken)} rules"
        print(f"{layout}: {broke} broken, {plan.whose}")
    else:
        print(f"{layout}: obeys every rule, {plan.whose}")
    return 1 if broken else 0


def list_broken(broken: list[Violation]) -> list[dict[str, Any]]:
    """Put broken rules in the form of facts."""
    return [{"message": one.message, "row": one.cell[0], "column": one.cell[1]} for one in broken]
