"""Sentences of the results page, computed again from the saved files that they are about."""

import csv
from pathlib import Path

import numpy as np
import pytest

EXPERIMENTS = Path(__file__).parents[1] / "experiments"
PAGE = " ".join((EXPERIMENTS / "README.md").read_text().split())
RUNS = EXPERIMENTS / "results" / "runs"
WAREHOUSES = sorted(path.name for path in RUNS.iterdir() if path.name.startswith("warehouse"))


def rows(run: str, table: str) -> list[dict[str, str]]:
    with (RUNS / run / table).open() as lines:
        return list(csv.DictReader(lines))


def numbers(run: str, column: str, table: str = "elites.csv") -> np.ndarray:
    return np.array([float(row[column]) for row in rows(run, table)])


def score_after(run: str, evaluations: int) -> float:
    done = numbers(run, "evaluations", "metrics.csv") == evaluations
    return float(numbers(run, "qd_score", "metrics.csv")[done][0])


# The published means of Table 4 stand beside ours.
@pytest.mark.parametrize("run", sorted(path.name for path in RUNS.iterdir()))
def test_a_scores_sum_is_what_its_elites_have(run):
    last = rows(run, "metrics.csv")[-1]
    assert numbers(run, "objective").sum() == pytest.approx(float(last["qd_score"]), abs=0.05)


@pytest.mark.parametrize("run", ["warehouse-even", "warehouse-even-map-elites", "warehouse-uneven"])
def test_the_page_states_score_and_best_of_the_archive(run):
    objective = numbers(run, "objective")
    assert f"QD-score {objective.sum():,.0f}" in PAGE
    best = f"{objective.max():.3f}".rstrip("0")
    assert f"best moves {best}" in PAGE


def test_what_would_double_a_score():
    even, uneven = numbers("warehouse-even", "objective"), numbers("warehouse-uneven", "objective")
    for objective, name in ((even, "even"), (uneven, "uneven")):
        share = f"{100 * objective.mean() / objective.max():.0f} % (`warehouse-{name}`)"
        assert share in PAGE.replace("moves ", "")
    cells = {row["cell"] for run in WAREHOUSES for row in rows(run, "elites.csv")}
    assert f"runs of warehouses reached are {len(cells):,} of 10,000" in PAGE
    reach = len(cells) * even.mean()
    assert f"would be {round(reach, -2):,.0f}, a third more" in PAGE
    assert 1.28 < reach / even.sum() < 1.38
    stations = numbers("manufacturing", "workstations")
    objective, success = numbers("manufacturing", "objective"), numbers("manufacturing", "success")
    some, many = (stations >= 60) & (stations < 300), stations > 350
    assert f"{some.sum()} elites with 60 to 300 workstations hold" in PAGE
    assert f"hold {objective[some].sum():,.0f} of the {objective.sum():,.0f}" in PAGE
    assert f"{many.sum()} with more than 350 hold {objective[many].sum():.0f}, because" in PAGE
    jams = f"{(success[many] == 0).mean() * 100:.0f} % of them jam in all five runs"
    assert f"{jams} ({(success[many] < 1).mean() * 100:.0f} % in one of five at least)" in PAGE


def test_scores_half_way_and_early():
    assert f"had brought {score_after('warehouse-even', 5000):,.0f}" in PAGE
    early = [score_after("warehouse-even", number) for number in (1000, 1400)]
    assert "this run had {:,.0f} and {:,.0f}".format(*early) in PAGE
    notes = " ".join(
        (EXPERIMENTS.parent / "notebooks" / "reference" / "notes.md").read_text().split()
    )
    others = [f"warehouse-even{end}" for end in ("", "-cma-es", "-map-elites", "-dsage")]
    scores = [score_after(run, 1000) for run in others]
    sentence = "of {:,.0f}, CMA-ES {:,.0f}, MAP-Elites {:,.0f}, DSAGE (`dsage-laptop`) {:,.0f}"
    assert sentence.format(*scores) in notes


def test_the_archives_over_alpha():
    for alpha, run in ((0, "warehouse-even-a0"), (1, "warehouse-even-a1"), (5, "warehouse-even")):
        objective, changed = numbers(run, "objective"), numbers(run, "changed")
        entropy, best = numbers(run, "environment entropy"), int(objective.argmax())
        cells = [
            f"{alpha}",
            f"{objective.sum():,.0f}",
            f"{len(objective):,}",
            f"{(entropy < 0.5).sum()}",
            f"{objective.mean():.2f}",
            f"{objective[best]:.3f}",
            f"{changed.mean():.0f}",
            f"{changed[best]:.0f}",
        ]
        assert f"| {' | '.join(cells)} |" in PAGE


def test_the_planners_effort_over_the_elites_that_were_compared():
    with (EXPERIMENTS / "results" / "agreement.csv").open() as lines:
        table = [row for row in csv.DictReader(lines) if row["layout"].startswith("elite")]
    low, high, paper = (
        np.array([float(row[name]) for row in table]) for name in ("low", "high", "published")
    )
    calm = np.array(
        [
            {row[f"{name}_congested"] for name in ("low", "high", "published")} == {"0"}
            for row in table
        ]
    )
    flowing = np.array([row["low_congested"] == "0" for row in table])
    assert f"Of {len(table)} elites of another run" in PAGE
    assert f"{calm.sum()} never jam; these move" in PAGE
    gain = 100 * (high[calm].sum() / low[calm].sum() - 1)
    assert f"these move {gain:.1f} % more under high effort" in PAGE
    ratios = [paper[group].sum() / low[group].sum() for group in (flowing | True, flowing)]
    assert [round(100 * (1 - ratio), 1) for ratio in ratios] == [1.0, 0.1]
