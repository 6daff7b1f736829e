"""The repair of one layout: bound its cost, anneal, audit; improve it as far as `polish` says.

Anneal first: that makes a feasible layout in a fraction of a second of whatever came in, where the
solver alone often fails. Where annealing fails too, so near to what is impossible that hardly any
layout is left, the solver decides whether there is one. Otherwise it starts from the annealed
layout: it improves windows of it, and on the whole of it lowers the cost and bounds how low a cost
can be.
"""

import hashlib
import time
from collections.abc import Iterator

import numpy as np

from qdenv.repair.anneal.loop import HIGH_PENALTY, LOW_PENALTY, NO_VIOLATIONS, Schedule, anneal
from qdenv.repair.anneal.packing import draw_templates
from qdenv.repair.audit import audit
from qdenv.repair.milp.feasibility import find_possible
from qdenv.repair.milp.highs import improve, keep_cheaper
from qdenv.repair.milp.windows import WindowSearch
from qdenv.repair.rules import (
    Facts,
    Progress,
    Result,
    balance_kinds,
    bound_cost,
    find_contradiction,
    no_progress,
)
from qdenv.repair.settings import RepairConfig
from qdenv.types import Repair, RepairStatus, Rules

_MAX_TEMPLATES = 4  # regular layouts to start from, those that break the fewest rules


def repair_layout(
    layout: np.ndarray,
    rules: Rules,
    seed: int = 0,
    config: RepairConfig | None = None,
    progress: Progress = no_progress,
) -> Repair:
    """Find the cheapest layout near `layout` that obeys `rules`.

    Args:
        layout: int8 [H, W].
        rules: the constraints of this canvas.
        seed: any integer; mixed with the layout's content. The same seed gives the same layout,
            another seed may give another one of equal cost.
        config: limits; defaults to `RepairConfig()`.
        progress: called with what is being done, and from 0 to 1 how much of it is.

    Returns:
        A `Repair` of numpy values. Status `IMPOSSIBLE` or `FAILED` returns the layout as it came,
        with infinite cost.
    """
    config = config or RepairConfig()
    begin = time.thread_time()
    layout, facts = np.asarray(layout, np.int8), Facts(rules)
    best = Result(layout, np.inf, np.inf, RepairStatus.IMPOSSIBLE)
    if find_contradiction(facts) is None:
        best = _repair_possible(layout, facts, _mix_seed(layout, seed), config, progress)
    return best.record(time.thread_time() - begin)


def _repair_possible(
    layout: np.ndarray, facts: Facts, seed: int, config: RepairConfig, progress: Progress
) -> Result:
    """Repair a layout whose rules do not contradict each other."""
    bound, effort = bound_cost(layout, facts), config.effort
    moves = config.count_moves(facts.free_cells)
    for attempt, (start, schedule) in enumerate(_starts(layout, facts, progress)):
        candidate, cost = anneal(
            layout, facts, seed + attempt, moves, start, schedule, progress, bound
        )
        if candidate is not None and not audit(candidate, facts.rules):
            break
    else:
        if find_possible(facts, progress)[0] == RepairStatus.IMPOSSIBLE:
            return Result(layout, np.inf, np.inf, RepairStatus.IMPOSSIBLE)
        return Result(layout, np.inf, bound, RepairStatus.FAILED)
    candidate, cost = balance_kinds(candidate, cost, layout, facts, seed)
    best = Result(candidate, cost, bound, RepairStatus.ANNEALED)
    if effort.windows is not None and facts.rules.aisle <= 1 and not best.proven():
        search = WindowSearch(layout, candidate, facts, seed)
        best = keep_cheaper(best, search.run(effort.windows, progress), layout, facts)
    if best.proven():
        return best._replace(status=RepairStatus.OPTIMAL)
    if effort.milp is None or facts.free_cells > effort.milp.max_cells:
        return best
    progress("solving the whole layout", 0.0)
    return improve(layout, facts, best, seed, config, effort.milp)


def _starts(
    layout: np.ndarray, facts: Facts, progress: Progress
) -> Iterator[tuple[np.ndarray, Schedule]]:
    """List where and how to anneal, the later ones for layouts that the earlier ones fail on."""
    yield layout, LOW_PENALTY
    yield layout, HIGH_PENALTY
    for start in draw_templates(layout, facts)[:_MAX_TEMPLATES]:
        yield start, NO_VIOLATIONS
    _, known = find_possible(facts, progress)
    if known is not None:
        yield known, NO_VIOLATIONS


def _mix_seed(layout: np.ndarray, seed: int) -> int:
    """Mix a base seed with the layout's content.

    Equal layouts share a seed whatever the batch around them, so a remembered repair is exactly
    the one that would be computed again.
    """
    digest = hashlib.blake2b(layout.astype(np.int8).tobytes(), digest_size=8)
    digest.update(repr((layout.shape, int(seed))).encode())
    return int.from_bytes(digest.digest(), "little") >> 1
