"""Searches that cannot succeed are refused; what nobody stated follows the size."""

from dataclasses import replace

import pytest

from qdenv.configurations import PRESETS
from qdenv.domains.maze import MazeConfig
from qdenv.run.config import check, scale
from qdenv.simulation.mapf.settings import FleetConfig
from qdenv.types import InputError

QUICK, LAPTOP, MAZE = PRESETS["quick"], PRESETS["laptop"], PRESETS["maze-walls"]


def with_domain(config, **changes):
    fleet = {name: changes.pop(name) for name in ("agents", "timesteps") if name in changes}
    domain = replace(config.evaluation.domain, **changes)
    if fleet:
        domain = replace(domain, fleet=replace(domain.fleet, **fleet))
    return replace(config, evaluation=replace(config.evaluation, domain=domain))


@pytest.mark.parametrize("name", PRESETS)
def test_every_preset_is_feasible_and_follows_its_own_size_unchanged(name):
    check(PRESETS[name])
    assert scale(PRESETS[name], PRESETS[name], ()) == (PRESETS[name], "")


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"shelves": 1000}, "shelves must be at least 1000 but at most 204 fit"),
        ({"shelves": -1}, "shelves must be at least 0, not -1"),
        ({"agents": 233}, "at most 232 free cells"),  # 17 x 16 less 40 shelves
        ({"rows": 0}, "0 x 16: choose 1 to 1000"),
        ({"cols": 1001}, "17 x 1001: choose 1 to 1000"),
        ({"cols": 4}, "no room inside the frame"),
    ],
)
def test_what_no_layout_can_be_is_refused_in_one_line(changes, said):
    with pytest.raises(InputError, match=said) as refusal:
        check(with_domain(QUICK, **changes))
    assert "\n" not in str(refusal.value)
    check(with_domain(QUICK, agents=232))


@pytest.mark.parametrize(
    ("archive", "said"),
    [
        (((0, 40, 20),), "has 2, connected shelf components and environment entropy"),
        (((40, 0, 20), (0, 1, 20)), "40 to 0 in 20 cells is empty"),
        (((0, 40, 0), (0, 1, 20)), "in 0 cells is empty"),
        (((40, 80, 20), (0, 1, 20)), "layouts of 17 x 16 reach 0 to 40"),
        (((-9, 0, 20), (0, 1, 20)), "reach 0 to 40"),
    ],
)
def test_an_archive_that_nothing_can_fill_is_refused(archive, said):
    with pytest.raises(InputError, match=said):
        check(replace(QUICK, archive=archive))
    check(replace(QUICK, archive=((39, 80, 20), (0, 1, 20))))


def test_numbers_agents_steps_and_axes_follow_the_size():
    # Generated areas: 33 x 32 = 1056 cells and 65 x 64 = 4160.
    asked = with_domain(LAPTOP, rows=65, cols=68)
    followed, said = scale(asked, LAPTOP, ())
    domain, growth = followed.evaluation.domain, 4160 / 1056
    assert domain.shelves == round(240 * growth) == 945
    assert domain.fleet.agents == round(200 * growth) == 788
    assert followed.evaluation.generator.steps == round(50 * 65 / 33) == 98
    (low, high, cells), entropy = followed.archive
    assert (low, high, cells) == (140 * 945 / 240, 945, 100)
    assert entropy == (0, 1, 100)
    assert said == (
        "945 shelves, 788 agents, 98 steps of growth, connected shelf components from 551 to 945"
    )
    check(followed)


def test_what_was_stated_stays():
    asked = with_domain(LAPTOP, rows=20, cols=30, shelves=100, agents=50)
    given = {"rows", "cols", "shelves", "agents", "steps", "archive"}
    assert scale(asked, LAPTOP, given) == (asked, "")
    with pytest.raises(InputError, match=r"runs from 140 to 240, but .* reach 0 to 100"):
        check(asked)
    followed, _ = scale(asked, LAPTOP, given - {"archive"})
    assert followed.archive[0] == pytest.approx((140 * 100 / 240, 100, 100))


def test_shelves_alone_move_their_axis():
    followed, said = scale(with_domain(QUICK, shelves=20), QUICK, {"shelves"})
    assert followed.archive == ((0, 20, 20), (0, 1, 20))
    assert said == "connected shelf components from 0 to 20"


def test_a_maze_lasts_longer_where_it_is_larger():
    asked = with_domain(MAZE, rows=34, cols=34)
    followed, _ = scale(asked, MAZE, ())
    assert isinstance(followed.evaluation.domain, MazeConfig)
    assert followed.evaluation.domain.timesteps == 648 * 4
    assert followed.archive == ((0, 1024, 256), (0, 2592, 162))


@pytest.mark.parametrize(
    ("name", "shape", "agents", "shelves"),
    [
        ("warehouse-even", (101, 102), 1400, 2500),
        ("warehouse-uneven", (101, 102), 1000, 2500),
        ("manufacturing", (101, 102), 1800, None),
        ("maze-walls", (66, 66), None, None),
    ],
)
def test_a_search_at_the_evaluation_size_has_the_papers_numbers(name, shape, agents, shelves):
    base = PRESETS[name]
    asked = with_domain(base, rows=shape[0], cols=shape[1])
    followed, said = scale(asked, base, ())
    domain = followed.evaluation.domain
    assert followed.evaluation.generator.steps == 200 and "200 steps of growth" in said
    assert getattr(domain, "shelves", None) == shelves
    if agents:
        # A search simulates for 1,000 timesteps; 5,000 are for what is reported.
        assert (domain.fleet.agents, domain.fleet.timesteps) == (agents, 1000)
        stated = scale(with_domain(asked, fleet=FleetConfig(7)), base, {"agents", "steps"})[0]
        assert stated.evaluation.domain.fleet.agents == 7
        assert stated.evaluation.generator.steps == 50
    else:
        assert domain.timesteps == 8712 and "8712 timesteps" in said
