"""The replay holds exactly what the simulator recorded, and shows it when it is asked to."""

import json
from importlib import util

import numpy as np
import pytest
from halls import ell
from small_warehouse import ROWS, TILES

import qdenv
from qdenv.cli.main import run
from qdenv.domains.base import find_domain
from qdenv.grid import parse
from qdenv.guidance import crisscross
from qdenv.simulation.mapf.settings import FleetConfig
from qdenv.study.plans import Plan, read_plan, with_tasks
from qdenv.study.recordings import record_fleet, trace_agent
from qdenv.types import InputError
from qdenv.view.guidance import pack_arrows, preferences
from qdenv.view.replay import encode, make_replay

pytestmark = pytest.mark.slow

STEPS, AGENTS = 60, 30
MAZE = ["XXXXXX", "X    X", "XXXX X", "X    X", "XXXXXX"]
# Where the tip of an arrow in a cell of 100 pixels is, from its middle: [right, down].
TIP = """([level, axis]) => {
  const points = [];
  const pen = {beginPath() {}, lineTo: (...point) => points.push(point), fill() {}};
  drawArrow(pen, level, axis, 0, 0, 100);
  return points[0];
}"""
SHOWN = "performance.getEntriesByName('shown').length > 0"


def warehouse():
    return Plan("small", parse(ROWS, TILES), find_domain("warehouse-even"), assumed=False)


@pytest.fixture(scope="module")
def busy(tmp_path_factory):
    """Thirty robots in a warehouse of 7 x 11: the page, what was recorded, what was counted."""
    plan = warehouse()
    motion, traffic = record_fleet(plan, FleetConfig(AGENTS, STEPS, stop_when_congested=False))
    path = tmp_path_factory.mktemp("replay") / "busy.html"
    make_replay(plan, motion, traffic, ["thirty robots"]).save(path)
    return path, motion, traffic


@pytest.fixture
def shown(busy, opened):
    with opened(busy[0], ready=SHOWN) as page:
        yield page


def pixels(page, canvas):
    """Read what a canvas shows."""
    return page.evaluate(f"byId('{canvas}').toDataURL()")


def check_film(page, motion, traffic):
    """Compare what the browser decoded with the recording, number by number."""
    film = page.evaluate(
        "Object.fromEntries(['position', 'goal', 'waited', 'finishedBy', 'waitsBy']"
        ".map((name) => [name, [...state.film[name]]]))"
    )
    np.testing.assert_array_equal(film["position"], motion.positions.reshape(-1))
    np.testing.assert_array_equal(film["goal"], motion.goals.reshape(-1) & 0xFFFF)
    waited, since = [], np.zeros(motion.positions.shape[1], int)
    for waits in motion.waits:
        since = np.where(waits, since + 1, 0)
        waited.append(since)
    np.testing.assert_array_equal(film["waited"], np.concatenate(waited))
    done = np.concatenate([[0], np.cumsum(traffic.finished)])
    np.testing.assert_array_equal(film["finishedBy"], done)
    np.testing.assert_array_equal(film["waitsBy"][-1], motion.waits.sum())


def test_the_browser_decodes_every_position_goal_wait_and_task(busy, shown):
    _, motion, traffic = busy
    assert motion.waits.any() and traffic.finished.sum() > 20
    check_film(shown, motion, traffic)


def test_stays_at_goals_are_service_not_waiting(own_layout, tmp_path, opened):
    plan = read_plan(own_layout("manufacturing_human_57x58"))
    motion, traffic = record_fleet(plan, FleetConfig(40, 60))
    path = make_replay(plan, motion, traffic).save(tmp_path / "factory.html")
    still = motion.positions[1:] == motion.positions[:-1]
    served = still & ~motion.waits
    step, agent = np.argwhere(served & (np.arange(60) > 20)[:, None])[0]
    with opened(path, ready=SHOWN) as page:
        check_film(page, motion, traffic)
        page.evaluate(f"goTo({step + 1}), follow({agent})")
        assert f"Robot {agent}, being served, at row" in page.inner_text("#doing")


def test_robots_without_an_order_have_no_goal(tmp_path, opened):
    (tmp_path / "hall.txt").write_text("\n".join(ell()))
    plan = with_tasks(read_plan(tmp_path / "hall.txt"), {"task_rate": 0.5})
    motion, traffic = record_fleet(plan, FleetConfig(20, 60))
    path = make_replay(plan, motion, traffic).save(tmp_path / "idle.html")
    agent = int((motion.goals[40] < 0).argmax())
    assert motion.goals[40, agent] < 0 and traffic.finished.sum() > 3
    begins = (motion.goals[9:-3] < 0) & (motion.goals[10:-2] >= 0)
    goes_on = motion.goals[10:-2] == motion.goals[12:]
    time, busy = (np.argwhere(begins & goes_on)[0] + [10, 0]).tolist()
    with opened(path, ready=SHOWN) as page:
        check_film(page, motion, traffic)
        page.evaluate(f"byId('goals').checked = true, goTo(40), follow({agent})")
        assert "its goal" not in page.inner_text("#doing")
        page.evaluate(f"goTo({time + 2}), follow({busy})")
        assert page.inner_text("#doing").split(". ")[0].endswith(", on the way for 2")


def test_numbers_are_those_of_the_run_at_every_timestep(busy, shown):
    _, motion, traffic = busy
    for time in (0, 1, 17, STEPS):
        shown.evaluate(f"goTo({time})")
        done = int(traffic.finished[:time].sum())
        waiting = int(motion.waits[time - 1].sum()) if time else 0
        assert shown.inner_text("#count-step") == str(time)
        assert shown.inner_text("#count-tasks") == str(done)
        assert shown.inner_text("#count-waiting").startswith(f"{waiting} (")
        rate = f"{done / time:.3f}" if time else "-"
        assert shown.inner_text("#count-throughput") == rate
    assert rate == f"{float(traffic.throughput):.3f}"


def test_waiting_is_counted_up_to_what_a_byte_holds(busy, shown):
    step, agent = np.argwhere(busy[1].waits)[0]
    shown.evaluate(f"state.film.waited.fill(255), goTo({step + 1}), follow({agent})")
    assert "waiting for 255 or more timesteps, at row" in shown.inner_text("#doing")


def test_playing_advances_and_pausing_holds(shown):
    first = pixels(shown, "robots")
    shown.select_option("#speed", "16")
    shown.click("#play")
    assert shown.inner_text("#play") == "Pause"
    shown.wait_for_function("Number(byId('count-step').textContent) >= 3", timeout=20_000)
    shown.keyboard.press("Space")  # the button has the focus
    assert shown.inner_text("#play") == "Play"
    step, later = shown.inner_text("#count-step"), pixels(shown, "robots")
    shown.wait_for_timeout(200)
    assert later != first
    assert (shown.inner_text("#count-step"), pixels(shown, "robots")) == (step, later)


def test_playing_ends_at_the_end_and_begins_anew(shown):
    shown.evaluate(f"goTo({STEPS - 1})")
    shown.select_option("#speed", "64")
    shown.click("#play")
    shown.wait_for_function("byId('play').textContent === 'Play'", timeout=20_000)
    assert shown.inner_text("#clock") == f"{STEPS} / {STEPS}"
    shown.click("#play")
    shown.wait_for_function(f"Number(byId('count-step').textContent) < {STEPS}", timeout=20_000)


def test_between_two_timesteps_robots_are_between_two_cells(busy, shown):
    _, motion, _ = busy
    rows, cols = divmod(motion.positions[[20, 21]], 11)
    for agent in range(AGENTS):
        column, row = shown.evaluate(f"placeOf(state.film, {agent}, 20.25)")
        part = np.array([0.75, 0.25])
        assert (row, column) == pytest.approx(
            (part @ rows[:, agent] + 0.5, part @ cols[:, agent] + 0.5)
        )


def test_scrubbing_keys_and_clicks_on_charts_choose_the_time(shown):
    shown.evaluate("byId('scrub').value = 31; byId('scrub').dispatchEvent(new Event('input'))")
    assert shown.inner_text("#clock") == f"31 / {STEPS}"
    for key, time in (("ArrowRight", 32), ("ArrowLeft", 31), ("End", STEPS), ("Home", 0)):
        shown.keyboard.press(key)
        assert shown.inner_text("#count-step") == str(time)
    shown.click("#next")
    shown.click("#next")
    shown.click("#back")
    assert shown.inner_text("#count-step") == "1"
    box = shown.locator("#chart-throughput").bounding_box()
    at = shown.evaluate("chartX(45) / CHART.width")
    shown.mouse.click(box["x"] + at * box["width"], box["y"] + box["height"] / 2)
    assert abs(int(shown.inner_text("#count-step")) - 45) <= 1
    shown.keyboard.press("ArrowUp")
    assert shown.input_value("#speed") == "8"


def test_a_click_on_a_robot_follows_it_and_its_number_does(busy, shown):
    _, motion, _ = busy
    shown.evaluate("goTo(40)")
    plain, box = pixels(shown, "robots"), shown.locator("#stage").bounding_box()
    x, y = shown.evaluate(
        "(([column, row]) => [state.view.x + column * state.view.scale,"
        " state.view.y + row * state.view.scale])(placeOf(state.film, 7, 40))"
    )
    shown.mouse.click(box["x"] + x, box["y"] + y)
    row, column = divmod(int(motion.positions[40, 7]), 11)
    goal = divmod(int(motion.goals[40, 7]), 11)
    said = shown.inner_text("#doing")
    doing = "waiting for" if motion.waits[39, 7] else "driving"
    assert said.startswith(f"Robot 7, {doing}") and f"row {row}, column {column}" in said
    assert f"its goal: row {goal[0]}, column {goal[1]}" in said
    assert f"{motion.finished[:40, 7].sum()} task" in said
    assert shown.input_value("#robot") == "7" and pixels(shown, "robots") != plain
    shown.fill("#robot", "12")
    assert shown.inner_text("#doing").startswith("Robot 12, ")
    shown.click("#nobody")
    assert shown.inner_text("#doing").startswith("No robot is followed")
    assert pixels(shown, "robots") == plain


def test_goals_jams_and_what_lies_on_the_floor_can_be_shown(busy, shown):
    _, motion, _ = busy
    waited = shown.evaluate("Math.max(...state.film.waited)")
    assert waited >= 5, "nobody waits for long: choose a fuller warehouse"
    jam = shown.evaluate("state.film.waited.findIndex((one) => one >= 5)") // AGENTS + 1
    shown.evaluate(f"goTo({jam})")
    plain = pixels(shown, "robots")
    for name in ("goals", "jams"):
        shown.locator(f"#{name}").click()
        assert pixels(shown, "robots") != plain
        shown.locator(f"#{name}").click()
        assert pixels(shown, "robots") == plain
    floor = pixels(shown, "ground")
    shown.select_option("#overlay", "usage")
    early = pixels(shown, "ground")
    shown.evaluate(f"goTo({STEPS})")
    late = pixels(shown, "ground")
    assert len({floor, early, late}) == 3
    usage = np.bincount(motion.positions[1:].reshape(-1), minlength=77)
    assert shown.evaluate("[...state.ground.counts.usage.cells]") == usage.tolist()
    shown.evaluate(f"goTo({jam})")  # back in time
    assert pixels(shown, "ground") == early
    shown.select_option("#overlay", "waiting")
    shown.evaluate(f"goTo({STEPS})")
    waits = np.bincount(motion.positions[1:][motion.waits], minlength=77)
    assert shown.evaluate("[...state.ground.counts.waiting.cells]") == waits.tolist()


def test_guidance_lies_on_the_floor_where_a_plan_has_some(busy, tmp_path, opened):
    path, motion, traffic = busy
    assert "guidance" not in path.read_text()
    plan = warehouse()
    free = plan.layout != TILES.index("@")
    guided = make_replay(plan._replace(costs=crisscross(free)), motion, traffic, ["thirty robots"])
    with opened(guided.save(tmp_path / "guided.html"), ready=f"{SHOWN} && arrowBytes") as shown:
        expected = pack_arrows(preferences(crisscross(free), free))
        assert shown.evaluate("[...arrowBytes]") == expected.reshape(-1).tolist()
        for level, axis, tip in (
            (7, 0, (45, 0)), (-7, 0, (-45, 0)), (7, 1, (0, 45)), (-7, 1, (0, -45))
        ):  # fmt: skip
            assert shown.evaluate(TIP, [level, axis]) == pytest.approx(tip)
        with_arrows = pixels(shown, "ground")
        shown.locator("#guidance").click()
        without = pixels(shown, "ground")
        shown.locator("#guidance").click()
        assert pixels(shown, "ground") == with_arrows != without
        shown.keyboard.press("+")
        near = pixels(shown, "ground")
        shown.keyboard.press("0")
        assert pixels(shown, "ground") == with_arrows != near
    with opened(path, ready=SHOWN) as shown:
        assert pixels(shown, "ground") == without


def test_congested_time_is_marked_and_a_run_that_it_ends_says_so(tmp_path, opened):
    rows = ["@@@@@@@@", "w.....ee", "@@@@@@@@"]  # nobody passes anybody
    plan = warehouse()._replace(layout=parse(rows, TILES))
    page = qdenv.replay(plan, agents=6, timesteps=40, effort="low", stop=False)
    motion, traffic = record_fleet(plan, FleetConfig(6, 40, stop_when_congested=False))
    begin, end = motion.congested[0]
    with opened(page.save(tmp_path / "jam.html"), ready=SHOWN) as shown:
        band = shown.locator("#chart-waiting rect").first
        assert band.locator("title").text_content() == f"congested from {begin} to {end}"
        assert float(band.get_attribute("x")) == pytest.approx(shown.evaluate(f"chartX({begin})"))
        said = f"congested at {traffic.congested_at}, and went on"
        assert said in shown.inner_text("header")
    ended = qdenv.replay(plan, agents=6, timesteps=40, effort="low")
    assert f"congested at {traffic.congested_at}, which ended the run" in ended.html


def test_the_view_can_be_enlarged_moved_and_fitted(shown):
    whole = pixels(shown, "ground")
    shown.keyboard.press("+")
    near = pixels(shown, "ground")
    box = shown.locator("#stage").bounding_box()
    shown.mouse.move(box["x"] + 300, box["y"] + 300)
    shown.mouse.down()
    shown.mouse.move(box["x"] + 200, box["y"] + 240)
    shown.mouse.up()
    assert len({whole, near, pixels(shown, "ground")}) == 3
    assert shown.inner_text("#doing").startswith("No robot is followed")  # a drag is no click
    shown.keyboard.press("0")
    assert pixels(shown, "ground") == whole


def test_a_walk_through_a_maze_is_replayed_likewise(tmp_path, opened):
    plan = Plan("maze", parse(MAZE, " X"), find_domain("maze-walls"), assumed=False)
    motion = trace_agent(plan, seed=1)
    page = qdenv.replay(plan, seed=1)
    with opened(page.save(tmp_path / "maze.html"), ready=SHOWN) as shown:
        found = shown.evaluate("[...state.film.position]")
        assert found == motion.positions.reshape(-1).tolist()
        assert shown.evaluate("[...state.film.headings]") == motion.headings.tolist()
        assert shown.inner_text("#count-goal") == "not yet"
        first = pixels(shown, "robots")
        shown.keyboard.press("End")
        assert shown.inner_text("#count-goal") == "reached"
        assert shown.inner_text("#count-shortest") == "8 moves"
        assert shown.inner_text("#count-cells") == str(len(set(found)))
        assert pixels(shown, "robots") != first
        assert shown.locator("#chart-throughput").count() == 0


def test_the_command_writes_the_page_films_and_facts(folder, capsys):
    (folder / "plan.txt").write_text("\n".join(ROWS))
    line = "replay plan.txt --agents 8 --timesteps 20 --effort low --seed 4 --gif a.GIF --last 6"
    assert run([*line.split(), "--mp4", "film.mp4", "--json", "facts.json"]) == 0
    said = capsys.readouterr().out.splitlines()
    assert said[-4:] == ["plan_replay.html", "a.GIF", "film.mp4", "facts.json"]
    facts = json.loads((folder / "facts.json").read_text())
    again = qdenv.simulate("plan.txt", agents=8, timesteps=20, seeds=[4], effort="low")
    assert facts["throughput"] == pytest.approx(again["mean_of_all"], rel=1e-5)
    assert (facts["page"], facts["gif"]) == ("plan_replay.html", "a.GIF")
    assert facts["megabytes"] < 0.2 and facts["settings"]["seed"] == 4


def test_in_python_the_page_shows_itself():
    page = qdenv.replay(warehouse(), agents=5, timesteps=10, effort="low")
    assert page.title == "Replay of small" and "<iframe" in page._repr_html_()


def test_a_missing_package_is_named_before_anything_runs(folder, monkeypatch, capsys):
    (folder / "plan.txt").write_text("\n".join(ROWS))
    monkeypatch.setattr("qdenv.study.engine._program", lambda *how: pytest.fail("simulated"))
    find = util.find_spec
    for gone, line, said in (
        ("imageio_ffmpeg", "--mp4", 'films need imageio-ffmpeg: pip install "qdenv[viz]"'),
        ("jinja2", "--gif", 'pages need jinja2: pip install "qdenv[viz]"'),
    ):
        monkeypatch.setattr(
            util, "find_spec", lambda name, gone=gone: None if name == gone else find(name)
        )
        assert run(["replay", "plan.txt", "--agents", "5", line]) == 2
        assert capsys.readouterr().err == f"qdenv: {said}\n"
    assert [path.name for path in folder.iterdir()] == ["plan.txt"]


def test_a_robot_that_jumps_cannot_be_encoded(busy):
    _, motion, _ = busy
    positions = motion.positions.copy()
    positions[9:, 3] += 2
    with pytest.raises(InputError, match="robot 3 moves by more than one cell after timestep 8"):
        encode(motion._replace(positions=positions), 11)
