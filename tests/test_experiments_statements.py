"""Sentences of the results page and others, computed from the saved files that they are about."""

import csv
import json
import math
import re
from dataclasses import replace
from itertools import product
from pathlib import Path

import numpy as np
import pytest

from experiments.figure_19 import USAGE
from experiments.pieces import Folders
from experiments.polish import LEVELS, Row
from experiments.published import FLEETS, TABLE_4, TRAFFIC
from experiments.runs import run_of
from experiments.table_5 import TABLE
from qdenv.domains.base import find_domain
from qdenv.generators import GENERATORS
from qdenv.grid import checksum, parse
from qdenv.io.records import read_table
from qdenv.shipped import named
from qdenv.simulation.mapf.settings import FleetConfig, PibtConfig
from qdenv.stats import margin, paired_difference, sample_of
from qdenv.study.engine import run_seeds
from qdenv.study.plans import read_plan

EXPERIMENTS = Path(__file__).parents[1] / "experiments"
RESULTS = EXPERIMENTS / "results"
RUNS = RESULTS / "runs"


def page(path: str) -> str:
    return " ".join((EXPERIMENTS.parent / path).read_text().split())


SEEDS = ("", "-seed1", "-seed2")  # ends of the names of CMA-MAE's runs of fleets
PAGE, NOTES = page("experiments/README.md"), page("notebooks/reference/notes.md")


def rows(path: str, **wanted: str) -> list[dict[str, str]]:
    with (RESULTS / path).open() as lines:
        found = list(csv.DictReader(lines))
    return [row for row in found if all(row[name] == value for name, value in wanted.items())]


def numbers(run: str, column: str, table: str = "elites.csv") -> np.ndarray:
    return np.array([float(row[column]) for row in rows(f"runs/{run}/{table}")])


def score_after(run: str, evaluations: int) -> float:
    done = numbers(run, "evaluations", "metrics.csv") == evaluations
    return float(numbers(run, "qd_score", "metrics.csv")[done][0])


def table(name: str) -> list[list[str]]:
    """Take the rows of a saved table apart."""
    lines = (RESULTS / f"{name}.md").read_text().splitlines()
    rows = [line.split("|")[1:-1] for line in lines if line.startswith("| ")][2:]
    return [[cell.strip() for cell in row] for row in rows]


def content(path: str) -> dict:
    return json.loads((RESULTS / f"{path}.json").read_text())


def layout(name: str) -> np.ndarray:
    return np.array([list(row) for row in content(f"layouts/{name}")["layout"]])


@pytest.mark.parametrize("run", sorted(path.name for path in RUNS.iterdir()))
def test_a_scores_sum_is_what_its_elites_have(run):
    last = rows(f"runs/{run}/metrics.csv")[-1]
    assert numbers(run, "objective").sum() == pytest.approx(float(last["qd_score"]), abs=0.05)


def test_every_saved_simulation_is_of_a_saved_layout():
    saved = {path.stem: content(f"layouts/{path.stem}") for path in RESULTS.glob("layouts/*.json")}
    for path in (RESULTS / "traffic").glob("*.csv"):
        of = {(row["layout"], row["domain"], row["tiles"]) for row in rows(f"traffic/{path.name}")}
        for name, domain, tiles in of:
            assert checksum(parse(saved[name]["layout"], find_domain(domain).tiles)) == tiles


def test_what_would_raise_the_scores():
    room = []
    for name in ("even", "uneven"):
        objective = numbers(f"warehouse-{name}", "objective")
        share = objective.mean() / objective.max()
        assert f"{100 * share:.0f} % (`warehouse-{name}`)" in PAGE
        room.append(f"{100 / share - 100:.0f}")
    assert f"as good as that one would add {' and '.join(room)} %" in PAGE
    stations = numbers("manufacturing", "workstations")
    objective, success = numbers("manufacturing", "objective"), numbers("manufacturing", "success")
    some, many = (stations >= 60) & (stations < 300), stations > 350
    assert f"{some.sum()} elites with 60 to 299 workstations hold" in PAGE
    assert f"hold {objective[some].sum():,.0f} of the {objective.sum():,.0f}" in PAGE
    assert f"{many.sum()} with more than 350 hold {objective[many].sum():.0f}." in PAGE
    jams = f"{(success[many] == 0).mean() * 100:.0f} % of these congest in all five runs"
    assert f"{jams} ({(success[many] < 1).mean() * 100:.0f} % in one of five at least)" in PAGE
    share = 100 * objective.mean() / objective.max()
    assert f"mean elite moves {share:.0f} % of what the best one moves:" in PAGE


def test_scores_half_way_and_early():
    for run in map("".join, product(FLEETS[:2], SEEDS)):
        whole, half = numbers(run, "objective").sum(), score_after(run, 5000)
        assert f"{whole:,.0f} ({half:,.0f}" in PAGE
        entropy, best = numbers(run, "environment entropy"), numbers(run, "objective").max()
        assert re.search(
            f"; {(entropy < 0.5).sum()} of {len(entropy):,}[^;]*; [a-z ]*{best:.3f}", PAGE
        )
    runs = [f"manufacturing{end}" for end in SEEDS]
    mean = TABLE_4["manufacturing", "cma-mae"].qd_score
    above = (numbers(run, "qd_score", "metrics.csv") > mean for run in runs)
    times = (numbers(run, "evaluations", "metrics.csv") for run in runs)
    since = (time[late].min() for time, late in zip(times, above, strict=True))
    found = [numbers(run, "objective") for run in runs]
    text = "2 have {:,.0f}, {:,.0f} and {:,.0f} with {:,}, {:,} and {:,} elites, and exceed the "
    text += "published mean since {:,.0f}, {:,.0f} and {:,.0f} evaluations."
    assert text.format(*map(sum, found), *map(len, found), *since) in PAGE
    others = [f"warehouse-even{end}" for end in ("", "-cma-es", "-map-elites", "-dsage")]
    scores = [score_after(run, 1000) for run in others]
    sentence = "of {:,.0f}, CMA-ES {:,.0f}, MAP-Elites (of the preset `warehouse-even-map-elites`, "
    sentence += "with the soft archive) {:,.0f}, DSAGE (`dsage-laptop`) {:,.0f}"
    assert sentence.format(*scores) in NOTES


ALPHAS = {"-a0": "0", "-a1": "1", "": "5", "-seed1": "5, seed 1", "-seed2": "5, seed 2"}


def test_the_archives_over_alpha():
    for domain, end in product(FLEETS[:2], ALPHAS):
        run = f"{domain}{end}"
        objective, changed = numbers(run, "objective"), numbers(run, "changed")
        entropy, best = numbers(run, "environment entropy"), int(objective.argmax())
        cells = [
            domain,
            ALPHAS[end],
            f"{objective.sum():,.0f}",
            f"{len(objective):,}",
            f"{(entropy < 0.5).sum()}",
            f"{objective.mean():.2f}",
            f"{objective[best]:.3f}",
            f"{changed.mean():.0f}",
            f"{changed[best]:.0f}",
        ]
        assert f"| {' | '.join(cells)} |" in PAGE


def test_what_alpha_costs_and_brings():
    more, less = [], []
    for domain in FLEETS[:2]:
        entropies = (numbers(f"{domain}{end}", "environment entropy") for end in ALPHAS)
        none, one, *five = ((entropy < 0.5).sum() for entropy in entropies)
        more.append(sum(regular > max(none, one) for regular in five))
        none, one, *five = (numbers(f"{domain}{end}", "objective").mean() for end in ALPHAS)
        less += [100 * (1 - each / one) for each in five]
        none, one, *five = (numbers(f"{domain}{end}", "changed").mean() for end in ALPHAS)
        assert none > one > max(five)
    assert more == [1, 3] and "`warehouse-even` one run of three shows that**, of" in PAGE
    assert "of `warehouse-uneven` all three do." in PAGE
    text = "moves {:.1f}, {:.1f} and {:.1f} % less than with 1 (seeds 0, 1 and 2), of "
    text += "`warehouse-uneven` {:.1f}, {:.1f} and {:.1f} % more."
    assert text.format(*less[:3], *np.negative(less[3:])) in PAGE
    assert "the larger it is, the fewer cells of the mean elite are the repair's" in PAGE
    none, one, *even = (numbers(f"warehouse-even{end}", "objective").sum() for end in ALPHAS)
    assert min(even) < min(none, one) and max(none, one) < max(even)
    assert "QD-scores of alpha = 0 and 1 lie between the lowest and the highest of alpha" in PAGE
    none, one, *five = (numbers(f"warehouse-uneven{end}", "objective").sum() for end in ALPHAS)
    below = f"{min(five) - none:,.0f} and {min(five) - one:,.0f} below the lowest of three of"
    assert f"the score rises with alpha: those of 0 and 1 are {below} alpha = 5." in PAGE
    assert none < one < min(five)
    # The error is the mean's of five runs.
    error = TABLE_4["warehouse-even", "cma-mae"].qd_error
    both = error * 5**0.5, np.std(even, ddof=1)
    text = "single runs have a standard deviation of {:,.0f}, our three one of {:,.0f})"
    assert text.format(*np.round(both, -1)) in PAGE


def test_the_planners_effort_over_the_elites_that_were_compared():
    table = [row for row in rows("agreement.csv") if row["layout"].startswith("elite")]
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
    assert f"{calm.sum()} never congest; together these move" in PAGE
    gain = 100 * (high[calm].sum() / low[calm].sum() - 1)
    assert f"these move {gain:.1f} % more under high effort" in PAGE
    ratios = [paper[group].sum() / low[group].sum() for group in (flowing | True, flowing)]
    less = [f"{100 * (1 - ratio):.1g} % less" for ratio in ratios]
    text = (
        f"All 40 together move {less[0]} under PBS, the {flowing.sum()} that do not congest under"
    )
    assert f"{text} low effort {less[1]}." in PAGE
    assert f"{100 * (paper[calm].sum() / low[calm].sum() - 1):.1f} % more under PBS." in PAGE
    order = [row.argsort().argsort() for row in (low, paper)]
    assert f"rank correlation {np.corrcoef(order)[0, 1]:.2f}" in NOTES


@pytest.mark.parametrize("name", ["table_4", "table_5"])
def test_the_page_holds_a_table_as_it_is_saved(name):
    saved, _, _ = (RESULTS / f"{name}.md").read_text().partition("\n\n")
    assert saved in (EXPERIMENTS / "README.md").read_text()


def test_the_page_says_how_the_rows_of_table_4_compare():
    saved = {tuple(row[:2]): row for row in table("table_4") if row[2] != "0"}
    score, error, less, spread = {}, {}, {}, {}
    for key, row in saved.items():
        mean, _, half = row[4].replace(",", "").partition(" ± ")
        score[key], error[key] = float(mean), float(half or 0)
        if key in TABLE_4:
            less[key] = TABLE_4[key].qd_score - score[key]
            spread[key] = TABLE_4[key].qd_error * 5**0.5  # the error is the mean's of five runs
    domains, even, uneven = (*FLEETS, "maze-walls", "maze-entropy"), *FLEETS[:2]
    percents = (f"{abs(100 * float(saved[domain, 'cma-mae'][8]) - 100):.0f}" for domain in domains)
    own = dict(zip(domains, percents, strict=True))
    assert f"`maze-walls` scores {own['maze-walls']} % less than the published mean**" in PAGE
    assert round(less["maze-walls", "cma-mae"] / spread["maze-walls", "cma-mae"]) == 2
    shares = (100 * less[one, "cma-mae"] / TABLE_4[one, "cma-mae"].qd_score for one in FLEETS[:2])
    assert "score less, by {:.1f} and {:.1f} %**, which is less than".format(*shares) in PAGE
    for key in (even, "cma-mae"), (uneven, "cma-mae"):
        assert 0 < less[key] < np.hypot(error[key], TABLE_4[key].qd_error)
    assert f"`maze-entropy` scores {own['maze-entropy']} % less: one run, within" in PAGE
    assert 0 < less["maze-entropy", "cma-mae"] < spread["maze-entropy", "cma-mae"]
    more = "less" if less["manufacturing", "cma-mae"] > 0 else "more"
    assert f"`manufacturing` scores {own['manufacturing']} % {more} (with the published" in PAGE
    assert abs(less["manufacturing", "cma-mae"]) < TABLE_4["manufacturing", "cma-mae"].qd_error
    keys = [(domain, "map-elites") for domain in domains]
    assert all(abs(less[key]) <= 1.2 * spread[key] and saved[key][2] == "1" for key in keys)
    times = [score[domain, "cma-mae"] / score[domain, other] for domain, other in keys]
    for domain, other in keys:
        times.append(TABLE_4[domain, "cma-mae"].qd_score / TABLE_4[domain, other].qd_score)
    five = "{:.1f}, {:.1f}, {:.1f}, {:.1f} and {:.1f} times"
    assert f"{five} as high, in the order of the table (paper: {five})".format(*times) in PAGE
    whole = {domain: score[domain, "cma-es"] for domain in FLEETS}
    early = (100 * score_after(f"{domain}-cma-es", 4000) / whole[domain] for domain in FLEETS)
    times = (score[domain, "cma-mae"] / whole[domain] for domain in FLEETS)
    text = "{:.0f}, {:.0f} and {:.0f} % of its QD-score after 4,000 evaluations. CMA-MAE's is "
    text += "{:.1f}, {:.1f} and {:.1f} times as high."
    assert text.format(*early, *times) in PAGE
    best = {path.name: numbers(path.name, "objective").max() for path in RUNS.iterdir()}
    for domain in FLEETS:
        ours = max(best.get(f"{domain}{seed}", 0) for seed in SEEDS)
        assert (best[f"{domain}-cma-es"] > ours) == (domain == "manufacturing")
    assert "The best elite of CMA-ES moves more than CMA-MAE's in `manufacturing`**" in PAGE
    three = (best[f"{even}{seed}"] for seed in SEEDS)
    text = (
        "it moves {:.3f} in the five runs of the search, those of CMA-MAE's three searches {:.3f}, "
    )
    assert (text + "{:.3f} and {:.3f}; in").format(best[f"{even}-cma-es"], *three) in PAGE
    for evaluations in (1000, 1400):
        three = [score_after(f"{even}{seed}", evaluations) for seed in SEEDS]
        assert "{:,.0f}, {:,.0f} and {:,.0f} after {:,}".format(*three, evaluations) in PAGE
    apart = np.ptp([score_after(f"{even}{seed}", 10_000) for seed in SEEDS])
    assert f"differ by up to {round(apart, -2):,.0f}." in PAGE
    entropies = [numbers(f"{domain}-dsage", "environment entropy") for domain in FLEETS[:2]]
    assert min(map(min, entropies)) > 0.9
    assert "none of its {} and {} elites has an entropy below".format(*map(len, entropies)) in PAGE
    stations = numbers("manufacturing-dsage", "workstations")
    moved = f"and the best moves {numbers('manufacturing-dsage', 'objective').max():.3f}."
    assert stations.min() > 500 and moved in PAGE
    assert f"all {len(stations)} elites have more than 500 workstations" in PAGE
    front = page("README.md")
    assert "a run of {} evaluations: {} warehouses".format(*table("figure_16")[2][2:4]) in front


def outcomes_of_table_5() -> dict[tuple[str, str, str], list[tuple[int, float]]]:
    """Return of Table 5 how many runs succeed and what these move, under our planner and PBS."""
    moved = {}
    for (domain, maker, shape, _), saved in TABLE.items():  # our planner comes first
        for row in saved.outcomes(Folders()):
            assert row.runs == 50
            own = moved.setdefault((domain, maker, "{} x {}".format(*shape)), [])
            own.append((row.successes, row.throughput))
    return moved


def more(one: float, than: float) -> str:
    return f"{100 * (one / than - 1):.1f}"


def test_the_page_says_what_table_5_shows():
    (even, uneven, factory), small, large = FLEETS, "33 x 36", "101 x 102"
    moved = outcomes_of_table_5()
    own = {key: [mean for _, mean in pair] for key, pair in moved.items()}
    paper = {key: one.throughput for key, one in TRAFFIC.items()}
    for key, theirs, text in (
        ((even, "cma-mae", large), paper[even, "nca", 1400], "moves **{} % more** than it does"),
        ((uneven, "cma-mae", small), paper[uneven, "nca", 200], "**{} and {} % more** (than ours"),
        ((even, "a0", small), paper[even, "a0", 200], "= 0 moves **{} and {} % more** than ours"),
        ((even, "a1", small), paper[even, "a1", 200], "= 1 {1} % more than ours under PBS."),
        ((uneven, "cma-mae-2", small), paper[uneven, "nca", 200], "**{} and {} % more** at 33"),
        ((uneven, "cma-mae-2", large), paper[uneven, "nca", 1000], "PBS, **{} % more** than under"),
        ((uneven, "cma-es", small), paper[uneven, "cma-es", 200], "moves **{} and {} % more**. At"),
        ((uneven, "a0", small), paper[uneven, "a0", 200], "**{} and {} % more** at 33 × 36 (than"),  # noqa: RUF001
        ((uneven, "a1", small), paper[uneven, "a1", 200], "alpha = 1 **{} and {} % more**, and at"),
    ):
        assert text.format(*(more(theirs, one) for one in own[key])) in PAGE
    for key, theirs, text in (
        ((uneven, "zoo", large), paper[uneven, "nca", 1000], "and it moves **{} and {} % less** ("),
        ((uneven, "nca", large), paper[uneven, "nca", 1000], "first moves **{} and {} % less** th"),
        ((even, "nca", small), paper[even, "nca", 200], "the second **{} and {} % less** (und"),
    ):
        assert text.format(*(f"{100 * (1 - one / theirs):.1f}" for one in own[key])) in PAGE
    good = {key[:2]: pair[1][0] for key, pair in moved.items() if key[2] == large}
    assert good[even, "cma-mae"] == good[even, "cma-es"] == good[uneven, "cma-es"] == 0
    theirs = [more(paper[uneven, one, 1000], own[uneven, one, large][0]) for one in ("a0", "a1")]
    assert "under our planner **{} and {} % more** (alpha 0 and 1).".format(*theirs) in PAGE
    assert good[uneven, "a0"] == good[uneven, "a1"] == 0
    scaled = own[even, "cma-mae-2", large][1] / paper[even, "nca", 1400]
    text = f"{abs(100 * scaled - 100):.1f} % {'more' if scaled > 1 else 'less'} than the paper's"
    assert f"Of seed 2's {good[even, 'cma-mae-2']} do, which move {text}" in PAGE
    first, second = good[uneven, "cma-mae"], good[uneven, "cma-mae-2"]
    assert f"where {first} and {second} with alpha = 5 do" in PAGE
    assert f"where {second} of 50 runs succeed under" in PAGE
    these = more(own[uneven, "cma-mae", large][1], paper[uneven, "nca", 1000])
    assert f"{good[uneven, 'cma-mae']} of 50 (paper 84 %); these move {these} % more." in PAGE
    for key, others, text in (
        ((uneven, "cma-mae", large), ("zoo", "nca"), "{} and {} % more than the zoo's there, {} a"),
        ((factory, "cma-es", large), ("zoo",), "CMA-ES's factory moves {} and {} % more than the"),
        ((factory, "cma-es", small), ("zoo",), "than the zoo's, at 33 × 36 {} and {} %, and"),  # noqa: RUF001
    ):
        theirs = [one for maker in others for one in own[key[0], maker, key[2]]]
        ratios = (more(one, than) for one, than in zip(own[key] * 2, theirs, strict=False))
        assert text.format(*ratios) in PAGE
    (fewer,) = (one for one in named(factory).collection.generators if one.name == "few-stations")
    text = "the zoo's own `few-stations` more than its best, {:.2f} and {:.2f} (two runs and one)."
    assert text.format(*(driven.mean for driven in fewer.sizes[-1].driven)) in PAGE
    assert f"than in the paper**, {good[uneven, 'zoo']} of 50 (paper 84 %), and" in PAGE
    assert f"best `warehouse-even` {good[even, 'zoo']} of 50 succeed (paper 90 %; the" in PAGE
    assert f"of its best factory {good[factory, 'zoo']} of 50 (paper 100 %)" in PAGE
    three = [good[domain, "nca"] for domain in (uneven, even, factory)]
    assert "factory {}, {} and {} of 50 runs succeed under PBS".format(*three) in PAGE
    text = (
        "{} of 50 runs with alpha = 0, {} with alpha = 1, none and {} with alpha = 5 (plain bests, "
    )
    text += "that of alpha = 5 of seeds 1 and 2; of the first zoo's, also of alpha = 5, {})"
    makers = "a0", "a1", "cma-mae-2", "nca"
    assert text.format(*(good[even, maker] for maker in makers)) in PAGE
    both = ([own[factory, maker, size] for size in (small, large)] for maker in ("cma-es", "nca"))
    ratios = np.divide(*both).T.ravel()
    text = "by {:.1f} and {:.1f} % at 33 × 36 and 101 × 102 (under PBS by {:.1f} and {:.1f} %)"  # noqa: RUF001
    assert text.format(*(100 * ratios - 100)) in PAGE
    assert f"in the paper it moves {paper[factory, 'cma-es', 200]:.2f} at 33" in PAGE
    less = f"{100 * (1 - own[even, 'cma-es', large][0] / own[even, 'cma-mae', large][0]):.0f}"
    jammed = {key: pair[0][0] for key, pair in moved.items() if pair[0][0] < 50}
    assert [*jammed] == [(even, "cma-es", large), (uneven, "a1", large)]
    assert f"There {jammed[uneven, 'a1', large]} of 50 runs with alpha = 1 succeed" in PAGE
    assert f"moves {less} % less there, and {jammed[even, 'cma-es', large]} of 50 runs" in PAGE
    ratios = np.divide(own[even, "cma-es", small], own[even, "cma-mae", small])
    assert (ratios < 1).all() and (ratios > 0.998).all() and "too, by less than 0.2 %" in PAGE
    for size in (small, large):
        assert own[uneven, "cma-es", size][0] < own[uneven, "cma-mae", size][0]
    both = [*product(("cma-mae", "cma-mae-2"), ("33x36", "101x102"))]
    for domain, text in (
        (even, "changed {} cells at 33 × 36, {:,} at 101 × 102, of seed 2's {} and {}."),  # noqa: RUF001
        (uneven, "changed {} cells and {}, of seed 2's {} and {:,}."),
    ):
        drawn = (content(f"layouts/{domain}-{maker}-{size}") for maker, size in both)
        assert text.format(*(one["changed"] for one in drawn)) in PAGE
    most = {tuple(row[:3]): row for row in table("figure_22") if row[4:]}
    grown = most[even, large, "CMA-MAE + NCA, first zoo"]
    assert f"moves {grown[4]} there with {int(grown[5]):,} agents" in PAGE
    makers = "CMA-ES + NCA", "CMA-MAE + NCA, seed 1", "CMA-MAE + NCA, first zoo"
    cells = (most[uneven, small, makers[0]], most[uneven, small, makers[1]])
    cells += (most[factory, small, makers[0]], most[factory, small, makers[2]])
    cells += (most[uneven, small, makers[2]],)
    moves, runs = zip(*((row[4], row[6].split("/")[1]) for row in cells), strict=True)
    text = "as in the paper (appendix E.6), {0} against {1} ({6} of 50 runs made; the first zoo's "
    text += "best moves {4}), in `manufacturing` less, {2} ({7} of 50) against {3}."
    assert text.format(*moves, *runs) in PAGE
    assert runs[0] == runs[3] == runs[4] == "50"
    assert {row[5] for row in cells} == {"250"} and "With 250 robots at 33" in PAGE


def test_the_pages_state_what_the_repair_draws_and_where_tiles_jam():
    kept = []
    for maker, size in product(("cma-es", "nca"), ("33x36", "101x102")):
        saved = content(f"layouts/manufacturing-{maker}-{size}")
        drawn, built = ("".join(saved[name]) for name in ("unrepaired", "layout"))
        alike = [one == other for one, other in zip(drawn, built, strict=True) if other in "012"]
        kept += [sum(alike), len(alike)]
    text = "in CMA-ES's factories {} of {} and {} of {} are as the automaton drew them, "
    text += "in CMA-MAE's {} of {} and {} of {}."
    assert text.format(*kept) in PAGE
    rows_of = {(row["layout"], row["agents"]): row for row in rows("congestion.csv")}
    paper = rows_of["warehouse_even_nca_a5_eval", "1400"]
    assert "PBS: {successes} of {runs}), of its best factory".format(**paper) in PAGE
    for domain, robots in (("even", "1400"), ("uneven", "1000")):
        tiled = rows_of[f"warehouse_{domain}_nca_a5_tiled", robots]
        interval = "{:.0f} to {:.0f} %".format(
            *(100 * float(tiled[end]) for end in ("low", "high"))
        )
        text = "{successes} of {runs}[a-z ]* of `{domain}`[a-z ]* ".format(**tiled)
        assert re.search(f"{text}[(]{interval}; the paper's tiling", PAGE)
    peaks = {(row[0], row[1]): row[3].split(", ") for row in table("figure_18")}
    front, large = page("README.md"), "101 x 102"
    moved, whole = outcomes_of_table_5(), []
    for domain in ("warehouse-uneven", "warehouse-even", "manufacturing"):
        by_hand, robots = peaks[domain, large]
        ours, theirs = named(domain).collection.generators[0].sizes[-1].driven
        paper = TRAFFIC[domain, "nca", ours.agents].throughput
        own, pbs = moved[domain, "zoo", large]
        assert f"| {ours.agents:,} | {pbs[1]:.2f} | {paper:.2f} |" in front
        assert own[0] == 50 and theirs.success == 1  # by the first run each was chosen
        whole.append(f"{own[1]:.2f}")
        assert f"| {float(by_hand) + 1e-9:.1f} ({int(robots):,}" in front
    assert "under ours all do and move {}, {} and {}.".format(*whole) in front


def test_the_page_sets_ours_beside_the_papers_own_layouts():
    (even, uneven, _), small, large = FLEETS, "33 x 36", "101 x 102"
    mean = {key: pair[1][1] for key, pair in outcomes_of_table_5().items()}
    # The paper's layouts, driven by our priority-based search.
    theirs = {
        row["layout"].removesuffix("_nca_a5"): row
        for row in rows("congestion.csv", timesteps="5000", planner="published")
    }
    stated = {
        name: "{:.3f} ± {:.3f}".format(*(float(row[key]) for key in ("throughput", "error")))
        for name, row in theirs.items()
    }
    own = [one for key, one in mean.items() if key[0::2] == (even, small)]
    assert max(own) < float(theirs["warehouse_even"]["throughput"])
    text = f"{min(own):.3f} to {max(own):.3f} tasks per timestep, the paper's own layout"
    assert f"{text} {stated['warehouse_even']}" in PAGE
    whole = theirs["warehouse_even_nca_a5_eval"]
    text = "moves {} in the {successes} of {runs} runs".format(
        stated["warehouse_even_nca_a5_eval"], **whole
    )
    assert text in PAGE
    paper = float(whole["throughput"])
    first, ships = (mean[even, maker, large] for maker in ("nca", "zoo"))
    text = f"{more(paper, first)} % more than the first zoo's best and"
    assert f"{text} {100 * (1 - paper / ships):.1f} % less than the zoo's." in PAGE
    text = f"moves {stated['warehouse_uneven']} and its `manufacturing` {stated['manufacturing']}"
    assert text in PAGE
    less = {}
    for (domain, maker, size), one in mean.items():
        paper = float(theirs[domain.replace("-", "_")]["throughput"])
        if domain != even and size == small and one < paper:
            less[domain, maker] = f"{100 * (1 - one / paper):.1f}"
    makers = ("cma-mae", "cma-mae-2", "a1", "a0", "cma-es")
    assert {*less} == {(uneven, one) for one in makers}
    text = "bests do, by {} and {} % (alpha = 5, seeds 1 and 2), {} and {} % (alpha = 1 and 0), "
    text += "and CMA-ES's by {} %."
    assert text.format(*(less[uneven, one] for one in makers)) in PAGE


def test_the_page_states_the_peaks_and_what_congests():
    signs = [(row[4], row[5]) for row in table("figure_18")]
    assert [text[0] for text, _ in signs].count("+") == 20 and all(s[0] == "+" for _, s in signs)
    more = [[1 + int(cell.split()[0]) / 100 for cell in pair] for pair in signs[:14]]
    least, top = np.min(more, axis=0), np.max(more, axis=0)
    assert f"{least[0] + 1e-9:.1f} to {top[0]:.1f} times as much" in PAGE
    assert f"with {least[1]:.1f} to {top[1]:.1f} times as many" in PAGE
    flows = np.array(
        [[cell.split(",")[0] for cell in row[2:4]] for row in table("figure_18")], float
    )
    falls = np.argwhere(np.diff(flows.reshape(3, 7, 2), axis=1) < 0).tolist()
    assert falls == [[0, 5, 0], [1, 2, 1], [1, 5, 1]] and "in three of 36 steps: the grown" in PAGE
    row = next(row for row in table("figure_18") if row[:2] == ["manufacturing", "33 x 36"])
    (grown, robots), (hand, more) = (cell.split(", ") for cell in row[2:4])
    assert f"{hand} with {more} robots against {grown} with {robots}, 6 % (1 to 10)" in PAGE
    rate = np.array(content("courses/warehouse-uneven-human-33x36-200")["tasks"]) / 100 / 50
    assert f"from {rate[1]:.1f} tasks per timestep to {rate[3]:.1f} within 200" in PAGE
    assert min(rate[4:]) > 2.9 and max(rate[4:]) < 3.2 and "200 timesteps and stays there" in PAGE
    for domain in FLEETS:
        hand, grown = (content(f"courses/{domain}-{one}-33x36-200") for one in ("human", "nca"))
        assert (hand["congested"], grown["congested"]) == (0, 0)
        assert hand["runs"] == grown["runs"] == 100 and sum(hand["tasks"]) < sum(grown["tasks"])
        flow = np.array(grown["tasks"][20:]).reshape(4, -1).sum(1)
        assert flow.max() / flow.min() < 1.01, flow
    names = sorted(path.stem for path in (RESULTS / "courses").glob("*-published.json"))
    pbs = [content(f"courses/{name}") for name in names]
    rates = [np.sum(one["tasks"]) / one["runs"] / 5000 for one in pbs]  # by domain, human first
    assert [one["congested"] for one in pbs] == [0, 0, 3, 0, 3, 0]
    assert [one["runs"] for one in pbs] == [10, 10, 3, 10, 3, 10]
    assert f"move {rates[2]:.2f} and {rates[4]:.2f} tasks per timestep; no other run does" in PAGE
    grown = f"{rates[3]:.2f}, {rates[5]:.2f} and {rates[1]:.2f}"
    assert f"the grown layouts move {grown}" in PAGE
    made = {tuple(row[:2]): row[4:6] for row in table("figure_19") if "/" in row[4]}
    flows, less = [], []
    for domain in FLEETS:
        (success, own), (_, grown) = (
            made[domain, name] for name in ("tiled", "CMA-MAE + NCA, first zoo")
        )
        flows.append(success)
        less.append(f"{own} against {grown} ({100 * (1 - float(own[:6]) / float(grown[:6])):.1f} %")
    text = "{} less) and {}), and the factory, all of whose runs succeed, {}; in the paper".format(
        *less
    )
    assert text in PAGE and flows[2].startswith("50/50")
    runs, ends = zip(
        *(re.match(r"(\d+/\d+) .(.*)%\)", one).groups() for one in flows[:2]), strict=True
    )
    text = "here {} and {} do ({} % and {} %)".format(*runs, *ends).replace("/", " of ")
    assert text.replace("% to", " to") in PAGE
    papers = [TRAFFIC["manufacturing", name, 1800].throughput for name in ("tiled", "nca")]
    assert "{} against {}, {:.1f} %)".format(*papers, 100 * (1 - papers[0] / papers[1])) in PAGE
    driven = {key: usage.read(Folders()) for key, usage in USAGE.items()}
    jams = {key: one.congested for key, one in driven.items() if one.congested}
    assert jams == {("warehouse-even", "tiled"): 1}
    shares = []
    for one in driven.values():
        cells = np.sort(one.usage.ravel())[::-1]
        tenth = np.count_nonzero(cells) // 10
        shares.append(f"{100 * cells[:tenth].sum() / cells.sum():.0f}")
    (even, grown), *others = zip(shares[::2], shares[1::2], strict=True)
    text = (
        f"has {even} % of the robots' time in the tiled `warehouse-even` and {grown} % in the one"
    )
    assert text in PAGE and all(f"{tiled} and {whole} %" in PAGE for tiled, whole in others)


def test_the_page_states_layouts_repairs_and_mazes():
    plan = layout("warehouse-uneven-cma-mae-2-33x36")
    left = plan[:, : plan.shape[1] // 2]
    endpoints, shelves = (left == "e").sum(), (plan == "@").sum() - (left == "@").sum()
    assert f"has {endpoints} of its {(plan == 'e').sum()} endpoints in the left half" in PAGE
    entropies = []
    for run in map("".join, product(FLEETS[:2], ALPHAS)):
        best = numbers(run, "objective").argmax()
        entropies.append(numbers(run, "environment entropy")[best])
    text = "{:.2f} (alpha = 0), {:.2f} (1), {:.2f}, {:.2f} and {:.2f} (5, seeds 0 to 2), that of "
    text += "`warehouse-uneven`'s {:.2f}, {:.2f}, {:.2f}, {:.2f} and {:.2f}. There"
    assert text.format(*entropies) in PAGE
    assert entropies[0] > entropies[1] > max(entropies[2:5])
    assert f"and {shelves} of its {(plan == '@').sum()} shelves in the right" in PAGE
    for domain, size, *_ in table("figure_18")[:14]:
        hand, grown = (
            (layout(f"{domain}-{maker}-{size.replace(' ', '')}") == "@").sum()
            for maker in ("human", "nca")
        )
        if size == "101 x 102":
            assert f"the one by hand has {hand:,} shelves, the grown one {grown:,}; at" in PAGE
        else:
            assert abs(hand - grown) <= 1
    makers = "a0", "a1", "cma-mae-2", "cma-mae"
    drawn = {
        (domain, maker): content(f"layouts/{domain}-{maker}-101x102")
        for domain, maker in (*product(FLEETS[:2], makers), ("warehouse-even", "cma-es"))
    }
    changed = {key: f"{one['changed']:,}" for key, one in drawn.items()}
    text = "{} cells with alpha = 0, where the layout falls into two patterns, {} with alpha = 1, "
    text += "where it falls into three fields of one pattern, and with alpha = 5 {} cells of seed "
    text += "2's, which has one pattern, and {} of seed 1's."
    assert text.format(*(changed["warehouse-even", maker] for maker in makers)) in PAGE
    text = "it changed {} cells with alpha = 0, where nine tenths of what the automaton draws are "
    text += "endpoints, {} with alpha = 1, where seven tenths are, and with alpha = 5 {} of seed "
    text += "2's, where four tenths are shelves and hardly any endpoints, and {} of seed 1's."
    assert text.format(*(changed["warehouse-uneven", maker] for maker in makers)) in PAGE
    tenths = ("a0", "e", 9), ("a1", "e", 7), ("cma-mae-2", "e", 0), ("cma-mae-2", "@", 4)
    for maker, symbol, share in tenths:
        # Without the borders.
        inside = "".join(row[2:-2] for row in drawn["warehouse-uneven", maker]["unrepaired"])
        assert round(10 * inside.count(symbol) / len(inside)) == share
    best = [max(SEEDS, key=lambda end: score_after(f"{one}{end}", 10_000)) for one in FLEETS[:2]]
    assert best == ["-seed2", "-seed2"] and "2's, whose QD-score is the highest of three" in PAGE
    assert f"with {changed['warehouse-even', 'cma-es']} cells changed" in PAGE
    spent = {
        (row[0], row[1]): [float(row[n].split()[0]) for n in (4, 5)] for row in table("runtimes")
    }
    for domain in FLEETS:
        own = [row for row in table("runtimes") if row[0] == domain]
        cells = np.array([math.prod(map(int, row[1].split(" x "))) for row in own])
        growth, repair = np.array([spent[domain, row[1]] for row in own]).T
        growth /= cells * np.array([int(row[2]) for row in own])
        # The smallest growth is written in hundredths of a second, of which it has two or three.
        for each in (growth[1:], repair / cells):
            assert each.max() / each.min() < 1.5
    assert "about in proportion to the cells times the steps" in PAGE
    assert "and 1.2 to 1.8, about in proportion to the cells." in PAGE
    for size, grown, repaired in (
        ("33 x 36", "0.02 to 0.03", "0.1 to 0.2"),
        ("101 x 102", "0.83 to 0.95", "1.2 to 1.8"),
    ):
        for column, text in enumerate((grown, repaired)):
            digits = len(text.split()[0]) - 2
            seconds = [spent[domain, size][column] for domain in FLEETS]
            assert (
                text == f"{min(seconds):.{digits}f} to {max(seconds):.{digits}f}" and text in PAGE
            )
    for size, text in (
        ("33x36", "({:.0f} % of the cells become"),
        ("101x102", "36, {:.0f} % at 101"),
    ):
        saved = content(f"layouts/manufacturing-nca-{size}")
        drawn, built = ("".join(saved[name]) for name in ("unrepaired", "layout"))
        changed = [new in "012" for one, new in zip(drawn, built, strict=True) if one != new]
        stations, others = (100 * changed.count(kind) / len(built) for kind in (True, False))
        assert text.format(stations) in PAGE and round(others) == 1
    assert "; 1 % change otherwise)" in PAGE
    large = table("maze_success")[1]
    arrives = f"it arrives in {large[1].split('%')[0]} of 100 runs (paper: 93 %)"
    assert f"with a way of {large[2]} moves (the paper's: 226) {arrives}" in PAGE
    assert f"as long in {large[4]} (paper: 22.3 ± 3.0 %)" in PAGE


KERNELS = r"[(]3, 1, 1[)], isotropic", r"[(]3, 3, 3[)], isotropic"


def test_the_notes_state_algorithms_and_planners():
    for row in rows("algorithms.csv"):
        pairs = [("qd_score", 1, 0), ("coverage", 100, 1), ("best_objective", 1, 3)]
        cells = [
            f"{scale * float(row[name]):.{digits}f}{' %' * (scale == 100)} ± "
            f"{scale * float(row[f'{name}_margin']):.{digits}f}"
            for name, scale, digits in pairs
        ]
        assert f"| {' | '.join(cells)} |" in NOTES, row["algorithm"]
    (tiled,) = rows("congestion.csv", layout="warehouse_even_nca_a5_tiled")
    assert f"tiled and repaired here, {tiled['successes']} of {tiled['runs']} runs succeed" in NOTES
    small, large = (np.array(re.findall(rf"{one} \| (\d+) [(]", NOTES), float) for one in KERNELS)
    text = "{:.1f} times the QD-score of the small ones in 300 evaluations of `laptop`, {:.1f} "
    assert f"{text}times in 600 of `quick`".format(*(large / small)) in PAGE
    for domain in map(find_domain, FLEETS):
        ours = run_of(domain.name).config.evaluation.generator
        both = (replace(ours, kernel_sizes=one) for one in ((3, 1, 1), (3, 3, 3)))
        few, many = (GENERATORS.make(one, domain.canvas).size for one in both)
        assert round(few / many, 1) == 0.2 and "and a fifth of the weights" in PAGE
    score = {row["algorithm"]: f"{float(row['qd_score']):.0f}" for row in rows("algorithms.csv")}
    text = "here with its default learning rate, {random} and {cma-me} against {cma-mae} ± 24)"
    assert text.format(**score) in PAGE


def test_the_notes_state_what_highs_gains():
    saved = list(read_table(RESULTS / "polish.csv", Row))
    for domain in ("warehouse-even", "warehouse-uneven", "manufacturing"):
        quick, full = ([row for row in saved if row[:3:2] == (domain, one)] for one in LEVELS)
        assert [row.cell for row in quick] == [row.cell for row in full] and len(full) == 67
        moved = [[row.throughput for row in own] for own in (full, quick)]
        change = paired_difference(*moved)
        means = [
            [np.mean([row[place] for row in own]) for own in (quick, full)] for place in (4, 6)
        ]
        proven = sum(row.repair == "optimal" for row in full)
        cells = [
            "{:.1f}; {:.1f}".format(*means[0]),
            f"{np.mean([row.bound for row in full]):.1f}",
            f"{proven} of 67",
            "{:.2f}; {:.2f}".format(*means[1]),
            f"{np.mean(moved[1]):.3f}; {np.mean(moved[0]):.3f} "
            f"({change.low:+.1f} to {change.high:+.1f} %)",
        ]
        assert f"| `{domain}` | {' | '.join(cells)} |" in NOTES


def test_the_page_shows_the_sphere_as_it_is_saved():
    means = {}
    for (iterations, seeds), strategy in product(((500, 8), (10_000, 3)), ("full", "iso", "sep")):
        own = rows(f"sphere-{iterations}.csv", strategy=strategy, iterations=str(iterations))
        values = [[float(row[name]) for row in own] for name in ("qd_score", "coverage")]
        samples = [sample_of(np.array(column)) for column in values]
        cells = [strategy, f"{iterations:,}", str(seeds)]
        cells += [f"{one.mean:.2f} ± {one.error:.2f}" for one in samples]
        assert len(own) == seeds and f"| {' | '.join(cells)} |" in PAGE
        means[strategy, iterations] = [one.mean for one in samples]
    score, coverage = means["iso", 10_000]
    assert score < 63.22 and coverage < 80.82 and "63.22 and 80.82 (pyribs' tutorial" in PAGE


def test_the_page_compares_exact_and_float_automata():
    below = []
    for preset in ("quick", "laptop"):
        runs = rows("arithmetic.csv", preset=preset)
        assert [int(run["seed"]) for run in runs] == [*range(5), *range(5)]
        cells = [f"`{preset}`", *{f"{int(run['evaluations']):,}" for run in runs}]
        pairs = ("qd_score", 1, 1), ("coverage", 100, 2), ("best_objective", 1, 3)
        for name, scale, digits in pairs:
            exact, plain = (
                scale * np.array([float(run[name]) for run in runs if run["arithmetic"] == kind])
                for kind in ("exact", "float")
            )
            more = sample_of(exact - plain - 1e-9)  # ties round away from 0
            assert abs(more.mean) < margin(more)
            cells.append(f"{exact.mean():,.{digits}f} against {plain.mean():,.{digits}f}")
            cells[-1] += f" ({more.mean:+.{digits}f} ± {margin(more):.{digits}f})"
            if name == "qd_score":
                below.append(f"{100 * (1 - exact.mean() / plain.mean()):.0f}")
        assert f"| {' | '.join(cells)} |" in PAGE
    assert "score {} and {} % less on average**".format(*below) in PAGE
    plain = rows("arithmetic.csv", preset="laptop", arithmetic="float")
    for run, end in zip(plain, SEEDS, strict=False):
        assert run["qd_score"] == f"{score_after(f'warehouse-even{end}', 300):.6g}"


@pytest.mark.slow
def test_the_page_of_guidance_states_what_saved_costs_move():
    plan = read_plan(RESULTS / "guidance" / "calm-0.json")
    text = page("notebooks/how_to/guidance.md")
    for agents, wording in (500, "move {} under PIBT"), (640, "| {} after 3,400 simulations"):
        config = FleetConfig(agents, 1000, planner=PibtConfig())
        runs = run_seeds(plan.floor, plan.domain.simulator.tasks, config, range(10)).runs
        moved = sample_of([float(run.throughput) for run in runs])
        assert wording.format(f"{moved.mean:.2f} ± {moved.error:.2f}") in text


def test_the_guide_says_what_two_planners_move_with_costs():
    guide, saved = page("notebooks/how_to/guidance.md"), rows("guidance_planners.csv")
    moved = {(row["layout"], row["agents"]): [] for row in saved}
    for row in saved:
        moved[row["layout"], row["agents"]].append(float(row["throughput"]))
    assert len(saved) == 36 and all(row["success_rate"] == "1.0" for row in saved)
    for values in moved.values():
        cells = [f"**{value:.2f}**" if value == max(values) else f"{value:.2f}" for value in values]
        assert re.search(r" \([\d.]+\) (?:\| )+".join(map(re.escape, cells)), guide), cells
