"""Sweeps over numbers of agents: what is read, what is counted, what is written."""

import csv
from pathlib import Path

import numpy as np
import pytest

from qdenv.grid import parse
from qdenv.simulate.mapf.fleet import FleetConfig
from qdenv.simulate.mapf.goals import tile_goal
from qdenv.simulate.mapf.pibt.settings import PibtConfig
from qdenv.stats import wilson_interval
from qdenv.study.options import parse_counts
from qdenv.study.table import Trial, compare, write_rows
from qdenv.types import InputError, TaskRule

TILES = ".@ew"
RULE = TaskRule(TILES, ".ew", (tile_goal("e", TILES), tile_goal("w", TILES)))


def test_numbers_of_agents_are_read():
    assert parse_counts("200") == (200,)
    assert parse_counts("50,100") == (50, 100)
    assert parse_counts("50:400:50") == tuple(range(50, 401, 50))
    for text in ("", "many", "0", "10:5", "1:2:3:4", "5:10:0"):
        with pytest.raises(InputError):
            parse_counts(text)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("1:99999999999", "choose a larger step"),
        (f"1:{10**30}", "choose a larger step"),
        ("1,1,1", "names a number twice"),
        ("-5,10", "no number of agents above zero"),
    ],
)
def test_numbers_that_make_no_study_are_refused_at_once(text, said):
    with pytest.raises(InputError, match=said):
        parse_counts(text)


def test_wilson_interval_agrees_with_published_values():
    """The bounds for 8 of 10 and for 10 of 10 (Newcombe 1998, method 3)."""
    np.testing.assert_allclose(wilson_interval(8, 10), (0.4902, 0.9433), atol=1e-4)
    np.testing.assert_allclose(wilson_interval(10, 10), (0.7225, 1.0), atol=1e-4)
    assert wilson_interval(0, 10)[0] == 0.0


def test_a_sweep_makes_a_table(tmp_path: Path):
    layout = parse(["w...e", ".@@..", "e...w"], TILES)
    config = FleetConfig(timesteps=40, planner=PibtConfig())
    rows = compare({"tiny": layout}, Trial(RULE, config, (1, 3, 6), (0, 1, 2)))
    assert [row.agents for row in rows] == [1, 3, 6]
    assert all(row.runs == 3 and 0 <= row.success_low <= row.success_rate for row in rows)
    # One agent alone needs at most six steps and at least two from one goal to the next.
    assert 40 / 6 - 1 <= 40 * rows[0].throughput <= 20
    write_rows(tmp_path / "sweep.csv", rows)
    read = list(csv.DictReader((tmp_path / "sweep.csv").read_text().splitlines()))
    written = [float(row["throughput"]) for row in read]
    assert written == pytest.approx([row.throughput for row in rows], rel=1e-5)
    assert all(len(row["throughput"]) <= 8 for row in read)  # six digits and no dust
    with pytest.raises(InputError, match="fewer agents"):
        compare({"tiny": layout}, Trial(RULE, config, (14,), (0,)))
