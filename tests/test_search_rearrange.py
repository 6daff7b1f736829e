"""The search around a plan: what a change does, that luck is no merit, the axis of racks moved."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from small_warehouse import ROWS, TILES

from qdenv.domains.base import find_domain, make_domain
from qdenv.generators import DirectConfig
from qdenv.grid import parse
from qdenv.run.config import RunConfig
from qdenv.run.experiment import make_experiment
from qdenv.search.base import Problem
from qdenv.search.rearrange import changed, rearrange
from qdenv.search.settings import RearrangeConfig
from qdenv.settings import EvaluationConfig
from qdenv.types import Encoding, InputError, Measure, Score

SHAPE = (9, 12)
PLAN = np.arange(108, dtype=np.int8).reshape(SHAPE) * 7 % 5  # tiles 3 and 4 stay


change = jax.jit(
    jax.vmap(lambda key, odds: changed(key, jnp.asarray(PLAN), 3, odds), in_axes=(0, None))
)


def problem(high=50.0, around=PLAN):
    axis = Measure("moved", 0, high, 10)
    encoding = Encoding(SHAPE, 5, repairs=True, choices=3, around=around)
    return Problem(PLAN.size, (axis,), {"repaired": np.zeros(SHAPE, np.int8)}, encoding)


@pytest.mark.parametrize("odds", np.eye(3), ids=["shifts", "copies", "trades"])
def test_a_change_leaves_what_stays_and_conserves_what_it_moves(odds):
    after = np.asarray(change(jax.random.split(jax.random.key(0), 100), jnp.asarray(odds)))
    stays = PLAN >= 3
    assert (after[:, stays] == PLAN[stays]).all() and (after[:, ~stays] < 3).all()
    assert (after != PLAN).any(axis=(1, 2)).mean() > 0.8
    if odds[2]:  # trades move tiles, and make none
        assert all((np.sort(one.ravel()) == np.sort(PLAN.ravel())).all() for one in after)


def drive(worth, iterations, **settings):
    """Run a search whose objective is a function of (layouts [B, H, W], random numbers)."""
    algorithm, rng = rearrange(RearrangeConfig(), problem(**settings)), np.random.default_rng(0)
    ask, tell = jax.jit(algorithm.ask), jax.jit(algorithm.tell)
    state = algorithm.init(jax.random.key(0))
    for _ in range(iterations):
        solutions, state = ask(state)
        layouts = np.asarray(solutions).reshape(-1, *SHAPE).astype(np.int8)
        value = worth(layouts, rng).astype(np.float32)
        measures = np.float32((layouts != PLAN).sum(axis=(1, 2)) / 2)[:, None]
        score = Score(value, value, measures, np.ones(len(value), bool))
        state = tell(state, solutions, score, {"repaired": layouts})
    return state, algorithm.archive(state)


@pytest.mark.slow
def test_a_noisy_search_climbs_and_its_archive_holds_means():
    """Ones in the left half are worth one each; the noise is as large as three of them."""

    def count(layouts):
        return (layouts[:, :, :6] == 1).sum(axis=(1, 2))

    def worth(layouts, rng):
        return count(layouts) + 3 * rng.standard_normal(len(layouts))

    state, archive = drive(worth, 60)
    members = np.asarray(state.emitters.tiles).reshape(-1, *SHAPE)
    before = int(count(PLAN[None])[0])
    assert count(members).mean() > before + 8
    # What the archive claims of its best is near the truth: no lucky evaluation counts alone.
    best = int(jnp.argmax(archive.objectives))
    true = count(np.asarray(archive.genotypes[best]).reshape(1, *SHAPE))[0]
    assert archive.objectives[best] == pytest.approx(true, abs=5)
    assert np.sqrt(float(state.emitters.noise)) == pytest.approx(3, abs=1)


def test_layouts_beyond_the_axis_are_no_members():
    state, archive = drive(lambda layouts, rng: 0 * layouts[:, 0, 0], 12, high=4.0)
    members = np.asarray(state.emitters.tiles).reshape(-1, *SHAPE)
    there = np.asarray(state.emitters.times) > 0
    assert ((members != PLAN).sum(axis=(1, 2)) / 2 < 4)[there].all() and archive.filled.any()


def test_the_axis_counts_racks_that_are_gone():
    settings = replace(find_domain("warehouse-even").config, rows=7, cols=11, shelves=8)
    domain = make_domain(replace(settings, around=tuple(ROWS)))
    (axis,) = domain.measures
    layout = parse(ROWS, TILES)
    racks = np.argwhere(layout == 1)
    moved = layout.copy()
    moved[tuple(racks[0])], moved[3, 5] = 0, 1
    assert [float(axis.value(one, None)) for one in (layout, moved)] == [0, 1]
    assert axis.name == "racks moved" and axis.cells == len(racks) + 1


def test_what_is_no_plan_is_refused():
    with pytest.raises(InputError, match="goes around a plan"):
        rearrange(RearrangeConfig(), problem(around=None))
    with pytest.raises(InputError, match="generator direct"):
        rearrange(RearrangeConfig(), problem()._replace(encoding=None))
    with pytest.raises(InputError, match=r"shifts and copies are 1.25 of the changes"):
        RearrangeConfig(shifts=1)


@pytest.mark.slow
def test_a_run_begins_with_the_plan_inside_its_frame():
    domain = replace(find_domain("warehouse-even").config, rows=7, cols=11, shelves=8)
    config = RunConfig(
        EvaluationConfig(replace(domain, around=tuple(ROWS)), DirectConfig()), RearrangeConfig()
    )
    experiment = make_experiment(config)
    begin = jax.jit(lambda key: experiment.algorithm.ask(experiment.algorithm.init(key))[0])
    solutions = begin(experiment.search_key)
    np.testing.assert_array_equal(experiment.pipeline.grow(solutions)[0], parse(ROWS, TILES))
