"""The repair of one layout: annealed start, HiGHS polish, limits, status and bound."""

import hashlib
import time
from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from qdenv.repair.anneal import anneal
from qdenv.repair.audit import audit
from qdenv.repair.bounds import impossible, price_bound
from qdenv.repair.kinds import balance
from qdenv.repair.polish import Limits, polish
from qdenv.repair.template import templates
from qdenv.types import InputError, Repair, RepairStatus, Rules


class Level(NamedTuple):
    """What a named polish means.

    Attributes:
        moves_per_cell: annealing moves per free cell.
        limits: of the solver; None where it is not asked.
        largest: free cells up to which the solver branches; beyond, where one round of its work
            takes seconds, the annealer makes twice as many moves instead.
    """

    moves_per_cell: int
    limits: Limits | None
    largest: int


LEVELS = {
    "none": Level(800, None, 10**9),
    "quick": Level(600, Limits(gap=0.0, hope=0.03, nodes=1, checks=6, rounds=2, seconds=0), 3000),
    "full": Level(
        2500, Limits(gap=0.0, hope=0.08, nodes=1000, checks=100, rounds=4, seconds=0), 10**9
    ),
}


@dataclass(frozen=True)
class RepairConfig:
    """Limits of one repair; all but `time_limit` are deterministic.

    Attributes:
        polish: "none" anneals only, "quick" adds a short solver run where it pays, "full" anneals
            longer and lets the solver run to a proof or to its limits.
        moves_per_cell: annealing moves per free cell; 0 takes the default of `polish`.
        gap: relative gap at which the solver stops.
        node_limit: branch-and-bound nodes of one solve; 0 takes the default of `polish`.
        time_limit: wall-clock safety net of one solve in seconds; only when it fires is a repair
            not reproducible, and its status says so.
        workers: threads that repair layouts of a batch; 0 takes one per core.
    """

    polish: str = "quick"
    moves_per_cell: int = 0
    gap: float = 0.0
    node_limit: int = 0
    time_limit: float = 1800.0
    workers: int = 0

    def __post_init__(self) -> None:
        """Reject a polish that does not exist."""
        if self.polish not in LEVELS:
            raise InputError(f"polish {self.polish!r} must be one of {', '.join(LEVELS)}")


FEWEST_MOVES = 20_000  # a few milliseconds, which tiny layouts need as well
GENTLE = {}
# No move may break a rule: from a start that obeys all of them, feasibility cannot be lost.
STRICT = {"heats": (0.3, 0.1), "pulls": (20.0, 20.0)}


def seed_of(layout: np.ndarray, seed: int) -> int:
    """Mix a base seed with the layout's content.

    Equal layouts share a seed whatever the batch around them, so a remembered repair is exactly
    the one that would be computed again.
    """
    digest = hashlib.blake2b(layout.astype(np.int8).tobytes(), digest_size=8)
    digest.update(repr((layout.shape, int(seed))).encode())
    return int.from_bytes(digest.digest(), "little") >> 1


def repair(
    layout: np.ndarray, rules: Rules, seed: int = 0, config: RepairConfig | None = None
) -> Repair:
    """Find the cheapest layout near `layout` that obeys `rules`.

    Args:
        layout: int8 [H, W].
        rules: the constraints of this canvas.
        seed: any integer; mixed with the layout's content. The same seed gives the same layout,
            another seed may give another one of equal price.
        config: limits; defaults to `RepairConfig()`.

    Returns:
        A `Repair` of numpy values. Status `IMPOSSIBLE` or `FAILED` returns the layout as it came,
        with infinite price.
    """
    config = config or RepairConfig()
    begin = time.thread_time()
    layout = np.asarray(layout, np.int8)
    if impossible(rules) is not None:
        return _record(layout, RepairStatus.IMPOSSIBLE, np.inf, np.inf, begin)
    bound, seed = price_bound(layout, rules), seed_of(layout, seed)
    found, price = _feasible(layout, rules, seed, config)
    if found is None:
        return _record(layout, RepairStatus.FAILED, np.inf, bound, begin)
    limits = _limits(rules, config)
    if price <= bound + 1e-6:
        return _record(found, RepairStatus.OPTIMAL, price, bound, begin)
    if limits is None:
        return _record(found, RepairStatus.ANNEALED, price, bound, begin)
    best = polish(layout, rules, found, price, bound, seed, limits)
    return _record(best.layout, best.status, best.price, best.bound, begin)


def _feasible(
    layout: np.ndarray, rules: Rules, seed: int, config: RepairConfig
) -> tuple[np.ndarray | None, float]:
    """Anneal until a layout passes the audit: from the input, then from regular layouts."""
    level, cells = LEVELS[config.polish], _free_cells(rules)
    per_cell = config.moves_per_cell or level.moves_per_cell * (1 + (cells > level.largest))
    moves = max(cells * per_cell, FEWEST_MOVES)
    for attempt, (start, schedule) in enumerate(_starts(layout, rules)):
        found, price = anneal(layout, rules, seed + attempt, moves, start, **schedule)
        if found is not None and not audit(found, rules):
            return balance(found, price, layout, rules, seed)
    return None, np.inf


def _free_cells(rules: Rules) -> int:
    """Count the cells that may change."""
    return int((rules.allowed.sum(-1) > 1).sum())


def _limits(rules: Rules, config: RepairConfig) -> Limits | None:
    """Fill the limits of a polish with what the configuration says."""
    level = LEVELS[config.polish]
    if level.limits is None:
        return None
    return level.limits._replace(
        gap=config.gap,
        hope=level.limits.hope if _free_cells(rules) <= level.largest else 0.0,
        nodes=config.node_limit or level.limits.nodes,
        seconds=config.time_limit,
    )


def _starts(layout: np.ndarray, rules: Rules) -> Iterator[tuple[np.ndarray, dict]]:
    """List where and how to anneal, the later ones for layouts that the earlier ones fail on."""
    yield layout, GENTLE
    yield layout, {"heats": (0.5, 0.1), "pulls": (2.0, 8.0)}
    drawn = templates(layout, rules)
    for start in sorted(drawn, key=lambda start: len(audit(start, rules)))[:4]:
        yield start, STRICT


def _record(
    layout: np.ndarray, status: RepairStatus, price: float, bound: float, begin: float
) -> Repair:
    """Fill a `Repair` with numpy values of the promised types."""
    return Repair(
        layout=layout.astype(np.int8),
        status=np.int32(status),
        cost=np.float32(price),
        lower_bound=np.float32(bound),
        seconds=np.float32(time.thread_time() - begin),
    )
