"""Golden section: fleets on hand-made, repaired and crowded layouts, driven on the host."""

import functools

import adapter
import layouts
import numpy as np
from record import sha

PART = (33, 60)
# Domain, shape, agents of a usual and of a crowded fleet.
PLACES = (
    ("warehouse-even", (17, 16), 40, 110),
    ("warehouse-uneven", (13, 20), 35, 100),
    ("manufacturing", (17, 16), 40, 120),
    ("manufacturing", (12, 22), 30, 100),
    ("warehouse-even", (33, 36), 150, 300),
)
TIMESTEPS, SEEDS = 120, (3, 8)
KINDS = ("hand-made", "repaired 0", "repaired 1", "repaired dense", "crowded", "crowded blocks")
CASES = [f"{p} {kind} / {one}" for p in range(5) for one in adapter.PLANNERS for kind in KINDS]


@functools.cache
def place(number: int, kind: str) -> tuple:
    """Make a layout; return it, its domain and the number of agents."""
    name, shape, usual, crowd = PLACES[number]
    # One domain for all of a place, whatever its number of shelves: one program.
    domain = adapter.domain_of(name, *shape)
    if kind == "hand-made":
        return domain.human(), domain, usual
    dense = 0.35 if kind in ("repaired dense", "crowded blocks") else 0.22
    drawn, ruled = layouts.random_layout(name, shape, f"traffic {number} {kind}", dense)
    layout, status, _, _ = adapter.repair(drawn, ruled, "none", number)
    assert status < 4, "no layout to drive on"
    return layout, domain, crowd if kind.startswith("crowded") else usual


def leaves(runs: list[dict], agents: int) -> list[dict]:
    """Reduce runs to hashes, with the throughput as a number.

    Of usage the visits are hashed: versions of XLA round the quotient in two ways.
    """
    reduced = []
    for run in runs:
        visits = np.rint(run["usage"] * (agents * run["end_timestep"])).astype(int)
        numbers = {name: leaf for name, leaf in run.items() if leaf is not None}
        throughput = float(numbers.pop("throughput"))
        hashes = {name: sha(leaf) for name, leaf in (numbers | {"usage": visits}).items()}
        reduced.append({"throughput": throughput} | hashes)
    return reduced


def run(name: str, **how: object) -> list[dict]:
    """Simulate one layout with both seeds."""
    where, planner = name.split(" / ")
    number, kind = where.split(" ", 1)
    layout, domain, agents = place(int(number), kind)
    how = {"seeds": SEEDS, "room": PLACES[int(number)][3]} | how
    return leaves(adapter.simulate(layout, domain, agents, TIMESTEPS, planner, **how), agents)
