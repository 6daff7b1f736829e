"""Attack on the repair: random layouts and rules, far from the limits, near them and beyond."""

from pathlib import Path
from typing import Literal, NamedTuple

import highspy
import numpy as np

import qdenv
from qdenv.repairs.milp.feasibility import build_free
from qdenv.repairs.milp.highs import (
    add_cuts,
    load,
    new_solver,
    round_up,
    separate,
    solve_relaxation,
)
from qdenv.repairs.milp.program import build, decode
from qdenv.repairs.recipe import repair_layout
from qdenv.repairs.rules import Facts
from qdenv.repairs.settings import Polish, RepairConfig
from qdenv.types import Count, RepairStatus, Rules
from robustness.campaign import Attack, Attempt

DOMAINS = {"warehouse-even": "@", "warehouse-uneven": "@", "manufacturing": "012"}  # and obstacles
LARGE = 0.01  # share of layouts of the size of a search, the others being small
TINY = 24  # cells that may change, up to which the exact program is decided at once
SMALL = 60  # the same, within its limits, often
REFUTED = 200  # the same, up to which the relaxation is solved
NODES, SOLVES = 100, 20  # limits of the exact program: nodes of a solve, solves with more cuts
POLISHES: tuple[Polish, ...] = ("none", "quick", "full")
MOVES = 300  # annealing moves per cell of the longest repairs
Verdict = Literal["found", "none", "unknown"]


class Task(NamedTuple):
    """A layout to repair."""

    name: str  # domain, size and number of obstacles
    layout: np.ndarray  # int8 [H, W]
    rules: Rules


def draw_task(rng: np.random.Generator) -> Task:
    """Draw a domain, a size, rules and a layout that may break them everywhere."""
    kind = str(rng.choice(list(DOMAINS)))
    frame = 0 if kind == "manufacturing" else 4
    rows, cols = (int(rng.integers(3, rng.choice([6, 10, 18]))) for _ in range(2))
    shape = (33, 36) if rng.random() < LARGE else (rows, cols + frame + 1)
    own_rules = qdenv.find_domain(kind).resized(*shape).rules
    assert own_rules is not None
    rules = draw_rules(rng, own_rules(), DOMAINS[kind])
    odds = rng.dirichlet(np.ones(len(rules.tiles)))
    layout = rng.choice(len(rules.tiles), shape, p=odds)
    fixed = rules.allowed.sum(-1) == 1
    layout = np.where(fixed, rules.allowed.argmax(-1), layout).astype(np.int8)
    name = f"{kind} {shape[0]} x {shape[1]}, {rules.counts}, {rules.covers}"
    return Task(name, layout, rules)


def draw_rules(rng: np.random.Generator, rules: Rules, obstacles: str) -> Rules:
    """Change the numbers of obstacles, and now and then aisles, racks and fixed cells."""
    tiles = [rules.tiles.index(tile) for tile in obstacles]
    places = int(rules.allowed[..., tiles].any(-1).sum())
    low, high = ((0.05, 0.5), (0.5, 0.75), (0.05, 1.1))[rng.choice(3, p=[0.35, 0.5, 0.15])]
    number = round(rng.uniform(low, high) * places)
    counts: tuple[Count, ...] = (Count(obstacles, number, None if rng.random() < 0.2 else number),)
    if len(obstacles) > 1 and rng.random() < 0.5:
        counts += tuple(Count(tile, int(rng.integers(0, 4))) for tile in obstacles)
    allowed = rules.allowed.copy()
    if rng.random() < 0.2:
        cells = rng.permutation(np.argwhere(allowed.sum(-1) > 1))[: rng.integers(1, 4)]
        for row, col in cells:
            tile = rng.choice(np.flatnonzero(allowed[row, col]))
            allowed[row, col] = np.arange(allowed.shape[-1]) == tile
    aisle = 2 if rng.random() < 0.08 else 1
    rack = (int(rng.integers(1, 3)), int(rng.integers(2, 5))) if rng.random() < 0.08 else None
    return rules._replace(counts=counts, allowed=allowed).buildable(aisle, rack, of=obstacles)


def attempt(rng: np.random.Generator, folder: Path) -> Attempt:
    """Repair one layout and check the result."""
    task = draw_task(rng)
    polish = POLISHES[rng.choice(3, p=[0.5, 0.4, 0.1])]
    config = RepairConfig(polish, moves_per_cell=MOVES if polish == "full" else None)
    repair = repair_layout(task.layout, task.rules, int(rng.integers(1 << 30)), config)
    status, cost, layout = RepairStatus(int(repair.status)), float(repair.cost), repair.layout
    facts, faults = Facts(task.rules), []
    if status < RepairStatus.IMPOSSIBLE:
        faults += faults_of(task, np.asarray(layout), cost, float(repair.lower_bound))
        if facts.free_cells <= REFUTED:
            relaxed = solve_relaxation(build_free(facts, spanned=True))
            if relaxed.getModelStatus() == highspy.HighsModelStatus.kInfeasible:
                faults.append("a layout was found although the relaxation has none")
    elif not np.array_equal(layout, task.layout):
        faults.append(f"{status.name}, but the layout was changed")
    notes = {status.name: 1}
    if facts.free_cells <= (SMALL if status == RepairStatus.FAILED else TINY):
        verdict, least = solve_exactly(task.layout, facts)
        notes["decided by the exact program"] = int(verdict != "unknown")
        faults += contradictions(status, cost, verdict, least)
    return Attempt(1, [f"{task.name}: {fault}" for fault in faults], notes)


def faults_of(task: Task, layout: np.ndarray, cost: float, bound: float) -> list[str]:
    """Return what is wrong with a repaired layout, its cost and its lower bound."""
    faults = [f"infeasible: {broken.message}" for broken in qdenv.audit(layout, task.rules)]
    paid = float((task.rules.change_cost * (layout != task.layout)).sum())
    if abs(paid - cost) > 1e-4 * max(paid, 1):
        faults.append(f"cost {cost} is reported, the changes cost {paid}")
    if bound > cost + 1e-3:
        faults.append(f"lower bound {bound} exceeds cost {cost}")
    return faults


def contradictions(status: RepairStatus, cost: float, verdict: Verdict, least: float) -> list[str]:
    """Return how the exact program (its verdict and least cost) contradicts a status and cost."""
    if verdict == "unknown":
        return []
    if status == RepairStatus.OPTIMAL and verdict == "found" and abs(cost - least) > 1e-3:
        return [f"{cost} is called optimal, the exact program finds {least}"]
    if status < RepairStatus.IMPOSSIBLE:
        wrong = verdict == "none" or cost < least - 1e-3
        return [f"cost {cost}, the exact program: {verdict}, {least}"] * wrong
    if verdict == "found" or status == RepairStatus.FAILED:
        return [f"{status.name}, the exact program: {verdict}"]
    return []


def solve_exactly(layout: np.ndarray, facts: Facts) -> tuple[Verdict, float]:
    """Solve the plain program, with cuts while the solution is not connected; return its cost."""
    program = build(layout, facts)
    solver = load(new_solver(0), program)
    solver.setOptionValue("mip_max_nodes", NODES)
    for _ in range(SOLVES):
        solver.run()
        status = solver.getModelStatus()
        if status == highspy.HighsModelStatus.kInfeasible:
            return "none", np.inf
        if status != highspy.HighsModelStatus.kOptimal:
            break
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
