"""The archives: cells, the batch rule, degenerate batches, and what qdax makes of them."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from qdax.core.emitters.repertoire_selectors.uniform_selector import UniformSelector
from qdax.utils.metrics import default_qd_metrics
from scipy import stats

from qdenv.search.archive import GridArchive
from qdenv.types import InputError, Measure

GRID = (Measure("x", -1, 1, 4), Measure("y", 0, 3, 3))


def blank(*measures):
    return GridArchive.empty(np.zeros(1, np.float32), measures)


def pyribs_cells(measures, axes):
    """Compute cells in float64 by pyribs' formula."""
    index = np.zeros(len(measures), int)
    for column, axis in enumerate(axes):
        scaled = axis.cells * (measures[:, column].astype(float) - axis.low) + 1e-6
        along = np.clip(np.trunc(scaled / (axis.high - axis.low)), 0, axis.cells - 1)
        index = index * axis.cells + along.astype(int)
    return index


@jax.jit
def insert(archive, *batch):
    return archive.insert(*batch)


def add(archive, objective, measures, success=True, **extras):
    """Insert rows whose solutions are their own numbers, filled up to ten rows with failures."""
    rows = len(objective)

    def fill(values, with_value=0):
        padding = np.full((10 - rows, *np.shape(values)[1:]), with_value)
        return np.concatenate([np.asarray(values), padding.astype(np.asarray(values).dtype)])

    batch = (
        np.arange(10, dtype=np.float32)[:, None],
        fill(np.asarray(objective, np.float32)),
        fill(np.asarray(measures, np.float32)),
        {name: fill(values) for name, values in extras.items()},
        fill(np.broadcast_to(success, rows), False),
    )
    archive, insertion = insert(archive, *batch)
    return archive, jax.tree.map(lambda leaf: leaf[:rows], insertion)


@pytest.mark.parametrize(
    "axis",
    [
        Measure("shelf components", 140, 240, 100),
        Measure("workstations", 0, 600, 100),
        Measure("walls", 0, 256, 256),
        Measure("path length", 0, 648, 162),
    ],
)
def test_every_integer_falls_where_pyribs_puts_it(axis):
    integers = np.arange(axis.low - 50, axis.high + 50, dtype=np.float32)[:, None]
    for dtype in (np.float32, np.int32):
        got = jax.jit(blank(axis).cells_of)(integers.astype(dtype))
        np.testing.assert_array_equal(got, pyribs_cells(integers, (axis,)))


def test_random_measures_in_float32_fall_where_pyribs_puts_them():
    axes = (Measure("entropy", 0, 1, 100), Measure("path length", 0, 648, 162))
    rng = np.random.default_rng(0)
    measures = rng.uniform((-0.1, -9), (1.1, 700), (200_000, 2)).astype(np.float32)
    edges = np.arange(101, dtype=np.float32) / 100  # and right on the edges
    measures[:101, 0] = edges
    got = jax.jit(blank(*axes).cells_of)(measures)
    np.testing.assert_array_equal(got, pyribs_cells(measures, axes))


def test_huge_and_infinite_measures_land_on_the_rim():
    measures = np.array([[1e30, -1e30], [np.inf, -np.inf], [-np.inf, np.inf]], np.float32)
    assert blank(*GRID).cells_of(measures).tolist() == [9, 9, 2]


@pytest.mark.parametrize(
    ("count", "expected"), [(1, 2.5), (2, 4.125), (5, 5.328125), (10, 5.494629)]
)
def test_threshold_after_k_solutions_in_one_cell(count, expected):
    # t' = 0.5^k 0 + mean (1 - 0.5^k), the mean of 1..10 (5 alone) being 5.5
    objective = np.linspace(1, 10, count) if count > 1 else np.array([5.0])
    for order in (objective, objective[::-1]):
        archive = GridArchive.empty(np.zeros(1, np.float32), GRID, None, 0.5, 0.0)
        archive, _ = add(archive, order, np.zeros((count, 2)))
        np.testing.assert_allclose(archive.thresholds.max(), expected, rtol=1e-6)


@pytest.mark.parametrize("rate", [0.0, 0.1, 1.0])
@pytest.mark.parametrize("sign", [1, -1])
def test_thresholds_stay_numbers_next_to_the_largest_number(rate, sign):
    largest = float(np.finfo(np.float32).max)
    objective = sign * np.array([3e38, 3.1e38, 3.2e38, *[largest] * 6], np.float32)
    archive = GridArchive.empty(np.zeros(1, np.float32), GRID, None, rate, -largest)
    archive, _ = add(archive, objective, np.zeros((9, 2)))
    # float64 has room for what overflows; -largest is no improvement and does not count.
    accepted = objective[objective > -largest].astype(float)
    kept = (1 - rate) ** len(accepted)
    expected = kept * -largest + (1 - kept) * accepted.mean()
    cell = int(archive.objectives.argmax())
    np.testing.assert_allclose(archive.thresholds[cell], expected, rtol=1e-6, atol=1e32)
    better = np.nextafter(archive.thresholds[cell], np.float32(np.inf))
    if np.isfinite(better):
        assert add(archive, [better], [[0.0, 0.0]])[1].status.tolist() == [1]


def test_a_soft_archive_keeps_what_beats_the_threshold_and_the_result_archive_the_best():
    soft = GridArchive.empty(np.zeros(1, np.float32), GRID, None, 0.1, 0.0)
    hard = GridArchive.empty(np.zeros(1, np.float32), GRID)
    for objective in (10.0, 2.0, 0.5):
        soft, insertion = add(soft, [objective], [[0.0, 0.0]])
        hard, _ = add(hard, [objective], [[0.0, 0.0]])
    # thresholds: 1, then 0.9 * 1 + 0.1 * 2 = 1.1, which 0.5 does not exceed
    assert insertion.status.tolist() == [0]
    np.testing.assert_allclose(insertion.value, [-0.6], rtol=1e-6)
    assert (float(soft.objectives.max()), float(hard.objectives.max())) == (2.0, 10.0)


def test_ties_go_to_the_first_and_extras_follow_their_elite():
    archive = GridArchive.empty(
        np.zeros(1, np.float32), GRID, {"layout": np.zeros((2, 2), np.int8)}
    )
    layouts = np.arange(12, dtype=np.int8).reshape(3, 2, 2)
    archive, insertion = add(archive, [1.0, 3.0, 3.0], np.zeros((3, 2)), layout=layouts)
    assert insertion.status.tolist() == [2, 2, 2]
    cell = int(archive.objectives.argmax())
    assert float(archive.genotypes[cell, 0]) == 1.0
    np.testing.assert_array_equal(archive.extra_scores["layout"][cell], layouts[1])
    assert archive.extra_scores["layout"].dtype == jnp.int8
    with pytest.raises(InputError, match="layout"):
        add(archive, [1.0], np.zeros((1, 2)))


@pytest.mark.parametrize("wrap", [jax.jit, lambda function: function], ids=["jit", "plain"])
def test_one_batch_into_a_soft_archive_by_hand(wrap):
    # Two cells. In the first, 4 and 2 beat the threshold 1 and raise it with a = 0.5 to
    # 0.25 * 1 + 0.75 * 3 = 2.5; 1 does not beat it. In the second, -5 fails.
    archive = GridArchive.empty(np.zeros(1, np.float32), (Measure("x", 0, 2, 2),), None, 0.5, 1.0)
    batch = (
        np.arange(4, dtype=np.float32)[:, None],
        np.array([2, 4, 1, -5], np.float32),
        np.array([[0.1], [0.2], [0.9], [1.5]], np.float32),
    )
    archive, insertion = wrap(lambda archive, *batch: archive.insert(*batch))(archive, *batch)
    assert insertion.status.tolist() == [2, 2, 0, 0]
    assert insertion.value.tolist() == [1, 3, 0, -6]
    assert archive.thresholds.tolist() == [2.5, 1]
    assert archive.objectives.tolist() == [4, -np.inf]
    assert archive.genotypes[0].tolist() == [1]
    assert float(archive.qd_score) == 4 and float(archive.coverage) == 0.5


@pytest.mark.parametrize("soft", [False, True])
def test_rows_that_failed_or_are_not_finite_enter_nothing(soft):
    archive = GridArchive.empty(np.zeros(1, np.float32), GRID, None, *((0.5, 0.0) if soft else ()))
    objective = np.array([np.nan, np.inf, -np.inf, 5.0, 5.0, 5.0, 1.0], np.float32)
    measures = np.zeros((7, 2), np.float32)
    measures[3, 0], measures[4, 1] = np.nan, np.inf
    success = np.array([True] * 5 + [False, True])
    filled, insertion = add(archive, objective, measures, success)
    assert insertion.status.tolist() == [0, 0, 0, 0, 0, 0, 2]
    assert np.isneginf(insertion.value[:6]).all() and float(insertion.value[6]) == 1.0
    assert float(filled.qd_score) == 1.0 and int(filled.filled.sum()) == 1
    alone, _ = add(archive, objective[6:], measures[6:])
    alone = alone.replace(genotypes=filled.genotypes)  # solutions are named by their row
    jax.tree.map(np.testing.assert_array_equal, filled, alone)
    nothing, _ = add(archive, objective, measures, np.zeros(7, bool))
    jax.tree.map(np.testing.assert_array_equal, nothing, archive)


def test_scores_and_samples_of_an_empty_archive_are_defined():
    archive = GridArchive.empty(np.zeros(3, np.float32), GRID)
    numbers = archive.qd_score, archive.coverage, archive.objectives.argmax()
    assert [float(number) for number in numbers] == [0, 0, 0]
    key = jax.random.key(0)
    assert archive.sample_solutions(key, 2, jnp.full(3, 7.0)).tolist() == [[7.0] * 3] * 2


def test_elites_are_sampled_uniformly():
    archive = GridArchive.empty(np.zeros(1, np.float32), GRID)
    measures = np.array([[-1, 0], [-1, 2.9], [0.1, 1.5], [1, 0], [1, 2.9]])
    archive, _ = add(archive, np.arange(5.0), measures)
    drawn = archive.sample_solutions(jax.random.key(1), 10_000, jnp.zeros(1))
    counts = np.bincount(np.asarray(drawn)[:, 0].astype(int), minlength=5)
    assert len(counts) == 5 and stats.chisquare(counts).pvalue > 0.001


@pytest.mark.slow
def test_qdax_metrics_and_selectors_accept_the_archive():
    archive = GridArchive.empty(np.zeros(1, np.float32), GRID)
    archive, _ = add(archive, [1.0, 2.5, 4.0], [[-1, 0], [0, 1.5], [0, 1.5]])
    metrics = default_qd_metrics(archive, qd_offset=0.0)
    assert [float(metrics[name]) for name in ("qd_score", "max_fitness")] == [5.0, 4.0]
    assert float(metrics["qd_score"]) == float(archive.qd_score)
    np.testing.assert_allclose(metrics["coverage"], 100 * archive.coverage)
    assert float(archive.qd_score + archive.filled.sum()) == float(
        default_qd_metrics(archive, 1.0)["qd_score"]
    )
    assert repr(archive).startswith("GridArchive(") and len(repr(archive)) < 80
    chosen = archive.select(jax.random.key(0), 6, UniformSelector())
    assert set(np.asarray(chosen.genotypes).ravel().tolist()) <= {0.0, 2.0}
    again = archive.add(np.ones((1, 1)), np.array([[1.0, 0.0]]), np.array([9.0]))
    assert type(again) is GridArchive and again.measures == archive.measures


def test_centroids_lie_in_their_own_cells_row_major():
    archive = GridArchive.empty(np.zeros(1, np.float32), GRID)
    assert archive.cells_of(archive.centroids).tolist() == list(range(12))
    np.testing.assert_allclose(archive.centroids[1], [-0.75, 1.5])


@pytest.mark.parametrize(
    ("measures", "rates", "message"),
    [
        ((), (), "at least one measure"),
        ((Measure("x", 0, 1, 2**60),) * 300, (), "300 measures: give 16 at most"),
        ((Measure("x", 1, 1, 4),), (), "'x'"),
        ((Measure("x", 0, np.nan, 4),), (), "'x'"),
        ((Measure("x", 0, 1, 0),), (), "one cell"),
        (GRID, (1.5, 0.0), "learning-rate must be at most 1"),
        (GRID, (0.5, -np.inf), "learning rate of 1"),
        (GRID, (0.5, np.nan), "threshold_min"),
    ],
)
def test_bad_settings_give_one_clear_line(measures, rates, message):
    with pytest.raises(InputError, match=message):
        GridArchive.empty(np.zeros(1), measures, None, *rates)
