"""The Python functions: names as strings, results that display themselves in a notebook."""

import importlib
import inspect
import json
import pkgutil
import shutil
from dataclasses import replace
from functools import partial
from importlib import metadata

import numpy as np
import pytest
import toy
from conftest import read_layout
from small_warehouse import ROWS, TILES

import qdenv
from qdenv.cli.main import COMMANDS
from qdenv.cli.main import run as command
from qdenv.configurations import PRESETS
from qdenv.domains.manufacturing import ManufacturingConfig
from qdenv.grid import parse
from qdenv.io.layouts import write_layout
from qdenv.run import loop
from qdenv.run.config import override
from qdenv.run.directory import RunDirectory
from qdenv.run.executors import Execution
from qdenv.types import InputError

pytestmark = pytest.mark.slow

PLAN = parse(ROWS, TILES)
FLEET = {"agents": 4, "timesteps": 40, "seeds": 2, "planner": "pibt"}

PIBT = {"timesteps": 40, "planner": "pibt"}  # which compiles fast


@pytest.fixture(scope="module")
def path(tmp_path_factory):
    path = tmp_path_factory.mktemp("plan") / "plan.json"
    write_layout(path, PLAN, TILES, domain="warehouse-uneven")
    return path


@pytest.fixture(scope="module")
def run(tmp_path_factory) -> RunDirectory:
    path = tmp_path_factory.mktemp("run") / "garden"
    return loop.train(replace(toy.CONFIG, evaluations=32), path, progress=False)


def test_every_public_name_is_there_and_has_a_docstring():
    importlib.import_module("qdenv.cli.main")  # no module of the package hides a name
    for name in qdenv.__all__:
        public = getattr(qdenv, name)
        assert inspect.getdoc(public) and not inspect.ismodule(public), name
    assert qdenv.__version__ == metadata.version("qdenv")
    for command_name, target in COMMANDS.items():  # is the function of the same name
        name = command_name.replace(" ", "_").replace("-", "_")
        if name != "completion":  # which is the shell's
            assert getattr(qdenv, name) is pkgutil.resolve_name(target)


def test_a_file_an_array_and_a_plan_give_the_same_numbers(path):
    by_name = qdenv.simulate(str(path), **FLEET)
    assert by_name["domain"] == "warehouse-uneven" and by_name["mean_throughput"] > 0.2
    assert by_name["valid"] is None and "verdict" not in by_name  # neither audited nor judged
    assert qdenv.simulate(path, **FLEET)["runs"] == by_name["runs"]
    assert qdenv.simulate(PLAN, domain="warehouse-uneven", **FLEET)["runs"] == by_name["runs"]
    as_lists = qdenv.simulate(PLAN.tolist(), domain="warehouse-even", **FLEET)
    assert as_lists["domain"] == "warehouse-even" and as_lists["layout"] == "layout"
    assert qdenv.simulate(qdenv.render(path), **FLEET)["runs"] == by_name["runs"]
    (only,) = qdenv.simulate(path, **{**FLEET, "seeds": [1]})["runs"]
    assert only == by_name["runs"][1]
    assert "<td>mean_throughput</td>" in by_name._repr_html_()


@pytest.mark.parametrize(
    ("layout", "settings", "said"),
    [
        (PLAN, {}, "an array does not say whose layout it is"),
        (PLAN + 3, {"domain": "warehouse-even"}, "0 to 3"),
        (PLAN[0], {"domain": "warehouse-even"}, "rows and columns"),
        (PLAN + 0.5, {"domain": "warehouse-even"}, "integers"),
        (PLAN, {"domain": "moon"}, "unknown domain 'moon'"),
        (PLAN, {"domain": 3}, "unknown domain 3: choose one of"),
        ("missing.json", {}, "missing.json"),
    ],
)
def test_what_is_no_layout_gives_one_line(layout, settings, said):
    for function in (qdenv.simulate, qdenv.repair, qdenv.check, qdenv.render):
        with pytest.raises(InputError) as refusal:
            function(layout, **settings)
        assert said in str(refusal.value) and "\n" not in str(refusal.value)


def test_repair_and_check_take_numbers_by_name(path):
    assert qdenv.check(path) == []
    (broken,) = qdenv.check(path, shelves=8)
    assert "8" in broken.message and 0 <= broken.row < 7 and 0 <= broken.column < 11
    repaired = qdenv.repair(path, shelves=8, polish="quick")
    assert (np.asarray(repaired) == 1).sum() == 8 and qdenv.check(repaired, shelves=8) == []
    assert repaired.facts["hamming"] == (repaired.layout != PLAN).sum() > 0
    assert "data:image/png;base64," in repaired._repr_html_()
    assert repr(repaired).startswith("Layout(7 x 11 of warehouse-uneven, status ")
    with pytest.raises(InputError, match="no repair exists"):
        qdenv.repair(path, shelves=70)


@pytest.mark.parametrize(
    ("stated", "said"),
    [
        ({"timesteps": 0}, "timesteps must be at least 1, not 0"),
        ({"timesteps": 2.0}, r"timesteps must be an integer, not 2\.0"),
        ({"agents": True}, "agents must be a number, not True"),
        ({"seconds_per_step": "2"}, "seconds-per-step must be a number"),
        ({"seeds": 3.0}, r"seeds '3\.0': write"),
        ({"tasks": {"demand": None}}, "demand: give rows of numbers, one for each cell"),
        ({"tasks": {"demand": np.ones((3, 3, 2))}}, "demand: give rows of numbers"),
        ({"tasks": {"demand": [[1, 2], [3]]}}, "demand: give rows of numbers"),
        ({"tasks": {"drop": {"w": 3}}}, "drop .*: write one number"),
        ({"tasks": {"pick": 1.5}}, r"pick must be an integer, not 1\.5"),
    ],
)
def test_python_checks_what_the_command_line_does(stated, said):
    hall = parse(("w.e", "..@", "..e"), ".@ew#io")
    with pytest.raises(InputError, match=said):
        qdenv.simulate(hall, domain="hall", **{"agents": 2} | stated)


def test_numbers_may_be_of_numpy(path):
    small = {"timesteps": np.int64(20), "seeds": np.array([3, 5])}
    table = qdenv.compare(str(path), np.array([2, 3]), **small)
    assert table.facts["settings"]["agents"] == [2, 3]
    with pytest.raises(InputError, match="names a number twice"):
        qdenv.compare(str(path), [2, 2], **small)


def test_mistakes_of_python_get_one_line_too(path):
    with pytest.raises(InputError, match=r"^plan: a layout of warehouse-uneven"):
        qdenv.evaluate_agent(qdenv.read_plan(path))
    with pytest.raises(InputError, match="domain: with a plan give a name"):
        qdenv.train("quick", plan=path, domain=ManufacturingConfig())
    for function, options in (
        (qdenv.simulate, {"planer": "pibt"}),
        (qdenv.compare, {"planer": "pibt"}),
        (qdenv.guide, {"seeds": 3}),
        (qdenv.improve, {"ailse": 2}),
        (qdenv.replay, {"seeds": 3}),
    ):
        with pytest.raises(InputError, match=r"unknown option '(planer|seeds|ailse)'"):
            function([path] if function is qdenv.compare else path, 2, **options)
    with pytest.raises(InputError, match="give tiles like"):
        qdenv.check(path, keep="0" * 300)
    with pytest.raises(InputError, match="unknown guidance"):
        qdenv.simulate(path, 2, guidance="0" * 300)
    for function in (qdenv.simulate, qdenv.sweep):
        with pytest.raises(InputError, match="width 50: write column"):
            function(path, 2, plot="a.png", width=50)
    with pytest.raises(InputError, match="an array: costs of moves have the shape"):
        qdenv.simulate(path, 2, guidance=[[1], [2, 3]])
    with pytest.raises(InputError, match=r"rows must be an integer, not 33\.5"):
        qdenv.layout_human(33.5, 36)
    with pytest.raises(InputError, match=r"unknown domain \['hall'\]: did you mean hall"):
        qdenv.layout_human(33, 36, domain=["hall"])
    with pytest.raises(TypeError, match="integer"):  # a seed is not cut off
        qdenv.repair(path, seed=1.5)
    with pytest.raises(InputError, match="tasks are settings by name"):
        qdenv.simulate(path, 2, tasks="pick=3")
    for none in ((), []):
        with pytest.raises(InputError, match="name each planner once"):
            qdenv.compare([path], 2, planner=none)


def test_compare_names_equal_names_apart(path):
    table = qdenv.compare([path, PLAN], agents=[2, 4], domain="warehouse-uneven", **PIBT)
    assert [(row.layout, row.agents) for row in table] == [
        ("plan", 2), ("plan", 4), ("layout", 2), ("layout", 4),
    ]  # fmt: skip
    assert table[1].mean_of_all == table[3].mean_of_all
    assert table.to_pandas()["agents"].tolist() == [2, 4, 2, 4]
    assert table._repr_html_().count("<tr>") == 5
    twice = qdenv.compare([path, path], agents=2, **PIBT)
    assert [row.layout for row in twice] == ["plan 1", "plan 2"]


def test_render_writes_a_picture_and_a_layout_saves_itself(path, tmp_path):
    drawn = qdenv.render(path, tmp_path / "plan.svg")
    assert (tmp_path / "plan.svg").read_text().startswith("<?xml")
    again = read_layout(drawn.save(tmp_path / "again.json"), TILES)
    np.testing.assert_array_equal(again, PLAN)


def test_an_environment_is_made_by_a_files_name(path):
    import jax

    environment = qdenv.make_environment(str(path), agents=5, timesteps=30)
    _, timestep = environment.reset(jax.random.key(0))
    assert timestep.observation.position.shape == (5,) and environment.actions == 5
    both = qdenv.make_environment([path, PLAN], agents=5, domain="warehouse-uneven")
    assert both.layout.shape == (2, *PLAN.shape) and (both.layout[0] == both.layout[1]).all()
    with pytest.raises(InputError, match="an array does not say"):
        qdenv.make_environment([])
    with pytest.raises(InputError, match="one size"):
        qdenv.make_environment([path, PLAN[1:]], domain="warehouse-uneven")
    with pytest.raises(InputError, match="no fleet drives"):
        qdenv.make_environment(np.zeros((5, 5), np.int8), domain="maze-walls")


def test_settings_are_replaced_by_name_however_deep_they_lie():
    quick = PRESETS["quick"]
    config = override(
        quick,
        {"evaluations": 7, "agents": 3, "shelves": 30, "hidden": 4, "alpha": 0.5, "sigma0": 0.4},
    )
    domain = config.evaluation.domain
    assert (config.evaluations, domain.fleet.agents, domain.shelves) == (7, 3, 30)
    assert (config.evaluation.generator.hidden, config.evaluation.alpha) == (4, 0.5)
    assert config.algorithm == replace(quick.algorithm, sigma0=0.4)
    other = override(quick, {"sigma_iso": 0.4, "algorithm": "map-elites", "planner": "pibt"})
    assert type(other.algorithm).__name__ == "MapElitesConfig" and other.algorithm.sigma_iso == 0.4
    assert type(other.evaluation.domain.fleet.planner).__name__ == "PibtConfig"
    factory = override(quick, {"domain": "manufacturing"}).evaluation.domain
    assert isinstance(factory, ManufacturingConfig) and (factory.rows, factory.cols) == (17, 16)
    for settings, said in (
        ({"agent": 3}, "did you mean agents"),
        ({"robots": 3}, "did you mean agents"),
        ({"evaluations": 0}, "at least 1"),
        ({"algorithm": "luck"}, "unknown algorithm 'luck'"),
        ({"evaluation__repair__luck": 1}, "RepairConfig has no setting 'luck'"),
        ({"evaluation__seed__luck": 1}, "EvaluationConfig has no setting 'seed'"),
    ):
        with pytest.raises(InputError, match=said):
            override(quick, settings)


def test_train_takes_a_name_and_overrides(tmp_path):
    run = qdenv.train(
        "quick", tmp_path / "run", progress=False, rows=9, cols=10, shelves=6, agents=6,
        timesteps=20, steps=6, hidden=4, emitters=2, batch=3, evaluations=6, seed=1, simulations=1,
    )  # fmt: skip
    assert run.config.evaluation.domain.fleet.agents == 6 and len(run.read_metrics()) == 1
    assert not list(run.path.glob("*.png"))
    grown = qdenv.generate(run, rows=14, cols=15)
    assert grown.layout.shape == (14, 15) and qdenv.check(grown) == []
    raw = qdenv.generate(str(run.path), elite=run.best, repair=False)
    assert raw.facts["elite"] == run.best.cell
    assert f"elite {','.join(map(str, run.best.cell))}" in repr(raw)
    with pytest.raises(InputError, match="steps must be at least 1, not -3"):
        qdenv.generate(run, steps=-3)
    with pytest.raises(InputError, match="unknown preset 'nothing'"):
        qdenv.train("nothing", tmp_path / "other")
    assert not (tmp_path / "other").exists()


def test_an_archive_is_asked_by_cell_and_by_measures(run):
    archive = run.archive
    columns = run.archive.columns
    assert len(archive) == len(columns["index"]) > 4 and archive.shape == (10, 6)
    assert archive.coverage == len(archive) / 60
    assert archive.qd_score == pytest.approx(run.read_metrics()[-1].qd_score, rel=1e-5)
    assert run.best.objective == columns["objective"].max() == archive.best.objective
    for row, cell in enumerate(archive.cells):
        text = ",".join(map(str, cell))
        found = run.elite(text)
        assert found.cell == tuple(cell) and run.elite(tuple(cell)).cell == found.cell
        np.testing.assert_array_equal(found.solution, columns["solution"][row])
        # Its own measures lead back to it.
        assert run.elite(measures=list(found.measures.values())).cell == found.cell
    spans = np.array([30.0, 6.0])
    rng = np.random.default_rng(0)
    for point in rng.uniform([-5, -1], [40, 8], (50, 2)):
        cell = tuple(np.clip(np.floor(point / spans * [10, 6]), 0, [9, 5]).astype(int))
        if cell not in set(map(tuple, archive.cells.tolist())):
            distance = (((columns["measures"] - point) / spans) ** 2).sum(axis=1)
            cell = tuple(archive.cells[np.argmin(distance)])
        assert run.elite(measures=point).cell == cell
    for wrong in ({"which": "nonsense"}, {"which": "99,99"}, {"measures": (1,)}, {"which": 3},
                  {"which": (0.5, 0.5)}, {"measures": (1, float("nan"))}):  # fmt: skip
        with pytest.raises(InputError):
            run.elite(**wrong)


def test_an_archive_reaches_pandas_and_pyribs(run):
    archive = run.archive
    frame = archive.to_pandas()
    assert list(frame.columns[:4]) == ["cell", "objective", "paths", "flowers on top"]
    assert {"similarity", "status", "seen_0", "seen_2"} <= set(frame.columns)
    assert run.elite(frame["cell"][0]).objective == pytest.approx(frame["objective"][0])
    assert "solution_0" in archive.to_pandas(solutions=True).columns
    pytest.importorskip("ribs", reason="needs pip install 'qdenv[pyribs]'")
    assert len(archive.to_ribs().data(return_type="pandas")) == len(archive)
    theirs = archive.to_ribs(["repaired"])
    assert len(theirs) == len(archive)
    assert theirs.stats.qd_score == pytest.approx(archive.qd_score, rel=1e-5)
    assert theirs.stats.coverage == archive.coverage
    rows = theirs.data()
    order = np.argsort(rows["index"])
    np.testing.assert_array_equal(rows["index"][order], archive.columns["index"])
    np.testing.assert_array_equal(rows["repaired"][order], archive.columns["repaired"])


def test_notebooks_show_a_run_its_archive_and_an_elite(run):
    assert "data:image/png;base64," in run._repr_html_()
    assert run._repr_html_().count("<img") == 2
    qd_score = run.read_metrics()[-1].qd_score
    assert repr(run).startswith(f"RunDirectory('{run}': 32 evaluations, QD-score {qd_score:.4g}, ")
    assert repr(run.archive).startswith(f"SavedArchive({len(run.archive)} elites, coverage ")
    assert repr(run.best).startswith("Elite(cell ") and "paths" in repr(run.best)
    assert "<img" in run.best._repr_html_()


def test_notebooks_escape_what_files_hold(run, tmp_path):
    place = tmp_path / "<script>"
    shutil.copytree(run.path, place)
    manifest = json.loads((place / "manifest.json").read_text())
    manifest["measures"][0]["name"] = "</p><img src=x onerror=alert(1)>"
    (place / "manifest.json").write_text(json.dumps(manifest))
    foreign = RunDirectory.open(place)
    shown = [foreign._repr_html_(), foreign.archive._repr_html_(), foreign.best._repr_html_()]
    (place / "archive.npz").write_bytes(b"")
    for page in (*shown, foreign._repr_html_()):
        assert "<script" not in page and "onerror=alert(1)>" not in page
    assert "&lt;img src=x onerror" in shown[0]


def test_a_run_without_an_archive_shows_what_is_wrong(tmp_path, run):
    for name in ("config.json", "manifest.json", "metrics.csv"):
        (tmp_path / name).write_bytes((run.path / name).read_bytes())
    bare = RunDirectory.open(tmp_path)
    assert "no archive was saved yet" in bare._repr_html_()
    with pytest.raises(InputError, match="no archive was saved yet"):
        _ = bare.archive


def test_export_writes_tables_and_every_layout(run, folder, capsys):
    assert command(["export", str(run.path), "--layouts", "plans"]) == 0
    assert "garden_elites.csv" in capsys.readouterr().out
    pandas = pytest.importorskip("pandas")
    frame = pandas.read_csv("garden_elites.csv")
    expected = run.archive.to_pandas()
    pandas.testing.assert_frame_equal(frame, expected, check_dtype=False, check_exact=False)
    files = sorted((folder / "plans").glob("*.json"))
    assert len(files) == len(run.archive)
    one = run.elite(files[0].stem.replace("_", ","))
    np.testing.assert_array_equal(read_layout(files[0], toy.TILES), one.layout)
    assert command(["export", str(run.path), "--solutions", "--out", "s.csv"]) == 0
    width = run.archive.columns["solution"].shape[1]
    assert len(pandas.read_csv("s.csv").columns) == len(frame.columns) + width


def test_missing_packages_are_named_with_what_installs_them(run, monkeypatch):
    archive = run.archive
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    makers = {
        "data": archive.to_pandas,
        "pyribs": archive.to_ribs,
        "dask": partial(Execution, "dask"),
    }
    for extra, make in makers.items():
        with pytest.raises(InputError, match=rf'pip install "qdenv\[{extra}\]"'):
            make()


def test_parquet_is_written_or_says_what_it_needs(run, tmp_path, capsys):
    out = tmp_path / "elites.parquet"
    code = command(["export", str(run.path), "--out", str(out)])
    try:
        import pyarrow.parquet
    except ImportError:
        assert code == 2 and not out.exists()
        said = capsys.readouterr().err
        assert 'pip install "qdenv[data]"' in said and said.count("\n") == 1
    else:
        assert code == 0
        assert pyarrow.parquet.read_table(out).num_rows == len(run.archive)
