"""The repair of one layout: bound its cost, anneal, audit; improve it as far as `polish` says.

Annealing makes a feasible layout of nearly any input within seconds, where the solver alone often
fails. The solver starts from that layout: it improves windows of it, then the whole, and
bounds how low a cost can be. Where annealing fails too, it decides whether any layout exists.
"""

import hashlib
import operator
import time
from collections.abc import Iterator

import numpy as np

from qdenv.progress import Progress, silent
from qdenv.repairs.anneal.loop import HIGH_PENALTY, LOW_PENALTY, NO_VIOLATIONS, Schedule, anneal
from qdenv.repairs.anneal.packing import draw_templates
from qdenv.repairs.audit import audit
from qdenv.repairs.milp.feasibility import find_possible
from qdenv.repairs.milp.highs import MAX_CELLS, improve, keep_cheaper
from qdenv.repairs.milp.windows import WindowSearch
from qdenv.repairs.rules import Facts, assign_kinds, bound_cost, impossible, is_proven
from qdenv.repairs.settings import RepairConfig
from qdenv.types import Repair, RepairStatus, Rules

_MAX_TEMPLATES = 4  # regular layouts to start from, those that break the fewest rules


def repair_layout(
    layout: np.ndarray,
    rules: Rules,
    seed: int = 0,
    config: RepairConfig | None = None,
    progress: Progress = silent,
) -> Repair:
    """Change few cells of `layout` (int8 [H, W]) so that it obeys `rules`.

    The seed, any integer, is mixed with the layout's content: the same gives the same layout,
    another may give another one of about equal cost. Returns numpy values; where the status is
    `IMPOSSIBLE` or `FAILED`, the layout is the input, at infinite cost.
    """
    begin = time.thread_time()
    layout, facts = np.asarray(layout, np.int8), Facts(rules)
    best = Repair(layout, RepairStatus.IMPOSSIBLE, np.inf, np.inf, 0.0)
    if impossible(rules, facts) is None:
        seed = int.from_bytes(hash_content(layout, seed, 8), "little") >> 1
        best = _repair_possible(layout, facts, seed, config or RepairConfig(), progress)
    floats = map(np.float32, (best.cost, best.lower_bound, time.thread_time() - begin))
    return Repair(np.asarray(best.layout, np.int8), np.int32(best.status), *floats)


def hash_content(layout: np.ndarray, seed: int, size: int) -> bytes:
    """Hash what decides a repair: the layout's content (int8 [H, W]), its shape and the seed.

    Equal layouts share a seed whatever the batch around them, so a remembered repair is exactly
    the one that would be computed again.
    """
    digest = hashlib.blake2b(layout.tobytes(), digest_size=size)
    digest.update(repr((layout.shape, operator.index(seed))).encode())
    return digest.digest()


def _repair_possible(
    layout: np.ndarray, facts: Facts, seed: int, config: RepairConfig, progress: Progress
) -> Repair:
    """Repair a layout whose rules do not contradict each other."""
    bound, moves = bound_cost(layout, facts), config.count_moves(facts.free_cells)
    if facts.rules.covers:  # moves of rectangles take up to three times as long; fewer are needed
        moves = moves * 2 // 5

    def starts() -> Iterator[tuple[np.ndarray, Schedule]]:
        """List where and how to anneal, the later ones for layouts that the earlier fail on."""
        yield layout, LOW_PENALTY
        # Moves of rectangles mend more than a stricter schedule does.
        yield layout, LOW_PENALTY if facts.rules.covers else HIGH_PENALTY
        for start in draw_templates(layout, facts.straightened(layout))[:_MAX_TEMPLATES]:
            yield start, NO_VIOLATIONS
        _, known = find_possible(facts, progress)
        if known is not None:
            yield known, NO_VIOLATIONS

    for attempt, (start, schedule) in enumerate(starts()):
        straight = facts.straightened(start)
        candidate, cost = anneal(
            layout, straight, seed + attempt, moves, start, schedule, progress, bound
        )
        if candidate is not None and not audit(candidate, facts.rules):
            break
    else:
        if find_possible(facts, progress)[0] == RepairStatus.IMPOSSIBLE:
            return Repair(layout, RepairStatus.IMPOSSIBLE, np.inf, np.inf, 0.0)
        return Repair(layout, RepairStatus.FAILED, np.inf, bound, 0.0)
    if max(map(len, facts.roles)) > 1:
        # Kinds that share a role: assign them again, where that costs no more.
        rng = np.random.default_rng(seed)
        balanced = assign_kinds(facts.role_of[candidate], layout, facts, rng)
        paid = facts.cost(balanced, layout)
        if paid <= cost and not audit(balanced, facts.rules):
            candidate, cost = balanced, paid
    best = Repair(candidate, RepairStatus.ANNEALED, cost, bound, 0.0)
    if config.polish == "full" and not facts.rules.covers and not is_proven(best):
        # The program of a window states no rule on aisles or racks.
        search = WindowSearch(layout, candidate, facts.straightened(candidate), seed)
        best = keep_cheaper(best, search.run(progress), layout, facts)
    if is_proven(best):
        return best._replace(status=RepairStatus.OPTIMAL)
    if config.polish != "full" or facts.free_cells > MAX_CELLS:
        return best
    progress("solving the whole layout", 0.0, "")
    return improve(layout, facts, best, seed, config)
