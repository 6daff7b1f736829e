"""Layout files and their domains: what the file says, what its tiles tell, what contradicts."""

import dataclasses
import json

import numpy as np
import pytest

from qdenv.domains.base import DOMAINS, DomainConfig, find_domain
from qdenv.io.layouts import write_layout
from qdenv.registry import Entry
from qdenv.study.plans import read_plan
from qdenv.types import InputError

WAREHOUSE = ["w..@e", "...ee", "w..@e"]
FACTORY = ["e0e.", "e1e.", "e2e."]
MAZE = ["XXXX", "X  X", "XXXX"]


def save(path, rows, **details):
    if path.suffix == ".json":
        path.write_text(json.dumps({"layout": rows, **details}))
    else:
        path.write_text("\n".join(rows) + "\n")
    return path


@pytest.mark.parametrize("name", ["warehouse-even", "warehouse-uneven", "manufacturing"])
def test_a_file_that_says_its_domain_has_it(name, tmp_path):
    domain = find_domain(name).resized(12, 14)
    path = tmp_path / "own.json"
    write_layout(path, domain.human(), domain.tiles, domain.meanings, domain=name)
    plan = read_plan(path)
    assert (plan.name, plan.domain.name, plan.assumed) == ("own", name, False)
    assert plan.whose == f"domain {name}"
    np.testing.assert_array_equal(plan.layout, domain.human())


@pytest.mark.parametrize("ending", [".json", ".txt"])
@pytest.mark.parametrize(
    ("rows", "name"),
    [
        (WAREHOUSE, "hall"),
        (FACTORY, "manufacturing"),
        (MAZE, "maze-walls"),
        (["    ", "    "], "maze-walls"),
        ([".#.", "..."], "maze-walls"),
        ([".@#", "e e"], "hall"),
    ],
)
def test_tiles_tell_the_domain_and_that_is_said(rows, name, ending, tmp_path):
    plan = read_plan(save(tmp_path / f"plan{ending}", rows))
    assert (plan.domain.name, plan.assumed) == (name, True)
    told = f"read as {name} (--domain chooses another)"
    assert plan.whose == ("a hall" if name == "hall" else told)
    assert plan.layout.shape == (len(rows), len(rows[0]))


def test_the_command_line_decides_where_the_file_says_nothing(tmp_path):
    plan = read_plan(save(tmp_path / "plan.txt", ["#.#", "#.#"]), "maze-entropy")
    assert (plan.domain.name, plan.assumed, plan.layout.sum()) == ("maze-entropy", False, 4)
    assert read_plan(save(tmp_path / "p.json", WAREHOUSE), "warehouse-uneven").domain.name == (
        "warehouse-uneven"
    )


def test_contradictions_and_unknown_domains_are_refused_in_one_line(tmp_path):
    path = save(tmp_path / "plan.json", WAREHOUSE, domain="warehouse-uneven")
    with pytest.raises(InputError, match="the file says warehouse-uneven: leave --domain out"):
        read_plan(path, "warehouse-even")
    assert read_plan(path, "warehouse-uneven").domain.name == "warehouse-uneven"
    foreign = save(tmp_path / "foreign.json", WAREHOUSE, domain="kiva")
    with pytest.raises(InputError, match="domain 'kiva', which is unknown: --domain chooses one"):
        read_plan(foreign)
    assert read_plan(foreign, "warehouse-even").assumed is False
    with pytest.raises(InputError, match="unknown domain 'moon'"):
        read_plan(path.with_name("foreign.json"), "moon")


def test_tiles_of_no_domain_are_named_with_an_alphabet(tmp_path):
    path = save(tmp_path / "plan.txt", ["w.q", "..."])
    with pytest.raises(InputError, match=r"'q' at row 0, column 2: hall knows '\.' floor"):
        read_plan(path)


@pytest.mark.parametrize(
    ("name", "domain"),
    [
        ("warehouse_even_nca_a5", "hall"),
        ("manufacturing_human_57x58", "manufacturing"),
        ("manufacturing_nca_a5", "manufacturing"),
        ("maze_nca_eval", "maze-walls"),
    ],
)
def test_published_layouts_show_their_domain(name, domain, published):
    assert read_plan(published(name)).domain.name == domain


def test_a_broken_plug_in_hides_no_other_domain(tmp_path, monkeypatch):
    monkeypatch.setitem(DOMAINS._references, "broken", "no_such_module:NOTHING")
    assert read_plan(save(tmp_path / "plan.txt", FACTORY)).domain.name == "manufacturing"


def test_a_plug_in_changes_nothing_in_what_a_file_of_ours_means(tmp_path, monkeypatch):
    @dataclasses.dataclass(frozen=True)
    class OwnConfig(DomainConfig):
        pass

    maze = find_domain("maze-walls")
    every = "".join(find_domain(name).tiles for name in DOMAINS.shipped)
    own = "".join(dict.fromkeys(f"{every}$"))
    make = lambda config: dataclasses.replace(maze, config=config, tiles=own, meanings={})  # noqa: E731
    monkeypatch.setitem(DOMAINS._entries, "own", Entry(OwnConfig, make))
    for rows in (WAREHOUSE, FACTORY, MAZE, [".@#", "e e"], [".#", ".X"]):
        path = save(tmp_path / "plan.txt", rows)
        assert read_plan(path).domain.name in DOMAINS.shipped
    assert read_plan(save(tmp_path / "plan.txt", ["w$", "@e"])).domain.name == "own"


@pytest.mark.parametrize("name", DOMAINS.names())
def test_meanings_agree_with_what_a_fleet_may_drive_on(name):
    domain = find_domain(name)
    if not domain.meanings:
        return
    assert set(domain.meanings) == set(domain.tiles)
    assert len(set(domain.names.values())) == len(domain.tiles)
    if domain.simulator.tasks is not None:
        drivable = {tile for tile in domain.tiles if not domain.meanings[tile].obstacle}
        assert drivable == set(domain.simulator.tasks.traversable)
