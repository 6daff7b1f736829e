"""Hand-made layouts: golden drawings, the published ones tile for tile, the rules at any size."""

import json
from collections import Counter
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from qdenv import grid
from qdenv.domains import designs
from qdenv.domains.base import DOMAINS, Domain, find_domain, make_domain
from qdenv.repairs.audit import audit
from qdenv.types import InputError

FIGURE_18 = [(33, 36), (45, 47), (57, 58), (69, 69), (81, 80), (93, 91), (101, 102)]
DESIGNED = [domain for name in DOMAINS.names() if (domain := find_domain(name)).human is not None]


def drawn(domain: Domain, rows: int, cols: int) -> list[str]:
    return grid.draw(domain.resized(rows, cols).human(), domain.tiles)


def rows_of(path: Path) -> list[str]:
    return json.loads(path.read_text())["layout"]


@pytest.mark.parametrize(
    ("name", "domain"),
    [
        ("warehouse_human", "warehouse-even"),
        ("warehouse_human_eval", "warehouse-uneven"),
        ("manufacturing_human", "manufacturing"),
        ("manufacturing_human_eval", "manufacturing"),
    ],
)
def test_regular_published_designs_are_met_tile_for_tile(name, domain, published):
    layout = rows_of(published(name))
    assert drawn(find_domain(domain), len(layout), len(layout[0])) == layout


@pytest.mark.parametrize(
    ("name", "domain", "shape"),
    [
        ("warehouse_human", "warehouse-even", (33, 36)),
        ("manufacturing_human_57x58", "manufacturing", (57, 58)),
    ],
)
def test_designs_stay_what_they_were_tile_for_tile(name, domain, shape, own_layout):
    assert drawn(find_domain(domain), *shape) == rows_of(own_layout(name))


@pytest.mark.parametrize(
    ("shape", "numbers"), [((33, 36), [11, 27, 55]), ((101, 102), [200, 500, 1000])]
)
def test_factories_have_stations_at_2_5_10(shape, numbers):
    counts = Counter("".join(drawn(find_domain("manufacturing"), *shape)))
    assert [counts[kind] for kind in "012"] == numbers


def test_other_stays_order_the_stations_of_the_small_factory_by_kind():
    kinds = "".join(designs.stations(33, 36, (1, 1, 1)))
    stations = [kind for kind in kinds if kind in "012"]
    assert stations == sorted(stations) and len(stations) == 93
    for stays in ((0, 0, 0), (0, 5, 10)):  # a kind at which nobody stays has stations, too
        factory = make_domain(replace(find_domain("manufacturing").config, stays=stays))
        assert set("012") <= set("".join(grid.draw(factory.human(), factory.tiles)))


def test_golden_drawings():
    assert drawn(find_domain("warehouse-even"), 9, 18) == [
        "..................",
        "w.eeeeeeeeee.eee.w",
        "..@@@@@@@@@@.@@@..",
        "..eeeeeeeeee.eee..",
        "w................w",
        "..eeeeeeeeee.eee..",
        "..@@@@@@@@@@.@@@..",
        "w.eeeeeeeeee.eee.w",
        "..................",
    ]
    assert drawn(find_domain("manufacturing"), 9, 13) == [
        ".............",
        "..ee.....ee..",
        ".e01e...e12e.",
        "..ee.....ee..",
        ".............",
        "..ee.....ee..",
        ".e22e...e22e.",
        "..ee.....ee..",
        ".............",
    ]


@pytest.mark.parametrize("domain", DESIGNED, ids=lambda domain: domain.name)
@pytest.mark.parametrize("shape", [(9, 9), (10, 23), (49, 50), (50, 49), (52, 51), *FIGURE_18])
def test_every_design_obeys_the_rules_of_its_domain(domain, shape):
    layout = domain.resized(*shape).human()
    assert layout.shape == shape
    assert layout.dtype == np.int8
    assert audit(layout, domain.fitted(layout).rules()) == []


def test_every_small_or_odd_size_is_proper_or_refused():
    for domain in DESIGNED:
        proper = 0
        for rows in range(1, 14):
            for cols in range(1, 16):
                try:
                    layout = domain.resized(rows, cols).human()
                except InputError as error:
                    assert "\n" not in str(error)
                    continue
                assert audit(layout, domain.fitted(layout).rules()) == []
                proper += 1
        assert proper > 60


def test_density_of_stations_is_that_of_the_published_design():
    for rows, cols in [(33, 36), (45, 47), (41, 42)]:
        stations = (designs.station_blocks(rows, cols) == "s").sum()
        assert stations / (rows * cols) <= designs.STATION_SHARE + 0.5 / (rows * cols)
        assert stations / (rows * cols) > 0.85 * designs.STATION_SHARE


@pytest.mark.parametrize("total", range(60))
def test_apportion_splits_everything_within_one_of_the_exact_share(total):
    numbers = designs.apportion(total, (2, 5, 10))
    assert sum(numbers) == total
    assert all(abs(n - total * part / 17) < 1 for n, part in zip(numbers, (2, 5, 10), strict=True))


def code_lines(path: Path) -> list[str]:
    """List a file's lines of code, without imports, decorators, docstring marks, lone brackets."""
    lines = (line.strip() for line in path.read_text().splitlines())
    dull = ("from ", "import ", "#", "@", '"""', "Args:", "Attributes:", "Raises:")
    return [line for line in lines if not line.startswith(dull) and len(line) > 3]


def test_no_domain_file_repeats_another():
    folder = Path(designs.__file__).parent
    files = {path: code_lines(path) for path in sorted(folder.glob("*.py"))}
    for one, ours in files.items():
        for other, theirs in files.items():
            if one < other:
                shared = set(ours) & set(theirs)
                # A few arguments of the record are the same in many a domain.
                assert len(shared) <= 0.15 * min(len(ours), len(theirs)) + 7, (one, other, shared)
                runs = {tuple(ours[i : i + 3]) for i in range(len(ours) - 2)}
                copied = runs & {tuple(theirs[i : i + 3]) for i in range(len(theirs) - 2)}
                assert not copied, f"{one.name} and {other.name} share {copied}"
