"""The explorer shows what the archive holds, and what it gives away makes the same layout again."""

import json
import shlex
import shutil

import numpy as np
import pytest

import qdenv
from qdenv.cli.main import run as command
from qdenv.domains.base import make_domain
from qdenv.generators import GENERATORS, GuidedNcaConfig
from qdenv.io.arrays import write_arrays
from qdenv.run.directory import RunDirectory
from qdenv.study.elites import grow_series, make_grower, spread
from qdenv.study.plans import read_plan
from qdenv.types import InputError
from qdenv.view.explorer import make_explorer, pack_bits
from qdenv.view.guidance import pack_arrows, preferences

pytestmark = pytest.mark.slow

READY = "document.body.dataset.ready !== undefined"
QUICK = ["--agents", "4", "--timesteps", "10", "--seeds", "1", "--planner", "pibt"]
PIXELS = """row => {
  const box = byId("plot").getBoundingClientRect();
  const [x, y] = pixelsOf(row);
  return [box.left + x, box.top + y];
}"""


def changed_run(run: RunDirectory, folder, manifest=None, config=None, columns=None):
    """Copy a run with other content in its files."""
    shutil.copytree(run.path, folder)
    for name, change in (("manifest.json", manifest), ("config.json", config)):
        if change:
            content = json.loads((folder / name).read_text())
            change(content)
            (folder / name).write_text(json.dumps(content))
    if columns:
        write_arrays(folder / "archive.npz", columns(run.archive.columns), compressed=True)
    return RunDirectory.open(folder)


def explored(run: RunDirectory, folder, growth=None):
    """Make a page of a run; give its file."""
    return make_explorer(run, growth).save(folder / "explorer.html")


@pytest.fixture(scope="module")
def page_file(small_run, tmp_path_factory):
    return explored(small_run, tmp_path_factory.mktemp("explorer"))


@pytest.fixture
def shown(page_file, opened):
    with opened(page_file, ready=READY) as page:
        yield page


def point(page, row, click=False):
    """Move the mouse onto an elite's cell, and click there."""
    place = page.evaluate(PIXELS, row)
    page.mouse.move(*place)
    if click:
        page.mouse.click(*place)
    page.wait_for_function("row => state.pointed === row", arg=row)


def wait_for_card(page, card, row):
    page.wait_for_selector(f"#card-{card} canvas[data-row='{row}']")


def colours_of(page, canvas):
    """Read the colour in the middle of each tile of a drawn layout, [rows, cols, 3]."""
    script = """name => {
      const canvas = document.querySelector(name), side = canvas.width / facts.cols;
      const copy = new OffscreenCanvas(canvas.width, canvas.height);
      const pen = copy.getContext("2d", {willReadFrequently: true});
      pen.drawImage(canvas, 0, 0);
      const pixels = pen.getImageData(0, 0, canvas.width, canvas.height).data;
      return Array.from({length: AREA}, (_, k) => {
        const [x, y] = [k % facts.cols, Math.floor(k / facts.cols)].map((at) => (at + 0.5) * side);
        const start = 4 * (Math.floor(y) * canvas.width + Math.floor(x));
        return [...pixels.slice(start, start + 3)];
      });
    }"""
    rows, cols = page.evaluate("[facts.rows, facts.cols]")
    return np.array(page.evaluate(script, canvas)).reshape(rows, cols, 3)


def painted(layout, page):
    """Paint a layout as the page should."""
    colours = [
        [int(one[k : k + 2], 16) for k in (1, 3, 5)] for one in page.evaluate("facts.colours")
    ]
    return np.array(colours)[layout]


def test_every_layout_before_and_after_the_repair_is_the_archives(shown, small_run):
    columns = small_run.archive.columns
    for row in range(len(columns["index"])):
        script = f"layoutsOf({row}).then(({{repaired, drawn}}) => [[...repaired], [...drawn]])"
        repaired, drawn = shown.evaluate(script)
        assert repaired == columns["repaired"][row].ravel().tolist()
        assert drawn == columns["unrepaired"][row].ravel().tolist()


def test_every_elite_grows_frame_by_frame_into_what_the_run_drew(shown, small_run):
    columns, config = small_run.archive.columns, small_run.config.evaluation
    domain = make_domain(config.domain)
    for row in range(len(columns["index"])):
        frames = shown.evaluate(f"growthOf({row}).then((frames) => frames.map((one) => [...one]))")
        assert frames[-1] == columns["unrepaired"][row].ravel().tolist()
        one_by_one = grow_series(config, domain, columns["solution"][row], [0, 1, 4])
        assert [frames[step] for step in (0, 1, 4)] == [one.ravel().tolist() for one in one_by_one]


def test_pointing_shows_an_elite_and_two_pins_stand_side_by_side(shown, small_run):
    columns = small_run.archive.columns
    best = int(columns["objective"].argmax())
    first, second = [row for row in range(len(columns["index"])) if row != best][:2]
    wait_for_card(shown, 0, best)
    assert (colours_of(shown, "#card-0 canvas") == painted(columns["repaired"][best], shown)).all()
    point(shown, first)
    wait_for_card(shown, 1, first)
    assert (colours_of(shown, "#card-1 canvas") == painted(columns["repaired"][first], shown)).all()
    point(shown, second, click=True)
    wait_for_card(shown, 1, second)
    assert shown.evaluate("state.pins") == [best, second]
    differ = columns["repaired"][best] != columns["repaired"][second]
    assert shown.inner_text("#differing") == f"{differ.sum()} of {differ.size} cells differ"
    # What is alike is paled, what differs keeps its colour.
    kept = colours_of(shown, "#card-1 canvas") == painted(columns["repaired"][second], shown)
    white = (painted(columns["repaired"][second], shown) == 255).all(axis=2)
    assert (kept.all(axis=2) == (differ | white)).all()
    point(shown, first)
    shown.wait_for_selector(f"#preview[data-row='{first}']")
    point(shown, second, click=True)
    assert shown.evaluate("state.pins") == [best, None]


def test_the_table_holds_the_numbers_of_the_archive(shown, small_run):
    columns = small_run.archive.columns
    best, other = np.argsort(-columns["objective"])[:2].tolist()
    point(shown, other)
    wait_for_card(shown, 1, other)
    lines = shown.eval_on_selector_all(
        "#table tr", "lines => lines.map((line) => [...line.cells].map((cell) => cell.innerText))"
    )
    table = {line[0]: line[1:] for line in lines}
    a, b, difference = (
        one.replace("\u2212", "-") for one in table["throughput [tasks per timestep]"]
    )
    assert [float(a), float(b)] == pytest.approx(columns["objective"][[best, other]], rel=1e-3)
    assert float(difference) == pytest.approx(
        columns["objective"][other] - columns["objective"][best], rel=1e-3
    )
    changed = (columns["repaired"][best] != columns["unrepaired"][best]).sum()
    assert table["cells changed by the repair"][0].startswith(f"{changed} (")
    # Half of the interval of two runs: Student's t with one degree of freedom.
    runs = columns["throughput"][best]
    half = 12.7062 * abs(runs[0] - runs[1]) / 2
    words = table["throughput in each of 2 runs, mean and 95 % interval"][0].split("\n")[0]
    assert float(words.split("\u00b1")[1]) == pytest.approx(half, rel=0.05)


def test_the_selector_colours_the_map_by_another_column(shown, small_run):
    columns = small_run.archive.columns
    offered = shown.eval_on_selector_all("#colour option", "all => all.map((one) => one.text)")
    assert offered[0] == "throughput [tasks per timestep]" and len(set(offered)) == len(offered)

    def drawn():
        grid = shown.evaluate("byId('plot').data[0].z.map((row) => [...row])")
        found = np.array(grid, float).T.ravel()
        return found[columns["index"]], np.isfinite(found).sum()

    np.testing.assert_allclose(drawn()[0], columns["objective"], rtol=1e-6)
    shown.select_option("#colour", label="similarity before and after repair [0 to 1]")
    shown.wait_for_function("facts.columns[state.colour].key === 'similarity'")
    values, filled = drawn()
    np.testing.assert_allclose(values, columns["similarity"], rtol=1e-6)
    assert filled == len(columns["index"])


def test_growth_plays_to_its_end_and_steps_back(shown):
    caption = "#drawn-caption"
    assert shown.inner_text(caption) == "grown: after 6 of 6 steps"
    shown.click("#back")
    assert shown.inner_text(caption) == "grown: after 5 of 6 steps"
    shown.fill("#step", "1")
    assert shown.inner_text(caption) == "grown: after 1 of 6 steps"
    shown.click("#play")
    shown.wait_for_function("byId('play').textContent === 'Play' && stepNow() === 6")
    drawn = shown.evaluate("[differing(state.frames[6], state.drawn).length, state.frames.length]")
    assert drawn == [0, 7]


def test_arrows_move_among_filled_cells_and_enter_pins(shown, small_run):
    best, cells = shown.evaluate("state.pins[0]"), small_run.archive.cells
    shown.focus("#map")
    moves = {"Right": (0, 1), "Left": (0, -1), "Up": (1, 1), "Down": (1, -1)}
    moved = []
    for key, (axis, sign) in moves.items():
        before = shown.evaluate("state.pointed ?? state.pins[0]")
        shown.keyboard.press(f"Arrow{key}")
        after = shown.evaluate("state.pointed ?? state.pins[0]")
        assert after == before or sign * (cells[after] - cells[before])[axis] > 0
        moved.append(after != before)
    assert sum(moved) >= 2
    other = shown.evaluate("pointAt(state.pins[0] === 0 ? 1 : 0), state.pointed")
    shown.keyboard.press("Enter")
    assert shown.evaluate("state.pins") == [best, other]


def test_what_is_saved_is_a_layout_file_and_the_command_makes_it_again(shown, small_run, tmp_path):
    archive = small_run.archive
    with shown.expect_download() as saved:
        shown.click("#card-0 .save")
    saved.value.save_as(tmp_path / saved.value.suggested_filename)
    plan = read_plan(tmp_path / saved.value.suggested_filename)
    assert not plan.assumed and plan.domain.name == "warehouse-even"
    assert (plan.layout == archive.best.layout).all()
    assert command(["simulate", str(tmp_path / saved.value.suggested_filename), *QUICK]) == 0

    shown.click("#card-0 .copy")
    line = shown.inner_text("#card-0 output code")
    assert line == f"qdenv generate {small_run} --elite {','.join(map(str, archive.best.cell))}"
    for row, cell in enumerate(archive.cells):
        words = shlex.split(shown.evaluate(f"commandOf({row})"))
        out = tmp_path / f"again{row}.json"
        assert command([*words[1:], "--out", str(out)]) == 0
        assert (read_plan(out).layout == archive.elite(tuple(cell)).layout).all()


def test_growth_that_is_not_in_the_page_is_named_with_the_command_that_adds_it(
    small_run, tmp_path, opened
):
    elites = len(small_run.archive)
    with opened(explored(small_run, tmp_path, growth=1), ready=READY) as page:
        assert page.inner_text("#growth-note") == ""  # the best is always among them
        other = page.evaluate("state.pins[0] === 0 ? 1 : 0")
        point(page, other, click=True)
        page.wait_for_selector(f"#drawn[data-row='{other}']")
        note = page.inner_text("#growth-note")
        assert f"not in the page, which has 1 of {elites}" in note
        assert note.endswith(f"qdenv explore {small_run} --growth {elites}")
        assert page.is_hidden("#player")
        page.set_viewport_size({"width": 420, "height": 860})  # a phone
        page.wait_for_function("document.documentElement.scrollWidth === 420")


def test_growth_that_ends_otherwise_than_in_the_run_says_so(small_run, tmp_path, opened):
    def turned(columns):
        drawn = columns["unrepaired"].copy()
        drawn[:, 0, :3] = (drawn[:, 0, :3] + 1) % 4
        return columns | {"unrepaired": drawn}

    run = changed_run(small_run, tmp_path / "run", columns=turned)
    with opened(explored(run, tmp_path), ready=READY) as page:
        assert page.inner_text("#growth-note").endswith("otherwise than in the run, in 3 cells.")


def test_a_run_that_searched_tiles_says_that_nothing_grew(small_run, tmp_path, opened):
    def direct(config):
        config["evaluation"]["generator"] = {"name": "direct"}

    run = changed_run(small_run, tmp_path / "run", config=direct)
    with opened(explored(run, tmp_path), ready=READY) as page:
        assert page.inner_text("#growth-note").endswith("tiles themselves: nothing grew.")
        assert page.is_hidden("#play") and page.is_visible("#repaired")


def test_an_archive_of_one_measure_is_a_strip(small_run, tmp_path, opened):
    def first_axis(columns):
        along, rows = np.unique(columns["index"] // 5, return_index=True)
        kept = {name: column[rows] for name, column in columns.items()}
        return kept | {"index": along, "measures": kept["measures"][:, :1]}

    run = changed_run(
        small_run, tmp_path / "run", lambda one: one["measures"].pop(), columns=first_axis
    )
    with opened(explored(run, tmp_path), ready=READY) as page:
        assert page.evaluate("byId('plot').data[0].z.length") == 1
        last = len(run.archive) - 1
        point(page, last, click=page.evaluate("state.pins[0]") != last)
        assert page.evaluate(f"commandOf({last})").endswith(f"--elite {run.archive.cells[last][0]}")


def test_more_than_two_measures_and_no_elite_are_refused(small_run, tmp_path):
    def third(manifest):
        manifest["measures"].append({"name": "height", "low": 0, "high": 1, "cells": 1})

    def deep(columns):
        return columns | {"measures": np.pad(columns["measures"], ((0, 0), (0, 1)))}

    with pytest.raises(InputError, match="one or two measures, not 3"):
        make_explorer(changed_run(small_run, tmp_path / "deep", third, columns=deep))
    empty = changed_run(
        small_run, tmp_path / "empty", columns=lambda all_: {k: v[:0] for k, v in all_.items()}
    )
    with pytest.raises(InputError, match="the archive is empty"):
        make_explorer(empty)


def test_a_notebook_shows_the_page_and_the_command_writes_it(small_run, tmp_path, capsys):
    page = qdenv.explore(small_run, growth=0)
    assert page._repr_html_().startswith("<iframe srcdoc=")
    facts = tmp_path / "facts.json"
    line = f"explore {small_run} --growth 2 --out {tmp_path / 'mine.html'} --json {facts}"
    assert command(line.split()) == 0
    said = json.loads(facts.read_text())
    assert said["elites"] == len(small_run.archive) and said["growth"] == 2
    assert said["growth_differing"] == 0
    assert (
        f"{tmp_path / 'mine.html'}: {said['elites']} elites, 2 of them grow"
        in capsys.readouterr().out
    )
    assert (tmp_path / "mine.html").stat().st_size == pytest.approx(
        1e6 * said["megabytes"], rel=1e-4
    )


@pytest.mark.parametrize("bits", [1, 2, 4, 8])
def test_tiles_are_packed_with_the_first_in_the_lowest_bits(bits):
    tiles = np.random.default_rng(bits).integers(0, 2**bits, (3, 13), np.uint8)
    numbers = [int.from_bytes(row.tobytes(), "little") for row in pack_bits(tiles, bits)]
    for number, row in zip(numbers, tiles, strict=True):
        assert number == sum(int(tile) << (bits * place) for place, tile in enumerate(row))


def test_the_first_of_a_spread_lie_in_all_corners():
    cells = np.stack(np.unravel_index(np.arange(100), (10, 10)), axis=-1)
    order = list(spread(cells, 44))
    assert order[0] == 44 and sorted(order) == list(range(100))
    assert set(order[1:5]) == {0, 9, 90, 99}


def test_a_generator_that_tells_only_how_it_ends_grows_frame_by_frame_too(small_run, monkeypatch):
    config = small_run.config.evaluation
    domain, solutions = make_domain(config.domain), small_run.archive.columns["solution"][:2]
    steps, grow = make_grower(config, domain)
    whole = grow(solutions)
    made = GENERATORS.make
    monkeypatch.setattr(
        type(GENERATORS), "make", lambda self, *given: made(*given)._replace(frames=None)
    )
    assert steps == 6 and whole.shape == (2, 7, 9, 10)
    assert (make_grower(config, domain)[1](solutions) == whole).all()


def test_guidance_lies_on_layouts_of_elites_that_drew_costs(small_run, page_file, tmp_path, opened):
    assert "guidance" not in page_file.read_text()
    settings = small_run.config.evaluation.generator
    guided = GuidedNcaConfig(**vars(settings))
    config, archive = small_run.config.evaluation, small_run.archive
    domain = make_domain(config.domain)
    generator = GENERATORS.make(guided, domain.canvas)
    elites, layouts = len(archive), archive.columns["repaired"]
    solutions = np.random.default_rng(0).normal(0, 0.5, (elites, generator.size)).astype("f4")

    def change(content):
        content["evaluation"]["generator"] |= {"name": "guided-nca", "base": "crisscross"}

    run = changed_run(
        small_run, tmp_path / "run", None, change, lambda old: {**old, "solution": solutions}
    )
    with opened(explored(run, tmp_path, growth=0), ready=READY) as page:
        for row in range(elites):
            costs = generator.guide(solutions[row], generator.steps, layouts[row], None)
            free = layouts[row] != archive.schema.tiles.index("@")
            expected = pack_arrows(preferences(np.asarray(costs), free))
            found = page.evaluate(f"layoutsOf({row}).then(({{arrows}}) => [...arrows])")
            assert found == expected.reshape(-1).tolist() and set(found) != {0x88}
        canvas = "document.querySelector('#card-0 canvas').toDataURL()"
        with_arrows = page.evaluate(canvas)
        page.locator("#guidance").click()
        page.wait_for_function(f"before => {canvas} !== before", arg=with_arrows)
        page.locator("#guidance").click()
        page.wait_for_function(f"before => {canvas} === before", arg=with_arrows)
