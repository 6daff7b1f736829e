"""The generators that ship: whole, small, as good as recorded; commands take and only read them."""

import csv
from collections.abc import Iterator
from pathlib import Path

import jax
import numpy as np
import pytest
from conftest import facts_of, read_layout
from matplotlib.image import imread

import qdenv
from qdenv.cli.main import run
from qdenv.configurations import PRESETS
from qdenv.domains.base import make_domain
from qdenv.generators import GENERATORS
from qdenv.run.config import override
from qdenv.run.directory import RunDirectory
from qdenv.score import entropy
from qdenv.search.registry import ALGORITHMS
from qdenv.shipped import NamedGenerator, named, names
from qdenv.study.elites import Unrepaired, repair_grown
from qdenv.types import InputError
from qdenv.view.runs import plot_run

pytestmark = pytest.mark.slow

ZOO = Path(qdenv.__file__).parent / "zoo"
MOST_BYTES = 6_000_000
DOMAINS = sorted(names())
EVEN = "zoo:warehouse-even"


@pytest.fixture(params=DOMAINS)
def domain(request) -> str:
    """Name a domain of the zoo."""
    return request.param


@pytest.fixture(autouse=True)
def stays_as_it_is() -> Iterator[None]:
    """Nothing may write where the package lies."""

    def stamps() -> dict[Path, int]:
        found = (path for path in ZOO.rglob("*") if "__pycache__" not in path.parts)
        return {path: path.stat().st_mtime_ns for path in found if path.is_file()}

    before = stamps()
    yield
    assert stamps() == before


def generators_of(domain: str) -> list[NamedGenerator]:
    return list(named(domain).collection.generators)


def test_all_of_it_is_smaller_than_six_megabytes():
    assert sum(path.stat().st_size for path in ZOO.rglob("*") if path.is_file()) < MOST_BYTES


def test_every_generator_has_its_own_cell_name_and_figures(domain):
    found, archive = generators_of(domain), RunDirectory.open(f"zoo:{domain}").archive
    assert len({one.name for one in found}) == len({one.cell for one in found}) == len(archive)
    assert 8 <= len(found) <= 12 and found[0].name == "best"
    for one in found:
        elite = archive.elite(one.cell)
        assert one.objective == pytest.approx(elite.objective, rel=1e-5)
        assert archive.elite(one.name).cell in (one.cell, archive.best.cell)
        small, large = one.sizes
        assert (small.rows, small.cols) == elite.layout.shape
        assert large.steps == 200 and large.driven
        assert all(0 <= row.success <= 1 and row.runs >= 1 for row in small.driven + large.driven)


def test_every_domain_says_which_run_it_comes_from(domain):
    run_, origin = RunDirectory.open(f"zoo:{domain}"), named(domain).collection.origin
    evaluation = run_.config.evaluation
    former = {"arithmetic": evaluation.generator.arithmetic}
    if domain == "manufacturing":
        former["goal_odds"] = evaluation.domain.goal_odds
    assert override(PRESETS[origin.run], former).evaluation == evaluation
    assert ALGORITHMS.name_of(run_.config.algorithm) == origin.algorithm
    assert run_.config.start == origin.start
    assert (run_.config.seed, run_.read_metrics()[-1].evaluations) == (
        origin.seed,
        origin.evaluations,
    )


def test_every_generator_draws_again_what_is_recorded(domain):
    """An exact one does everywhere; of others those where the last bit does not matter.

    An automaton of floats is iterated 50 times, and some amplify the order in which another
    processor or another XLA sums a convolution. Those that draw the same from parameters disturbed
    in their last bit must draw the recorded plan everywhere.
    """
    run_ = RunDirectory.open(f"zoo:{domain}")
    archive, evaluation = run_.archive, run_.config.evaluation
    found = make_domain(evaluation.domain)
    generator = GENERATORS.make(evaluation.generator, found.canvas)
    weights = archive.columns["solution"]
    assert weights.shape[1] == generator.size
    steps = evaluation.generator.steps
    grow = jax.jit(lambda weights: jax.lax.map(found.frame, generator.grow(weights, steps)))
    drawn = np.asarray(grow(weights))
    stable = np.ones(len(drawn), bool)
    for seed in range(3 if evaluation.generator.arithmetic == "float" else 0):
        noise = np.random.default_rng(seed).normal(size=weights.shape).astype(np.float32)
        stable &= (np.asarray(grow(weights * (1 + 1e-7 * noise))) == drawn).all(axis=(1, 2))
    assert stable.any()
    np.testing.assert_array_equal(drawn[stable], archive.columns["unrepaired"][stable])


def test_every_recorded_drawing_is_repaired_to_the_recorded_figures(domain):
    run_ = RunDirectory.open(f"zoo:{domain}")
    config, archive = run_.config, run_.archive
    evaluation = config.evaluation
    found, steps = make_domain(evaluation.domain), evaluation.generator.steps
    drawn = archive.columns["unrepaired"]
    for one in generators_of(domain):
        (row,) = np.flatnonzero((archive.cells == one.cell).all(axis=1))
        grown = Unrepaired(found, None, drawn[row], steps, evaluation.repair)
        repaired = repair_grown(grown, config.seed)
        layout = drawn[row] if repaired is None else np.asarray(repaired.layout)
        assert (layout != drawn[row]).sum() == one.sizes[0].changed
        # What pages and pictures show is what `qdenv generate` makes.
        np.testing.assert_array_equal(layout, archive.columns["repaired"][row])
        for axis in found.measures:
            if axis.name in one.sizes[0].measures:
                value = float(axis.value(layout, None))
                assert value == pytest.approx(one.sizes[0].measures[axis.name], rel=1e-5)


def test_the_best_moves_more_at_the_large_size_than_those_chosen_for_other_things():
    best, *others = (one.sizes[-1].driven[0] for one in generators_of("warehouse-even"))
    assert best.success == 1
    assert best.mean > np.median([other.mean for other in others])


def test_commands_and_functions_take_names_of_the_zoo(folder, capsys):
    small = ["--rows", "12", "--cols", "16"]
    assert run(["generate", f"{EVEN}/regular", *small, "--shelves", "20", "--out", "a.json"]) == 0
    assert run(["generate", EVEN, "--elite", "regular", *small, "--shelves", "20"]) == 0
    one, other = (read_layout(name, ".@ew") for name in ("a.json", "layout.json"))
    np.testing.assert_array_equal(one, other)
    plan = qdenv.generate(f"{EVEN}/regular", rows=12, cols=16, shelves=20)
    np.testing.assert_array_equal(plan.layout, one)
    best = qdenv.generate(EVEN, rows=12, cols=16, shelves=20)
    np.testing.assert_array_equal(
        best.layout, qdenv.generate(f"{EVEN}/best", rows=12, cols=16, shelves=20).layout
    )
    assert (best.layout != one).any()
    assert run(["series", f"{EVEN}/regular", "--sizes", "9x14", "--out", "s"]) == 0
    assert run(["export", f"{EVEN}/regular"]) == 0
    table = list(csv.DictReader(Path("warehouse-even-regular_elites.csv").read_text().splitlines()))
    assert len(table) == len(names()["warehouse-even"])


def test_a_plot_goes_where_the_command_is_given(folder, capsys):
    assert run(["plot", f"{EVEN}/regular"]) == 0
    assert run(["plot", f"{EVEN}/regular", "--out", "mine"]) == 0
    for name in ("warehouse-even-regular", "mine"):
        assert {path.name for path in Path(name).iterdir()} >= {
            "archive.png",
            "best_layout.png",
        }
    assert "mine/archive.png" in capsys.readouterr().out
    with pytest.raises(InputError, match="ships with qdenv"):
        plot_run(RunDirectory.open(EVEN))


def test_the_generator_that_is_named_is_the_runs_best():
    regular = RunDirectory.open(f"{EVEN}/regular")
    assert regular.best.cell == named("warehouse-even/regular").generator.cell
    every = RunDirectory.open(EVEN).archive
    lowest = min(
        float(entropy(every.elite(one.cell).layout[:, 2:-2], 3))
        for one in generators_of("warehouse-even")
    )
    assert float(entropy(regular.best.layout[:, 2:-2], 3)) == lowest
    with pytest.raises(InputError, match='give "best" or "regular" or'):
        every.elite("worst")
    with pytest.raises(InputError, match="indices below"):
        every.elite((float("inf"), 0))


def test_zoo_lists_every_generator_with_its_figures(folder, capsys):
    facts = facts_of("zoo")
    said = capsys.readouterr().out
    assert [one["domain"] for one in facts["domains"]] == DOMAINS
    for one in facts["domains"]:
        for generator in one["generators"]:
            row = generator["sizes"][-1]["driven"][0]
            (line,) = (
                line
                for line in said.splitlines()
                if line.startswith(f"zoo:{one['domain']}/{generator['name']} ")
            )
            assert f"{row['mean']:.3f}" in line and generator["about"] in line
    assert run(["zoo", "warehouse-even/regular"]) == 0
    said = capsys.readouterr().out
    assert "101 x 102" in said and "200 steps of growth, 2500 shelves" in said
    assert "qdenv generate zoo:warehouse-even/regular --rows 101 --cols 102" in said
    assert run(["zoo", EVEN, "--plot"]) == 0
    assert imread("zoo.png").shape[0] > 600
    assert "zoo:maze" not in capsys.readouterr().out


def test_a_folder_of_the_zoo_is_read_only_by_path_too(tmp_path, capsys):
    folder = ZOO / "maze-walls"
    (tmp_path / "link").symlink_to(folder)
    for place in (folder, tmp_path / "link"):
        assert RunDirectory.open(place).shipped is not None
        for command in (["resume", str(place), "--evaluations", "1000"], ["train", "--out"]):
            assert run(command if command[0] == "resume" else [*command, str(place)]) == 2
            assert "ships with qdenv" in capsys.readouterr().err


def test_no_hint_names_a_command_that_would_write_into_the_zoo(capsys):
    assert run(["surrogate", "zoo:maze-walls"]) == 2
    line = capsys.readouterr().err
    assert "at least 50 elites" in line and "resume" not in line and str(ZOO) not in line
