"""Commands about layouts: repair, check."""

import contextlib
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
import tyro
from tqdm import tqdm

from qdenv.commands.choices import Numbers
from qdenv.domains.base import Domain, find_domain
from qdenv.files import write_json
from qdenv.formats.layouts import read_layout, write_layout
from qdenv.repair.audit import audit
from qdenv.repair.bounds import impossible
from qdenv.repair.settings import RepairConfig
from qdenv.score.layout import similarity
from qdenv.study.plans import USUAL
from qdenv.types import InputError, RepairStatus, Rules

LayoutFile = tyro.conf.Positional[Path]
JsonFile = Annotated[Path | None, tyro.conf.arg(name="json")]
PATIENCE = 3.0  # seconds that pass before progress is shown
BAR = "{desc} {percentage:3.0f} %|{bar:30}| {elapsed}, {remaining} left"


class Progress:
    """A bar on a terminal for each step of a repair that takes longer than a person waits."""

    def __init__(self) -> None:
        """Show nothing yet."""
        self.bar: tqdm | None = None

    def __call__(self, doing: str, done: float) -> None:
        """Show which share of a step is done."""
        if self.bar is None or self.bar.desc != doing:
            self.close()
            show = {"bar_format": BAR, "delay": PATIENCE, "leave": False, "disable": None}
            self.bar = tqdm(total=1.0, desc=doing, **show)
            self.bar.desc = doing
        self.bar.update(done - self.bar.n)

    def close(self) -> None:
        """Take the bar away."""
        if self.bar is not None:
            self.bar.close()


def rules_of(domain: Domain, layout: np.ndarray, numbers: Numbers) -> Rules:
    """State the rules of a layout's canvas; its own numbers of tiles where none are given.

    Raises:
        InputError: the domain has no rules.
    """
    fitted = domain.fitted(layout, numbers.given())
    if fitted.rules is None:
        raise InputError(f"layouts of {domain.name} have no rules: there is nothing to do")
    return fitted.rules()


def repair(
    layout: LayoutFile,
    numbers: Numbers,
    domain: str = USUAL,
    seed: int = 0,
    polish: Literal["none", "quick", "full"] = "full",
    out: Path | None = None,
    diff: Path | None = None,
    json_file: JsonFile = None,
) -> None:
    """Repair a layout: the closest one that obeys every rule of its domain.

    Args:
        layout: layout file.
        numbers: exact numbers of tiles; as many as the layout has unless given.
        domain: whose rules.
        seed: other seeds may give other, equally good layouts.
        polish: how hard to try after the first feasible layout.
        out: layout file to write.
        diff: picture of what changed to write.
        json_file: facts to write.
    """
    kind = find_domain(domain)
    before = read_layout(layout, kind.tiles)
    rules = rules_of(kind, before, numbers)
    reason = impossible(rules)
    if reason:
        raise InputError(f"{layout}: no repair exists: {reason}")
    # Only here: the repair imports a compiler and a solver.
    from qdenv.repair.recipe import repair as repair_layout

    with contextlib.closing(Progress()) as progress:
        result = repair_layout(before, rules, seed, RepairConfig(polish=polish), progress)
    broken = audit(np.asarray(result.layout), rules)
    facts = {
        "status": RepairStatus(int(result.status)).name.lower(),
        "hamming": float(result.cost),
        "lower_bound": float(result.lower_bound),
        "gap": float((result.cost - result.lower_bound) / max(result.cost, 1.0)),
        "similarity": float(similarity(before, result.layout, kind.similarity_weights(before))),
        "cpu_seconds": round(float(result.seconds), 3),
        "broken_before": len(audit(before, rules)),
        "valid": not broken,
    }
    if result.status < RepairStatus.IMPOSSIBLE and out:
        write_layout(out, result.layout, kind.tiles, domain=kind.name, repaired_from=layout.name)
    if diff:
        # Only here: matplotlib takes half a second to import, as long as many a repair.
        from qdenv.plots.layouts import save_difference

        save_difference(diff, before, result.layout, kind.tiles)
    if json_file:
        write_json(json_file, facts)
    print("\n".join(f"{name:13} {value}" for name, value in facts.items()))
    if broken:
        raise InputError(f"{layout}: no feasible layout was found: try another seed")


def check(layout: LayoutFile, numbers: Numbers, domain: str = USUAL) -> int | None:
    """Check a layout against its domain's rules: exit code 0, or 1 and what is broken.

    Args:
        layout: layout file.
        numbers: exact numbers of tiles to demand; not checked unless given.
        domain: whose rules.
    """
    kind = find_domain(domain)
    tiles = read_layout(layout, kind.tiles)
    broken = audit(tiles, rules_of(kind, tiles, numbers))
    for violation in broken:
        row, column = violation.cell
        print(f"{violation.message} (row {row}, column {column})")
    print(f"{layout}: {len(broken)} rules broken" if broken else f"{layout}: obeys every rule")
    return 1 if broken else 0
