"""What whole layouts move: our own in bands around what was measured, the published as published.

The bands hold every single seed's measurement with a few per cent to spare: a planner that gets
worse falls out of them, and so does one that moves more than robots can.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import pytest
from conftest import read_layout

import qdenv
from qdenv.domains.base import find_domain
from qdenv.simulation.mapf import fleet
from qdenv.simulation.mapf.negotiated.settings import LOW
from qdenv.study.engine import run_seeds

pytestmark = pytest.mark.slow

AGENTS = 200


def report(path: Path, domain: str, effort: str) -> dict:
    """Simulate a layout with two seeds over 400 steps, every trajectory audited."""
    options = {"domain": domain, "timesteps": 400, "seeds": 2, "effort": effort}
    return qdenv.simulate(path, AGENTS, audit=True, **options)


def congestion(path: Path, seeds: Sequence[int], **changes) -> list[bool]:
    """Tell which runs of a changed planner congest on an even warehouse."""
    domain = find_domain("warehouse-even")
    layout = read_layout(path, domain.tiles)
    planner = replace(LOW, **changes)
    config = fleet.FleetConfig(agents=AGENTS, timesteps=600, planner=planner)
    done = run_seeds(layout, domain.simulator.tasks, config, seeds)
    return [bool(run.congested) for run in done.runs]


@pytest.mark.parametrize(
    ("name", "domain", "effort", "low", "high"),
    [
        ("warehouse_even", "warehouse-even", "low", 5.9, 6.3),
        ("warehouse_even", "warehouse-even", "high", 6.2, 6.55),
        ("warehouse_uneven", "warehouse-uneven", "low", 5.2, 5.95),
        ("warehouse_uneven", "warehouse-uneven", "high", 5.6, 6.2),
        ("manufacturing", "manufacturing", "low", 5.35, 5.7),
        ("manufacturing", "manufacturing", "high", 5.4, 5.85),
    ],
)
def test_our_own_layouts_stay_in_their_bands(name, domain, effort, low, high, own_layout):
    result = report(own_layout(name), domain, effort)
    assert result["valid"] and result["success_rate"] == 1
    for run in result["runs"]:
        assert low < run["throughput"] < high


def test_the_hand_made_warehouse_congests_only_where_agents_without_a_path_wait(own_layout):
    """It congests under PBS, which lets them wait; pushing others aside keeps it flowing."""
    path = own_layout("warehouse_human")
    assert congestion(path, range(2), last_resort="wait") == [True] * 2
    assert congestion(path, range(2)) == [False] * 2


def test_a_published_layout_reaches_its_throughput(published: Callable[[str], Path]):
    """Low effort on the published even layout: at least 6.2, never congested (T shortened)."""
    result = report(published("warehouse_even_nca_a5"), "warehouse-even", "low")
    assert result["valid"] and result["success_rate"] == 1
    assert result["mean_throughput"] >= 6.2


@pytest.mark.parametrize(
    ("name", "least", "most"), [("human", 8, 8), ("even_dsage", 0, 4), ("even_nca_a5", 0, 4)]
)
def test_waiting_congests_published_layouts_where_the_published_planner_does(
    name, least, most, published
):
    """At 200 agents PBS congests on the hand-made warehouse and on no other of its domain.

    Of 8 seeds; on the others a quarter congests within the first windows, before they flow.
    """
    path = published(f"warehouse_{name}")
    assert least <= sum(congestion(path, range(8), last_resort="wait")) <= most
