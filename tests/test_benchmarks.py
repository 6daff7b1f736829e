"""Benchmarks: what they compare with and estimate."""

import json
from types import SimpleNamespace

import numpy as np
import pytest

import qdenv
from experiments.benchmarks import common, search
from experiments.benchmarks.pages import find_browser, pages
from experiments.benchmarks.simulation import scale, simulate
from experiments.benchmarks.training import shortest_time
from qdenv.study import options
from qdenv.surrogates.settings import SurrogateConfig
from qdenv.view.page import make_page

pytestmark = pytest.mark.slow


def test_the_fastest_call_counts_and_the_first_stands_apart(monkeypatch):
    now, seconds = [0.0], iter([4.0, 2.0, 1.0, 3.0])

    def call() -> None:
        now[0] += next(seconds)

    clock = SimpleNamespace(process_time=lambda: now[0], perf_counter=lambda: 10 * now[0])
    monkeypatch.setattr(common, "time", clock)
    timing = common.best_of(3, call, items=2)
    expected = {"cpu_ms": 500, "wall_ms": 5000, "worst_cpu_ms": 1500, "first_cpu_s": 4}
    assert timing == expected


def test_a_table_has_the_numbers_and_texts_of_its_rows(capsys):
    rows = [{"name": "a", "cost": 1234.567, "each": [1, 2]}, {"name": "b", "cost": None}]
    assert common.show("costs", iter(rows)) == rows
    lines = [line.split() for line in capsys.readouterr().out.splitlines()]
    assert lines == [[], ["costs"], ["name", "cost"], ["a", "1235"], ["b", "None"]]


def test_fleets_are_compared_with_recorded_runs(tmp_path):
    layout = qdenv.find_domain("warehouse-even").human()
    (tmp_path / "layouts").mkdir()
    qdenv.render(layout, domain="warehouse-even").save(tmp_path / "layouts" / "a.json")
    record = {"layout": "a.json", "domain": "warehouse_even", "n_agents": 5, "T": 20, "cpu_s": 4.0}
    records = [record | {"throughput": rate, "congested": False} for rate in (0.1, 0.3)]
    reference = tmp_path / "runs.json"
    reference.write_text(json.dumps({"records": [*records, record | {"T": 5000}]}))
    result = simulate(reference, planners=("low",), seeds=2, audit=True, json=tmp_path / "x.json")
    assert json.loads((tmp_path / "x.json").read_text()) == result
    (row,) = result["fleets"]
    options = {"domain": "warehouse-even", "timesteps": 20, "effort": "low"}
    own = [qdenv.simulate(layout, 5, True, seeds=(seed,), **options) for seed in range(2)]
    assert row["throughputs"] == [runs["mean_of_all"] for runs in own]
    assert row["C++"] == pytest.approx(0.2) and row["broken"] == 0
    assert row["ratio"] == pytest.approx(row["throughput"] / 0.2)
    assert row["cpu ratio"] == 4.0 / row["cpu_s"]
    reference.write_text('{"records": [{}]}')
    with pytest.raises(qdenv.InputError, match="no file of recorded runs"):
        simulate(reference)
    with pytest.raises(qdenv.InputError, match="timesteps must be above 5"):
        scale(timesteps=5)


def test_the_shortest_time_of_a_cluster_counts_its_waits():
    lengths = [[1.0, 3.0], [1.0, 1.0]]
    assert shortest_time(np.array(lengths), workers=2, ahead=0) == 4.0
    assert shortest_time(np.array(lengths), workers=2, ahead=1) == 3.0


def test_an_outer_loop_is_estimated_from_iterations_and_steps():
    rows = [{"cpu_ms": 250.0, "wall_ms": 500.0}] * 3
    hours = search.outer_loop_hours(rows, 100, epochs=2, samples=65)  # two steps an epoch
    assert hours["wall"] * 3600 == pytest.approx(50 + 4)
    assert hours["cpu"] * 3600 == pytest.approx(25 + 2)


@pytest.mark.parametrize(
    ("preset", "shape", "kinds", "repairs", "size"),
    [("warehouse-even", (33, 36), 4, True, 33 * 32), ("maze-walls", (18, 18), 2, False, 256)],
)
def test_a_preset_decides_what_is_searched(preset, shape, kinds, repairs, size):
    problem = search.search_problem(preset)
    encoding = problem.encoding
    assert (encoding.shape, encoding.kinds, encoding.repairs) == (shape, kinds, repairs)
    assert problem.solution_dim == size and len(problem.measures) == 2


def test_every_network_of_a_surrogate_is_timed(tmp_path, monkeypatch):
    tiny = SurrogateConfig(channels=1, blocks=0)
    monkeypatch.setitem(options._SURROGATES, "small", tiny)
    result = search.surrogate(preset="maze-quick", rounds=1, repeats=1, json=tmp_path / "x.json")
    assert json.loads((tmp_path / "x.json").read_text()) == result
    loops = [row["loop"] for row in result["timings"]]
    assert loops == ["inner iteration", "training step, score", "training step, usage"]
    assert all(row["cpu_ms"] > 0 and row["first_cpu_s"] > 0 for row in result["timings"])
    with pytest.raises(qdenv.InputError, match="unknown preset"):
        search.surrogate(preset="no-such-preset")


def test_the_benchmark_of_pages_reports_size_paint_and_frames(tmp_path):
    if find_browser() is None:
        pytest.skip("no Chromium on this machine (Debian: apt install chromium)")
    page = make_page("page", "A page", facts={"long": "x" * 10_000}).save(tmp_path / "page.html")
    result = pages((page,), seconds=0.3, repeats=1, json=tmp_path / "pages.json")
    (row,) = result["pages"]
    assert row["megabytes"] == page.stat().st_size / 1e6
    assert row["complaints"] == [] and row["loaded_ms"] > 0
    assert 5 < row["frames_per_second"] < 200
    assert json.loads((tmp_path / "pages.json").read_text()) == result
