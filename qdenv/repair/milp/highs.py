"""HiGHS on the repair program: load it, bound it, solve it, add cuts.

HiGHS: Huangfu and Hall 2018, https://doi.org/10.1007/s12532-017-0130-5, https://highs.dev.
"""

import highspy
import numpy as np

from qdenv.repair.facts import Facts
from qdenv.repair.milp.cuts import Cut
from qdenv.repair.milp.program import Program
from qdenv.repair.settings import MilpLimits
from qdenv.types import RepairStatus


def load(program: Program, seed: int) -> highspy.Highs:
    """Pass the program to a fresh single-threaded solver."""
    solver = highspy.Highs()
    options = {"output_flag": False, "threads": 1, "random_seed": seed % (1 << 31)}
    for name, value in options.items():
        solver.setOptionValue(name, value)
    model = highspy.HighsLp()
    model.num_col_, model.num_row_ = program.cost.size, program.low.size
    model.col_cost_, model.offset_ = program.cost, program.constant
    model.col_lower_, model.col_upper_ = np.zeros(program.cost.size), program.upper
    model.row_lower_, model.row_upper_ = program.low, program.high
    model.a_matrix_.format_ = highspy.MatrixFormat.kRowwise
    model.a_matrix_.start_ = program.rows.indptr.astype(np.int32)
    model.a_matrix_.index_ = program.rows.indices.astype(np.int32)
    model.a_matrix_.value_ = program.rows.data
    integer, real = highspy.HighsVarType.kInteger, highspy.HighsVarType.kContinuous
    model.integrality_ = [integer if whole else real for whole in program.integer]
    solver.passModel(model)
    return solver


def bound_relaxation(program: Program, facts: Facts) -> float:
    """Bound the cost from below by the linear relaxation."""
    solver = solve_relaxation(program)
    if solver.getModelStatus() != highspy.HighsModelStatus.kOptimal:
        return 0.0
    return _round_up(solver.getInfo().objective_function_value, facts)


def solve_relaxation(program: Program) -> highspy.Highs:
    """Solve the linear relaxation (interior point, no crossover)."""
    solver = load(program, 0)
    for name, value in {"solve_relaxation": True, "solver": "ipm", "run_crossover": "off"}.items():
        solver.setOptionValue(name, value)
    solver.run()
    return solver


def read_bound(solver: highspy.Highs, facts: Facts) -> float:
    """Read the lower bound on the cost that a solve has proven."""
    return _round_up(solver.getInfo().mip_dual_bound, facts)


def read_values(solver: highspy.Highs) -> np.ndarray:
    """Read the best solution of a solve (float64 [variables])."""
    return np.array(solver.getSolution().col_value)


def _round_up(bound: float, facts: Facts) -> float:
    """Round a bound up to the next possible cost, with care for solver tolerances."""
    slack = 1e-4 + 1e-6 * abs(bound)
    return float(np.ceil(bound - slack)) if facts.whole_costs else bound - slack


def solve(
    solver: highspy.Highs, start: np.ndarray, gap: float, seconds: float, limits: MilpLimits
) -> RepairStatus:
    """Run the solver from a start within its limits.

    Args:
        solver: what `load` made; keeps what it finds.
        start: float64 [variables], a feasible solution.
        gap: relative gap at which to stop.
        seconds: wall-clock safety net.
        limits: the deterministic limits.

    Returns:
        `OPTIMAL` (for the program as it stands), or which limit ended the run.
    """
    solver.setOptionValue("mip_rel_gap", gap)
    solver.setOptionValue("mip_max_nodes", limits.node_limit)
    solver.setOptionValue("time_limit", seconds)
    solution, asked = highspy.HighsSolution(), [0]
    solution.col_value = list(start)
    solver.setSolution(solution)

    def count(event: highspy.HighsCallbackEvent) -> None:
        # The solver asks at fixed points of its work: counting them stops it reproducibly, which
        # a time limit would not.
        asked[0] += 1
        event.interrupt(asked[0] > limits.interrupt_budget)

    solver.cbMipInterrupt.subscribe(count)
    solver.run()
    solver.cbMipInterrupt.unsubscribe(count)
    status = solver.getModelStatus()
    if status == highspy.HighsModelStatus.kOptimal:
        return RepairStatus.OPTIMAL
    timed_out = status == highspy.HighsModelStatus.kTimeLimit
    return RepairStatus.TIME_LIMIT if timed_out else RepairStatus.NODE_LIMIT


def add_cuts(solver: highspy.Highs, program: Program, facts: Facts, cuts: list[Cut]) -> None:
    """Add connectivity cuts as rows."""
    driving = program.variables.group(facts, facts.rules.connected)
    for cut in cuts:
        weights = np.zeros(driving.offset.size)
        weights[cut.ends], weights[cut.gates] = 1.0, -1.0
        row = driving.combined(weights)
        high = len(cut.ends) - 1 - row.offset[0]
        indices = row.matrix.indices.astype(np.int32)
        solver.addRow(-np.inf, high, indices.size, indices, row.matrix.data)
