"""Attack on the repair: random layouts and rules, far from the limits, near them and beyond."""

from pathlib import Path
from typing import Literal, NamedTuple

import highspy
import numpy as np

from qdenv.domains.base import find_domain
from qdenv.repair.audit import audit
from qdenv.repair.milp.feasibility import is_refuted
from qdenv.repair.milp.highs import add_cuts, load, new_solver, round_up, separate
from qdenv.repair.milp.program import build, decode
from qdenv.repair.recipe import repair_layout
from qdenv.repair.rules import Facts
from qdenv.repair.settings import Polish, RepairConfig
from qdenv.types import Count, RepairStatus, Rules
from robustness.attack import Attack, Attempt

KINDS = {"warehouse-even": "@", "warehouse-uneven": "@", "manufacturing": "012"}  # and obstacles
USUAL = 0.01  # share of layouts of the size of a search, the others being small
TINY = 24  # cells that may change, of canvases that the exact program decides at once
SMALL = 60  # likewise within its limits, often
REFUTED = 200  # likewise, that the relaxation is asked about
NODES = 100  # of one solve of the exact program
SOLVES = 20  # each with more connectivity cuts
POLISHES: tuple[Polish, ...] = ("none", "quick", "full")
MOVES = 300  # annealing moves per cell of the longest repairs
Verdict = Literal["found", "none", "unknown"]


class Task(NamedTuple):
    """What is repaired."""

    name: str  # kind, size and number of obstacles, as faults call it
    layout: np.ndarray  # int8 [H, W]
    rules: Rules  # the constraints


def draw_task(chance: np.random.Generator) -> Task:
    """Draw a domain, a canvas, rules on it and a layout."""
    kind = str(chance.choice(list(KINDS)))
    frame = 0 if kind == "manufacturing" else 4
    rows, cols = (int(chance.integers(3, chance.choice([6, 10, 18]))) for _ in range(2))
    shape = (33, 36) if chance.random() < USUAL else (rows, cols + frame + 1)
    rules = find_domain(kind).resized(*shape).rules
    assert rules is not None  # of the three domains that are repaired
    changed = _change_rules(chance, rules(), KINDS[kind])
    return Task(
        f"{kind} {shape[0]} x {shape[1]}, {changed.counts}, aisle {changed.aisle}",
        _draw_layout(chance, changed),
        changed,
    )


def _change_rules(chance: np.random.Generator, rules: Rules, obstacles: str) -> Rules:
    """Ask for other numbers of obstacles, and now and then for wide aisles or fixed cells."""
    holds = [rules.tiles.index(tile) for tile in obstacles]
    may = rules.allowed[..., holds].any(-1)
    low, high = ((0.05, 0.5), (0.5, 0.75), (0.05, 1.1))[chance.choice(3, p=[0.35, 0.5, 0.15])]
    number = round(chance.uniform(low, high) * int(may.sum()))
    counts: tuple[Count, ...] = (
        Count(obstacles, number, None if chance.random() < 0.2 else number),
    )
    if len(obstacles) > 1 and chance.random() < 0.5:
        counts += tuple(Count(tile, int(chance.integers(0, 4))) for tile in obstacles)
    allowed = rules.allowed.copy()
    if chance.random() < 0.2:
        cells = chance.permutation(np.argwhere(allowed.sum(-1) > 1))[: chance.integers(1, 4)]
        for row, col in cells:
            tile = chance.choice(np.flatnonzero(allowed[row, col]))
            allowed[row, col] = np.arange(allowed.shape[-1]) == tile
    aisle = 2 if chance.random() < 0.08 else 1
    return rules._replace(counts=counts, allowed=allowed, aisle=aisle)


def _draw_layout(chance: np.random.Generator, rules: Rules) -> np.ndarray:
    """Draw tiles with odds of their own, some where the rules forbid them (int8 [H, W])."""
    odds = chance.dirichlet(np.ones(len(rules.tiles)))
    drawn = chance.choice(len(rules.tiles), rules.allowed.shape[:2], p=odds)
    fixed = rules.allowed.sum(-1) == 1
    return np.where(fixed, rules.allowed.argmax(-1), drawn).astype(np.int8)


def attempt(chance: np.random.Generator, folder: Path) -> Attempt:
    """Repair one layout and examine what comes back."""
    del folder
    task = draw_task(chance)
    polish = POLISHES[chance.choice(3, p=[0.5, 0.4, 0.1])]
    config = RepairConfig(polish, moves_per_cell=MOVES if polish == "full" else None)
    done = repair_layout(task.layout, task.rules, int(chance.integers(1 << 30)), config)
    status = RepairStatus(int(done.status))
    facts, faults = Facts(task.rules), []
    if status < RepairStatus.IMPOSSIBLE:
        faults += examine(task, np.asarray(done.layout), float(done.cost), float(done.lower_bound))
        if facts.free_cells <= REFUTED and is_refuted(facts):
            faults.append("a layout was found where none is said to exist")
    elif not np.array_equal(done.layout, task.layout):
        faults.append(f"{status.name}, but the layout is not the one that came in")
    notes = {status.name: 1}
    if facts.free_cells <= (SMALL if status == RepairStatus.FAILED else TINY):
        verdict, least = solve_exactly(task.layout, facts)
        notes |= {"decided by the exact program": int(verdict != "unknown")}
        faults += contradictions(status, float(done.cost), verdict, least)
    return Attempt(1, tuple(f"{task.name}: {fault}" for fault in faults), notes)


def examine(task: Task, layout: np.ndarray, cost: float, bound: float) -> list[str]:
    """Name what is wrong with a repaired layout, its cost and its bound."""
    faults = [f"infeasible: {broken.message}" for broken in audit(layout, task.rules)]
    paid = float((task.rules.change_cost * (layout != task.layout)).sum())
    if abs(paid - cost) > 1e-4 * max(paid, 1):
        faults.append(f"a cost of {cost} is reported, {paid} is paid")
    if bound > cost + 1e-3:
        faults.append(f"the lower bound {bound} exceeds the cost {cost}")
    return faults


def contradictions(status: RepairStatus, cost: float, verdict: Verdict, least: float) -> list[str]:
    """Name how the exact program contradicts a status.

    Args:
        status: of the repair.
        cost: of its layout.
        verdict: whether the exact program found a layout, or that there is none.
        least: the cost of the cheapest layout, where it found one.
    """
    if verdict == "unknown":
        return []
    if status == RepairStatus.OPTIMAL and verdict == "found" and abs(cost - least) > 1e-3:
        return [f"{cost} is called optimal, the exact program finds {least}"]
    if status < RepairStatus.IMPOSSIBLE:
        below = cost < least - 1e-3
        return [f"the exact program finds {verdict}, {least}"] if verdict == "none" or below else []
    if verdict == "found" or status == RepairStatus.FAILED:
        return [f"{status.name}, the exact program says: {verdict}"]
    return []


def solve_exactly(layout: np.ndarray, facts: Facts) -> tuple[Verdict, float]:
    """Solve the plain program, with cuts where a solution falls apart: its cost, if decided."""
    program = build(layout, facts)
    solver = load(new_solver(0), program)
    solver.setOptionValue("mip_max_nodes", NODES)
    for _ in range(SOLVES):
        solver.run()
        status = solver.getModelStatus()
        if status == highspy.HighsModelStatus.kInfeasible:
            return "none", np.inf
        if status != highspy.HighsModelStatus.kOptimal:
            return "unknown", 0.0
        roles = decode(program.cells, np.array(solver.getSolution().col_value))
        driving = facts.driving[[members[0] for members in facts.roles]][roles]
        cuts = separate(driving, facts.must(facts.rules.connected))
        if not cuts:
            return "found", round_up(solver.getInfo().mip_dual_bound, facts)
        add_cuts(solver, program.cells, facts, cuts)
    return "unknown", 0.0


REPAIRS = Attack(
    "repairs",
    "every layout found obeys the rules; no claim is contradicted by the exact program",
    "repairs",
    attempt,
)
