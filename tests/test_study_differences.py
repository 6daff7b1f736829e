"""Differences in per cent: against scipy's test, against simulation, and where there are none."""

import numpy as np
import pytest
from scipy import stats

from qdenv.stats import Sample, difference, margin, paired_difference, sample_of, wilson_interval
from qdenv.study.table import Row, differences

NAN = float("nan")


def test_an_interval_excludes_zero_just_where_welchs_test_finds_a_difference():
    random = np.random.default_rng(0)
    verdicts = []
    for _ in range(300):
        ours = random.normal(6.0 + random.normal(0, 0.05), 0.03, 10)
        theirs = random.normal(6.0, 0.1, random.integers(2, 12))
        found = difference(sample_of(ours), sample_of(theirs))
        p_value = stats.ttest_ind(ours, theirs, equal_var=False).pvalue
        assert found.significant == (p_value < 0.05)
        assert found.significant == (not found.low <= 0 <= found.high)
        verdicts.append(found.significant)
    assert 30 < sum(verdicts) < 270


def test_a_paired_interval_excludes_zero_just_where_the_paired_t_test_finds_a_difference():
    random = np.random.default_rng(2)
    verdicts, narrower = [], 0
    for _ in range(300):
        common = random.normal(6.0, 0.3, random.integers(2, 12))
        ours, theirs = (common + random.normal(gain, 0.05, len(common)) for gain in (0.05, 0.0))
        found = paired_difference(ours, theirs)
        p_value = stats.ttest_rel(ours, theirs).pvalue
        assert found.significant == (p_value < 0.05) == (not found.low <= 0 <= found.high)
        verdicts.append(found.significant)
        alone = difference(sample_of(ours), sample_of(theirs))
        narrower += not found.high - found.low >= alone.high - alone.low  # NaN: it has none
    assert 30 < sum(verdicts) < 270 and narrower > 200
    assert np.isnan(paired_difference([5.0], [4.0]).low)
    same = [5.0, 5.1, 5.2]
    assert paired_difference(same, same)[:3] == pytest.approx((0, 0, 0), abs=1e-6)


def test_an_interval_agrees_with_the_closed_form_where_the_other_mean_is_known():
    """Without doubt in the denominator Fieller's interval is the mean's own t interval."""
    ours = np.array([5.5, 6.0, 6.2, 5.9])
    found = difference(sample_of(ours), Sample(5.0, 0.0, 10))
    wide = stats.t.ppf(0.975, 3) * ours.std(ddof=1) / 2
    expected = [100 * (end / 5.0 - 1) for end in (5.9 - wide, 5.9 + wide)]
    np.testing.assert_allclose((found.low, found.high), expected)
    assert found.percent == pytest.approx(18.0)


def test_an_interval_holds_the_true_ratio_in_95_of_100_studies():
    random = np.random.default_rng(1)
    held = 0
    for _ in range(2000):
        ours, theirs = random.normal(6.6, 0.3, 10), random.normal(6.0, 0.6, 10)
        found = difference(sample_of(ours), sample_of(theirs))
        held += found.low <= 10.0 <= found.high
    assert 0.935 < held / 2000 < 0.965


def test_the_margin_of_a_mean_is_scipys_t_interval():
    values = np.array([5.5, 6.0, 6.2, 5.9, 7.1])
    low, high = stats.t.interval(0.95, 4, values.mean(), stats.sem(values))
    assert margin(sample_of(values)) == pytest.approx((high - low) / 2)
    assert np.isnan(margin(sample_of(values[:1])))


def test_there_is_no_interval_where_nothing_can_be_said():
    one, some, none = Sample(5.0, NAN, 1), Sample(6.0, 0.1, 10), Sample(0.0, 0.0, 10)
    found = difference(one, some)
    assert found.percent == pytest.approx(-100 / 6) and np.isnan(found.low)
    assert not found.significant
    assert np.isnan(difference(some, none).percent)
    assert difference(none, some).significant and difference(none, some).percent == -100
    assert np.isnan(difference(some, Sample(0.1, 0.2, 10)).high)
    assert difference(Sample(5.0, 0.0, 3), Sample(4.0, 0.0, 3)) == (25.0, 25.0, 25.0, True)


def test_wilson_interval_agrees_with_published_values():
    """Newcombe 1998, method 3."""
    for case, ends in {
        (8, 10): (0.4902, 0.9433), (10, 10): (0.7225, 1.0), (0, 10): (0.0, 0.2775),
        (93, 100): (0.8625, 0.9657), (1, 1): (0.2065, 1.0),
    }.items():  # fmt: skip
        np.testing.assert_allclose(wilson_interval(*case), ends, atol=5e-5)


def test_rows_are_compared_with_the_first_layout_at_the_same_number_of_agents():
    def row(layout, agents, mean):
        return Row(layout, 9, 12, agents, 10, NAN, NAN, 0.0, 0.0, 0.3, mean, 0.1, 0.02)

    rows = [row("a", 50, 2.0), row("a", 100, 4.0), row("b", 50, 3.0), row("b", 100, 4.0)]
    found = differences(rows)
    assert [one.percent for one in found] == pytest.approx([0, 0, 50, 0])
    assert [one.significant for one in found] == [False, False, True, False]
    assert np.isnan(found[0].low) and found[3].low < 0 < found[3].high
