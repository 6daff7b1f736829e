"""Attack on the repair of halls: outlines, walls, doors, aisles and racks, up to as many as fit.

Half of the plans hold as many shelves as a layout that was planted in them: there a repair must
find one, too.
"""

from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy import ndimage

import qdenv
from qdenv.grid import count_neighbours
from qdenv.repairs.recipe import repair_layout
from qdenv.repairs.rules import Facts, impossible
from qdenv.repairs.settings import RepairConfig
from qdenv.types import Adjacency, Count, RepairStatus, Rules
from robustness.campaign import Attack, Attempt

TILES = ".@ew#"
FLOOR, SHELF, ENDPOINT, STATION, WALL = range(5)
TRIES = 400  # places at which a planted rack is tried


class Hall(NamedTuple):
    """A hall to be furnished."""

    name: str
    layout: np.ndarray  # int8 [H, W], what is repaired
    rules: Rules
    planted: bool  # whether a layout is known that obeys the rules


def draw_building(rng: np.random.Generator) -> np.ndarray:
    """Draw floor, walls with doors, an L now and then, columns and stations (int8 [H, W])."""
    rows, cols = (int(rng.integers(9, 34)) for _ in range(2))
    hall = np.zeros((rows, cols), np.int8)
    if rng.random() < 0.4:  # outside of an L
        down, right = int(rng.integers(2, rows // 2)), int(rng.integers(2, cols // 2))
        corner = np.flip(hall, tuple(np.flatnonzero(rng.random(2) < 0.5)))
        corner[:down, :right] = WALL
    if rng.random() < 0.4:  # a wall across, with a door of one to three cells
        across = hall if rng.random() < 0.5 else hall.T
        at, door = int(rng.integers(3, len(across) - 3)), int(rng.integers(1, 4))
        across[at] = WALL
        begin = int(rng.integers(0, across.shape[1] - door))
        across[at, begin : begin + door] = FLOOR
    for _ in range(int(rng.integers(0, 5))):
        hall[int(rng.integers(rows)), int(rng.integers(cols))] = WALL
    labels, parts = ndimage.label(hall != WALL)
    sizes = np.bincount(labels.ravel(), minlength=parts + 1)
    sizes[0] = 0
    hall[labels != sizes.argmax()] = WALL  # what no robot can reach
    edges = np.argwhere((hall == FLOOR) & (count_neighbours(hall == FLOOR) < 4))
    for row, col in rng.permutation(edges)[: int(rng.integers(1, 8))]:
        hall[row, col] = STATION
    return hall


def hall_rules(hall: np.ndarray, low: int, high: int | None) -> Rules:
    """State what may stand where, and how many shelves."""
    allowed = np.eye(len(TILES), dtype=bool)[hall]
    allowed[hall == FLOOR] = [True, True, True, False, False]
    return Rules(
        tiles=TILES,
        counts=(Count("@", low, high),),
        adjacency=(Adjacency("@", "e"), Adjacency("e", "@")),
        connected=".ew",
        allowed=allowed,
        change_cost=np.ones(hall.shape, np.float32),
    )


def plant(
    hall: np.ndarray, rules: Rules, shape: tuple[int, int], rng: np.random.Generator
) -> np.ndarray:
    """Put racks where they break no rule but the count, in order or at random (int8 [H, W])."""
    best, free = furnish(hall), np.argwhere(hall == FLOOR)
    if len(qdenv.audit(best, rules)) > 1:
        return best
    places = rng.permutation(free)[:TRIES] if rng.random() < 0.5 else free
    (deep, long), last = shape, (-9, -9)
    for row, col in places[:: max(len(places) // TRIES, 1)]:
        if abs(row - last[0]) + abs(col - last[1]) < 2:
            continue
        sides = (deep, long + int(rng.integers(0, 9)))
        rows, cols = sides if rng.random() < 0.7 else sides[::-1]
        box = hall[row : row + rows, col : col + cols]
        if box.shape != (rows, cols) or (best[row : row + rows, col : col + cols] % 2).any():
            continue
        drawn = np.where(best == SHELF, SHELF, hall)
        if (box != FLOOR).any():
            continue
        drawn[row : row + rows, col : col + cols] = SHELF
        drawn = furnish(drawn)
        if len(qdenv.audit(drawn, rules)) <= 1:  # the count
            best, last = drawn, (row, col)
    return best


def furnish(drawn: np.ndarray) -> np.ndarray:
    """Make every floor cell beside a shelf an endpoint."""
    beside = (drawn == FLOOR) & (count_neighbours(drawn == SHELF) > 0)
    return np.where(beside, ENDPOINT, drawn).astype(np.int8)


def draw_hall(rng: np.random.Generator) -> Hall:
    """Draw a hall, its rules, and a layout that may break them everywhere."""
    building, planted = draw_building(rng), bool(rng.random() < 0.6)
    aisle = int(rng.choice([1, 2, 3], p=[0.4, 0.5, 0.1]))
    rack = None
    if rng.random() < 0.6:
        rack = (int(rng.integers(1, 3)), int(rng.integers(2, 7)))
    cross = int(rng.integers(3, 13)) if rng.random() < 0.3 else 0
    both = bool(rng.random() < 0.2)
    free = int((building == FLOOR).sum())
    number = int(rng.uniform(0.02, 0.7) * free)
    if planted:
        rules = hall_rules(building, free + 1, None).buildable(
            aisle, rack, cross_aisle=cross, both_sides=both
        )
        layout = plant(building, rules, rack or (int(rng.integers(1, 3)), 2), rng)
        number = int((layout == SHELF).sum())
        planted = number > 0
    rules = hall_rules(building, number, number)
    rules = rules.buildable(aisle, rack, cross_aisle=cross, both_sides=both)
    if planted:
        assert not qdenv.audit(layout, rules), qdenv.audit(layout, rules)
    odds = rng.dirichlet(np.ones(3))
    noise = rng.choice(3, building.shape, p=odds).astype(np.int8)
    layout = np.where(building == FLOOR, noise, building).astype(np.int8)
    name = f"{building.shape[0]} x {building.shape[1]}, {number} shelves, aisle {aisle}, {rack}"
    name += f", straight {cross}" * (cross > 0) + ", both sides" * both
    return Hall(name, layout, rules, planted)


def attempt(rng: np.random.Generator, folder: Path) -> Attempt:
    """Repair one hall and check the result."""
    hall = draw_hall(rng)
    repair = repair_layout(hall.layout, hall.rules, 0, RepairConfig())
    status, faults = RepairStatus(int(repair.status)), list[str]()
    if status < RepairStatus.IMPOSSIBLE:
        faults += [found.message for found in qdenv.audit(np.asarray(repair.layout), hall.rules)]
    elif hall.planted:
        faults.append(f"{status.name}, {impossible(hall.rules)}, but a layout was planted")
    planted = "planted" if hall.planted else "not planted"
    counted = impossible(hall.rules, Facts(hall.rules)) is not None
    why = " by counting" * (status == RepairStatus.IMPOSSIBLE and counted)
    return Attempt(
        1, [f"{hall.name}: {one}" for one in faults], {f"{planted}, {status.name}{why}": 1}
    )


HALLS = Attack(
    "halls",
    "a layout with aisles and racks is found where one was planted, and none breaks a rule",
    "halls",
    attempt,
)
