"""The rules of the negotiated planner: both backends compute the same, and it is what they say."""

import inspect

import jax.numpy as jnp
import numba
import numpy as np
import pytest

from qdenv.grid import UP
from qdenv.simulation.mapf.negotiated import rules
from qdenv.simulation.mapf.planner import move_of

CASES = 40
SIDE, LEVELS = 21, 3
# What each rule is given: truths, numbers from a range, or a constant.
TRUTH = "truth"
CELL, TIME = range(60 * 60), range(31)
GIVEN = {
    move_of: (range(-60, 61), 57),
    rules.random_rank: (range(1 << 31), range(2)),
    rules.find_in_window: (CELL, CELL, 57, 10),
    rules.ends_leg: (1, range(2)),
    rules.units: (TRUTH,),
    rules.driving_end: (1, 2, LEVELS, range(SIDE), range(SIDE), SIDE),
    rules.serving_end: (1, 2, LEVELS, TIME, SIDE),
    rules.unpack_end: (range(2 * LEVELS * (SIDE**2 + 32)), LEVELS, SIDE),
    rules.service_conflict: (range(3), TRUTH, TRUTH),
    rules.move_at: (3, range(2)),
    rules.cell_before: (range(SIDE), range(SIDE), UP),
    rules.is_predecessor: (TRUTH,) * 4,
}


def draw(rng: np.random.Generator, kind) -> tuple:
    """Draw an argument: arrays for jnp, and the same numbers one by one for numba."""
    if isinstance(kind, int):
        return kind, [kind] * CASES
    if kind == TRUTH:
        truths = rng.integers(0, 2, CASES)
        return jnp.asarray(truths, bool), truths.tolist()
    numbers = rng.integers(kind.start, kind.stop, CASES)
    return jnp.asarray(numbers, jnp.int32), numbers.tolist()


def parts(result) -> list:
    return list(result) if isinstance(result, tuple) else [result]


@pytest.mark.parametrize("rule", GIVEN, ids=lambda rule: rule.__name__)
def test_traced_and_compiled_rules_agree(rule):
    drawn = [draw(np.random.default_rng(len(rule.__name__)), kind) for kind in GIVEN[rule]]
    arrays = [argument[0] for argument in drawn]
    kernel = numba.njit(lambda *given: rule(*given))
    traced = [np.broadcast_to(np.asarray(part), CASES) for part in parts(rule(*arrays))]
    for index, given in enumerate(zip(*(argument[1] for argument in drawn), strict=True)):
        for one, many in zip(parts(kernel(*given)), traced, strict=True):
            assert int(one) & 0xFFFFFFFF == int(many[index]) & 0xFFFFFFFF


def test_every_rule_is_tried():
    found = {
        function
        for _, function in inspect.getmembers(rules, inspect.isfunction)
        if function.__module__ == rules.__name__
    }
    assert found == set(GIVEN) - {move_of}  # which all planners share


def test_every_end_has_a_code_of_its_own_that_is_read_back():
    codes = set()
    for leg in range(rules.LEGS):
        for conflicts in range(LEVELS):
            for row, column in np.ndindex(SIDE, SIDE):
                code = rules.driving_end(leg, conflicts, LEVELS, row, column, SIDE)
                codes.add(code)
                assert rules.unpack_end(code, LEVELS, SIDE) == (leg, conflicts, row, column, -1)
            for elapsed in range(rules.SERVED_BITS):
                code = rules.serving_end(leg, conflicts, LEVELS, elapsed, SIDE)
                codes.add(code)
                state = rules.unpack_end(code, LEVELS, SIDE)
                assert (state.leg, state.conflicts, state.elapsed) == (leg, conflicts, elapsed)
    assert len(codes) == rules.LEGS * LEVELS * (SIDE**2 + rules.SERVED_BITS)
    assert max(codes) <= rules.CODES


def test_moves_are_tried_in_one_of_two_orders_each_its_own_inverse():
    orders = [[rules.move_at(rank, flipped) for rank in range(5)] for flipped in (0, 1)]
    assert orders == [[0, 1, 2, 3, 4], [0, 4, 3, 2, 1]]


def test_a_move_and_its_plane_belong_together():
    changes = [0, 1, -1, 9, -9]
    assert [move_of(change, 9) for change in changes] == [0, 1, 2, 3, 4]
    before = [rules.cell_before(5, 5, move) for move in range(5)]
    assert [(5 - row) * 9 + 5 - column for row, column in before] == changes
