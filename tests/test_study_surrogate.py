"""The surrogate as a tool: its figures against oracles, what it learns and what it cannot."""

import csv
import json
from dataclasses import replace
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import toy
from scipy import stats

import qdenv
from qdenv.cli.main import run as command
from qdenv.domains.base import make_domain
from qdenv.io.arrays import write_arrays
from qdenv.run.directory import RunDirectory
from qdenv.study.surrogate import (
    FEWEST,
    Evaluated,
    average_splits,
    read_elites,
    score_predictions,
    scores_to_dict,
    split_elites,
    try_surrogate,
)
from qdenv.surrogates.settings import SurrogateConfig
from qdenv.surrogates.surrogate import Ring, Samples, Surrogate
from qdenv.types import Encoding, InputError

pytestmark = pytest.mark.slow

TINY = SurrogateConfig(channels=4, blocks=0, epochs=60, minibatch=16, rate=3e-3)
DRAWN = (8, 9)


def save_run(path: Path, elites: int) -> RunDirectory:
    """Save a run whose archive was never searched: gardens at random, their flowers counted."""
    config = toy.CONFIG
    settings = replace(config.evaluation.domain, rows=DRAWN[0], cols=DRAWN[1])
    config = replace(config, evaluation=replace(config.evaluation, domain=settings))
    domain = make_domain(settings)
    cells = zip(domain.measures, (30, 8), strict=True)
    axes = [axis._replace(cells=count) for axis, count in cells]
    run = RunDirectory.create(path, config, axes)
    rng = np.random.default_rng(0)
    share = rng.random((elites, 1, 1))
    drawn = np.where(rng.random((elites, *DRAWN)) < share, 1, 0).astype(np.int8)
    repaired = np.where(drawn == 0, 2, drawn).astype(np.int8)
    write_arrays(
        run.path / "archive.npz",
        {
            "index": rng.permutation(240)[:elites],
            "solution": rng.random((elites, 3)).astype(np.float32),
            "objective": (drawn == 1).sum((1, 2)) / np.float32(10),
            "measures": np.stack([(repaired == 2).sum((1, 2)), (drawn[:, 0] == 1).sum(1)], 1) * 1.0,
            "unrepaired": drawn,
            "repaired": repaired,
        },
    )
    return run


@pytest.fixture(scope="module")
def run(tmp_path_factory) -> RunDirectory:
    return save_run(tmp_path_factory.mktemp("run") / "garden", 200)


@pytest.fixture(scope="module")
def elites(run) -> Evaluated:
    return read_elites(run)


@pytest.fixture(scope="module")
def told() -> list:
    """The progress that is reported of the trials."""
    return []


@pytest.fixture(scope="module")
def trials(elites, told):
    return try_surrogate(
        elites, TINY, (0, 1), lambda doing, share, note: told.append((share, note))
    )


def test_figures_agree_with_the_textbook():
    rng = np.random.default_rng(1)
    for size, noise in ((5, 0.1), (40, 1.0), (400, 5.0)):
        truth = rng.normal(3.0, 2.0, size).round(1)  # with ties
        predicted = (truth + rng.normal(0.5, noise, size)).round(1)
        found = score_predictions(predicted, truth)
        residual, total = ((truth - predicted) ** 2).sum(), ((truth - truth.mean()) ** 2).sum()
        assert found["r2"] == pytest.approx(1 - residual / total)
        assert found["rmse"] == pytest.approx(np.sqrt(residual / size))
        # Spearman's is Pearson's of mid-ranks.
        ranks = [(one[:, None] > one).sum(1) + (one[:, None] == one).sum(1) / 2 for one in
                 (predicted, truth)]  # fmt: skip
        assert found["rank"] == pytest.approx(np.corrcoef(ranks)[0, 1])
        assert found["rank"] == pytest.approx(stats.spearmanr(predicted, truth).statistic)


def test_figures_at_their_ends():
    truth = np.array([1.0, 2.0, 4.0, 9.0])
    assert score_predictions(truth, truth) == {"r2": 1.0, "rmse": 0.0, "rank": 1.0}
    mean = score_predictions(np.full(4, truth.mean()), truth)
    assert mean["r2"] == pytest.approx(0) and np.isnan(mean["rank"])
    # The held-out variance decides, and not that of anything else: a shifted scale is punished.
    shifted = score_predictions(truth + 10, truth)
    assert shifted["r2"] < -9 and shifted["rank"] == 1.0
    still = score_predictions(truth, np.ones(4))
    assert np.isnan([still["r2"], still["rank"]]).all() and still["rmse"] > 0


def test_a_split_holds_a_fifth_out_and_no_elite_twice():
    for count in (50, 97, 604):
        known, held = split_elites(count, 3)
        assert len(held) == round(count / 5)
        assert sorted([*known, *held]) == list(range(count))
        assert (split_elites(count, 3)[1] == held).all() and set(split_elites(count, 4)[1]) != set(
            held
        )


def test_a_spread_is_over_the_splits_that_have_a_number():
    values = [1.0, 3.0, float("nan")]
    both = average_splits(values)
    assert both == {"mean": 2.0, "spread": pytest.approx(np.sqrt(2)), "splits": values}
    assert np.isnan(average_splits([5.0])["spread"])
    assert np.isnan(average_splits([float("nan")])["mean"])


def test_a_surrogate_counts_the_flowers_of_gardens_it_has_not_seen(elites, trials):
    assert elites.names == ("objective", "paths", "flowers on top")
    for trial in trials:
        assert len(trial.held) == 40 and trial.predicted.shape == (40, 3)
        assert min(skill["r2"] for skill in trial.skills[:2]) > 0.8
        assert min(skill["rank"] for skill in trial.skills[:2]) > 0.9
        # Paths become hedges in every repair, which one layer of the network can tell.
        assert trial.tiles > 0.98 > (elites.drawn == elites.repaired).mean()
    assert scores_to_dict(elites, TINY, trials)["skills"]["paths"]["r2"]["splits"] == [
        trial.skills[1]["r2"] for trial in trials
    ]


def test_a_fit_in_pieces_is_the_fit():
    rng = np.random.default_rng(2)
    maps = rng.integers(0, 3, (20, 6, 6)).astype(np.int8)
    numbers = rng.normal(size=(20, 3)).astype(np.float32)
    samples = Samples(*map(jnp.asarray, (maps, maps, np.zeros(maps.shape, np.float16), numbers)))
    ring = Ring(samples, jnp.int32(20))
    config = SurrogateConfig(channels=2, blocks=0, epochs=4, minibatch=8)
    surrogate = Surrogate(config, Encoding((6, 6), 3, repairs=True), 1)
    fit_part = jax.jit(surrogate.fit_part, static_argnames="name")
    key = jax.random.key(1)
    start = parts = jax.jit(surrogate.init)(key)
    whole, losses = jax.jit(surrogate.fit)(start, ring, key)
    for name in surrogate.stages:
        for first, last in ((0, 1), (1, 4)):
            parts, loss = fit_part(parts, ring, key, name, first, last)
        np.testing.assert_allclose(loss, losses[name], rtol=1e-5)
    assert (whole.fits, parts.fits) == (1, 0)
    jax.tree.map(
        lambda one, other: np.testing.assert_allclose(one, other, rtol=1e-4, atol=1e-6),
        (whole.learners, whole.centre, whole.spread),
        (parts.learners, parts.centre, parts.spread),
    )
    moved = jax.tree.map(lambda one, other: bool((one != other).any()), whole, start)
    assert all(jax.tree.leaves(moved.learners["score"].variables["params"]))


def test_progress_is_told_from_nothing_to_nearly_all(trials, told):
    shares = [share for share, _ in told]
    # Two splits, two networks, sixty epochs.
    assert shares == sorted(shares) and len(set(shares)) == 240
    assert told[0] == (0, "split 1 of 2") and told[-1][1] == "split 2 of 2"


def test_nothing_is_predicted_where_the_numbers_were_shuffled(elites):
    order = np.random.default_rng(5).permutation(len(elites.numbers))
    shuffled = replace(elites, numbers=elites.numbers[order])
    for trial in try_surrogate(shuffled, TINY, (0, 1)):
        assert max(skill["r2"] for skill in trial.skills) < 0.1


def test_a_seed_predicts_the_same_alone_and_whatever_is_true_of_what_it_holds_out(elites, trials):
    numbers = elites.numbers.copy()
    numbers[trials[1].held] = -50.0
    (blind,) = try_surrogate(replace(elites, numbers=numbers), TINY, (1,))
    assert (blind.held == trials[1].held).all()
    assert (blind.predicted == trials[1].predicted).all()


def test_the_command_writes_what_it_says(run, folder, capsys):
    sizes = "--channels 4 --blocks 0 --epochs 60 --minibatch 16 --rate 3e-3"
    line = f"surrogate {run.path} --seeds 4,6 {sizes} --json facts.json"
    assert command(line.split()) == 0
    said = capsys.readouterr().out
    assert "200 elites of 8 x 9" in said and "2 random splits" in said
    assert "garden_surrogate.csv, garden_surrogate.png" in said
    rows = list(csv.DictReader(Path("garden_surrogate.csv").read_text().splitlines()))
    assert len(rows) == 80 and {row["seed"] for row in rows} == {"4", "6"}
    facts = json.loads(Path("facts.json").read_text())
    assert facts["held_out"] == 40 and facts["surrogate"]["channels"] == 4
    for name, figures in facts["skills"].items():
        for seed, r2 in zip("46", figures["r2"]["splits"], strict=True):
            mine = [row for row in rows if row["seed"] == seed]
            truth, predicted = (
                np.array([float(row[column]) for row in mine])
                for column in (name, f"predicted {name}")
            )
            assert score_predictions(predicted, truth)["r2"] == pytest.approx(r2, abs=1e-4)
        assert f"{figures['r2']['mean']:.2f}" in said
    archive = run.archive
    assert archive.elite(rows[0]["cell"]).objective == pytest.approx(float(rows[0]["objective"]))


def test_too_few_elites_are_refused_in_one_line(folder, capsys):
    run = save_run(folder / "small", FEWEST - 1)
    assert command(["surrogate", str(run.path)]) == 2
    said = capsys.readouterr()
    assert "at least 50 elites, this archive has 49" in said.err and said.err.count("\n") == 1
    assert said.out == "" and not list(folder.glob("*.*"))


def test_from_python_a_surrogate_is_a_function(run, trials):
    sizes = {"channels": 4, "blocks": 0, "epochs": 60, "minibatch": 16, "rate": 3e-3}
    facts = qdenv.surrogate(run, seeds=1, **sizes)
    assert facts["seeds"] == [0] and facts["surrogate"]["epochs"] == 60
    for number, figures in enumerate(facts["skills"].values()):
        assert figures["r2"]["splits"] == [trials[0].skills[number]["r2"]]
    with pytest.raises(InputError, match="unknown setting 'epoch'"):
        qdenv.surrogate(run, epoch=3)
    with pytest.raises(InputError, match="unknown size 'huge'"):
        qdenv.surrogate(run, size="huge")
