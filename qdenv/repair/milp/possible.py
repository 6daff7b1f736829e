"""What the rules alone allow, whatever layout came in: a layout that obeys them, or proof of none.

Asked where annealing found nothing. The relaxation with a spanning tree in it (`spanning`) refutes
most of what is impossible at any size; small programs are decided by branch and cut, larger layouts
are packed (`anneal.packing`).
"""

import threading
from collections import OrderedDict
from typing import NamedTuple

import highspy
import numpy as np

from qdenv.repair.anneal.packing import pack
from qdenv.repair.audit import audit
from qdenv.repair.facts import Facts
from qdenv.repair.milp.cuts import separate
from qdenv.repair.milp.highs import add_cuts, load, read_values, solve_relaxation
from qdenv.repair.milp.improve import mend, read_layout
from qdenv.repair.milp.program import Program, build
from qdenv.repair.milp.spanning import span
from qdenv.repair.result import Report, no_report
from qdenv.types import RepairStatus, Rules

MAX_CELLS = 20_000  # that may change: beyond, the relaxation alone takes minutes
BRANCHED_CELLS = 120  # that may change: with more, branching decides little
NODES = 2000  # of one solve
ASKED = 2000  # times one solve may ask whether to go on
ROUNDS = 40  # solves, each with more connectivity cuts
REMEMBERED = 32  # rules whose answer is kept


class Possible(NamedTuple):
    """What is known of some rules."""

    # `ANNEALED` where a layout is known, `IMPOSSIBLE` where none exists, else `FAILED`
    status: RepairStatus
    layout: np.ndarray | None = None  # int8 [H, W], obeys every rule; None where none is known


IMPOSSIBLE, UNKNOWN = Possible(RepairStatus.IMPOSSIBLE), Possible(RepairStatus.FAILED)

_answers: OrderedDict[bytes, Possible] = OrderedDict()
_lock = threading.Lock()


def find_possible(facts: Facts, report: Report = no_report) -> Possible:
    """Find a layout that obeys the rules, or prove that there is none; both may fail.

    The answer follows from the rules alone and is remembered: a batch pays for it once.

    Args:
        facts: the constraints.
        report: told what is being done, and from 0 to 1 how much of it is.
    """
    key = _key_of(facts.rules)
    with _lock:
        if key not in _answers:
            _answers[key] = _decide(facts, report)
            while len(_answers) > REMEMBERED:
                _answers.popitem(last=False)
        return _answers[key]


def _key_of(rules: Rules) -> bytes:
    """Name rules by their content, costs left out."""
    words = (rules.tiles, rules.counts, rules.adjacency, rules.connected, rules.aisle)
    return repr((words, rules.allowed.shape)).encode() + np.packbits(rules.allowed).tobytes()


def _decide(facts: Facts, report: Report) -> Possible:
    """Ask the relaxation, then the solver or the packer."""
    if facts.free_cells > MAX_CELLS:
        return UNKNOWN
    report("asking whether any layout exists", 0.0)
    if is_refuted(facts):
        return IMPOSSIBLE
    if facts.free_cells <= BRANCHED_CELLS:
        return _branch(facts)
    layout = pack(facts, report)
    return UNKNOWN if layout is None else Possible(RepairStatus.ANNEALED, layout)


def _any_layout(facts: Facts) -> np.ndarray:
    """Give a layout to count changes from, which cost nothing here (int8 [H, W])."""
    layout: np.ndarray = facts.rules.allowed.argmax(-1).astype(np.int8)
    return layout


def _state(facts: Facts) -> Program:
    """State the rules, all layouts alike."""
    program = build(_any_layout(facts), facts)
    return program._replace(cost=np.zeros_like(program.cost), constant=0.0)


def is_refuted(facts: Facts) -> bool:
    """Tell whether not even the relaxation has a solution: then no layout obeys the rules."""
    solver = solve_relaxation(span(_state(facts), facts))
    return bool(solver.getModelStatus() == highspy.HighsModelStatus.kInfeasible)


def _branch(facts: Facts) -> Possible:
    """Solve with more and more connectivity cuts, until a layout obeys every rule or none can."""
    program, layout, rng = _state(facts), _any_layout(facts), np.random.default_rng(0)
    if facts.rules.aisle <= 1:  # wide aisles say more than a tree, which takes ten times as long
        program = span(program, facts)
    solver = load(program, 0)
    solver.setOptionValue("mip_max_nodes", NODES)
    for _ in range(ROUNDS):
        _run_limited(solver)
        status = solver.getModelStatus()
        if status == highspy.HighsModelStatus.kInfeasible:
            return IMPOSSIBLE
        if status != highspy.HighsModelStatus.kOptimal:
            break
        values = read_values(solver)[: program.variables.total]
        found = read_layout(program, values, layout, facts, rng)
        cuts = separate(facts.driving[found], facts.must(facts.rules.connected))
        for candidate in (found, mend(found, found, facts, rng)):
            if not audit(candidate, facts.rules):
                return Possible(RepairStatus.ANNEALED, candidate)
        if not cuts:
            break
        add_cuts(solver, program, facts, cuts)
    return UNKNOWN


def _run_limited(solver: highspy.Highs) -> None:
    """Solve until the solver has asked often enough whether to go on: the same on any machine."""
    asked = [0]

    def count(event: highspy.HighsCallbackEvent) -> None:
        asked[0] += 1
        event.interrupt(asked[0] > ASKED)

    solver.cbMipInterrupt.subscribe(count)
    solver.run()
    solver.cbMipInterrupt.unsubscribe(count)
