"""The repair of one layout: bound its cost, anneal, audit; where it is asked for, improve.

Anneal first: that finds a feasible layout in a fraction of a second whatever came in, where the
solver alone often finds none. Where annealing finds none either, so near to what is impossible that
hardly any layout is left, the solver is asked whether there is one. It then starts from what was
found: it improves windows of the layout, and on the whole of it lowers the cost and bounds how low
a cost can be.
"""

import hashlib
import time
from collections.abc import Iterator

import numpy as np

from qdenv.repair.anneal.loop import FIRM, GENTLE, STRICT, Schedule, anneal
from qdenv.repair.anneal.packing import draw_templates
from qdenv.repair.audit import audit
from qdenv.repair.milp.feasibility import find_possible
from qdenv.repair.milp.highs import improve, keep_cheaper
from qdenv.repair.milp.windows import WindowSearch
from qdenv.repair.rules import (
    Facts,
    Report,
    Result,
    balance,
    bound_cost,
    find_contradiction,
    no_report,
)
from qdenv.repair.settings import RepairConfig
from qdenv.types import Repair, RepairStatus, Rules

MAX_TEMPLATES = 4  # regular layouts to start from, those that break the fewest rules


def repair_layout(
    layout: np.ndarray,
    rules: Rules,
    seed: int = 0,
    config: RepairConfig | None = None,
    report: Report = no_report,
) -> Repair:
    """Find the cheapest layout near `layout` that obeys `rules`.

    Args:
        layout: int8 [H, W].
        rules: the constraints of this canvas.
        seed: any integer; mixed with the layout's content. The same seed gives the same layout,
            another seed may give another one of equal cost.
        config: limits; defaults to `RepairConfig()`.
        report: told what is being done, and from 0 to 1 how much of it is.

    Returns:
        A `Repair` of numpy values. Status `IMPOSSIBLE` or `FAILED` returns the layout as it came,
        with infinite cost.
    """
    config = config or RepairConfig()
    begin = time.thread_time()
    layout, facts = np.asarray(layout, np.int8), Facts(rules)
    best = Result(layout, np.inf, np.inf, RepairStatus.IMPOSSIBLE)
    if find_contradiction(facts) is None:
        best = _repair_possible(layout, facts, mix_seed(layout, seed), config, report)
    return best.record(time.thread_time() - begin)


def _repair_possible(
    layout: np.ndarray, facts: Facts, seed: int, config: RepairConfig, report: Report
) -> Result:
    """Repair a layout whose rules do not contradict each other."""
    bound, effort = bound_cost(layout, facts), config.effort
    candidate, cost = _anneal_until_feasible(layout, facts, seed, config, bound, report)
    if candidate is None:
        if find_possible(facts, report).status == RepairStatus.IMPOSSIBLE:
            return Result(layout, np.inf, np.inf, RepairStatus.IMPOSSIBLE)
        return Result(layout, np.inf, bound, RepairStatus.FAILED)
    best = Result(candidate, cost, bound, RepairStatus.ANNEALED)
    if effort.windows is not None and facts.rules.aisle <= 1 and not best.proven():
        search = WindowSearch(layout, candidate, facts, seed)
        best = keep_cheaper(best, search.run(effort.windows, report), layout, facts)
    if best.proven():
        return best._replace(status=RepairStatus.OPTIMAL)
    if effort.milp is None or facts.free_cells > effort.milp.max_cells:
        return best
    report("solving the whole layout", 0.0)
    return improve(layout, facts, best, seed, config, effort.milp)


def _anneal_until_feasible(
    layout: np.ndarray,
    facts: Facts,
    seed: int,
    config: RepairConfig,
    bound: float,
    report: Report,
) -> tuple[np.ndarray | None, float]:
    """Anneal until a layout passes the audit: from the input, then from layouts that hold more."""
    moves = config.count_moves(facts.free_cells)
    for attempt, (start, schedule) in enumerate(_starts(layout, facts, report)):
        candidate, cost = anneal(
            layout, facts, seed + attempt, moves, start, schedule, report, bound
        )
        if candidate is not None and not audit(candidate, facts.rules):
            return balance(candidate, cost, layout, facts, seed)
    return None, np.inf


def _starts(
    layout: np.ndarray, facts: Facts, report: Report
) -> Iterator[tuple[np.ndarray, Schedule]]:
    """List where and how to anneal, the later ones for layouts that the earlier ones fail on."""
    yield layout, GENTLE
    yield layout, FIRM
    templates = draw_templates(layout, facts)
    by_breaches = sorted(templates, key=lambda start: len(audit(start, facts.rules)))
    for start in by_breaches[:MAX_TEMPLATES]:
        yield start, STRICT
    known = find_possible(facts, report)
    if known.layout is not None:
        yield known.layout, STRICT


def mix_seed(layout: np.ndarray, seed: int) -> int:
    """Mix a base seed with the layout's content.

    Equal layouts share a seed whatever the batch around them, so a remembered repair is exactly
    the one that would be computed again.
    """
    digest = hashlib.blake2b(layout.astype(np.int8).tobytes(), digest_size=8)
    digest.update(repr((layout.shape, int(seed))).encode())
    return int.from_bytes(digest.digest(), "little") >> 1
