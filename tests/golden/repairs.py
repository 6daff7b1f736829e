"""Golden section: repairs of random layouts, and the courses of random mazes."""

import adapter
import layouts
from record import sha

PART = (3, 40)
KINDS = (*layouts.WAREHOUSES, "manufacturing")


def _names() -> list[str]:
    names = []
    for number in range(192):
        kind, shape = KINDS[number % 3], layouts.SHAPES[number // 3 % 8]
        if shape == (33, 36) and number % 2:
            shape = (19, 14)
        style = ("plain", "kept", "dense", "blocks")[number // 24 % 4]
        polishes = ["none", "quick"]
        if shape[0] * shape[1] < 160 and number % 2 == 0:
            polishes.append("full")
        names += [f"{number} {kind} {shape[0]}x{shape[1]} {p} {style}" for p in polishes]
    names += [f"{n} maze-walls {8 + n}x{10 + n} solve plain" for n in range(8)]
    # Too many shelves, or nearly: impossible, failed, or found by the solver.
    tight = [
        (n, KINDS[n % 2], layouts.SHAPES[n // 4], f"tight{60 + 4 * (n % 4)}") for n in range(8)
    ]
    return names + [f"{n} {kind} {r}x{c} quick {style}" for n, kind, (r, c), style in tight]


CASES = _names()


def run(name: str) -> dict:
    """Repair one layout."""
    number, kind, size, polish, style = name.split()
    rows, cols = map(int, size.split("x"))
    drawn = f"{number} {kind} {style}"
    shares = {"plain": 0.2, "kept": 0.25, "dense": 0.48, "blocks": 0.3}
    dense = int(style[5:]) / 100 if style.startswith("tight") else shares[style]
    layout, domain = layouts.random_layout(kind, (rows, cols), drawn, dense)
    if polish == "solve":
        return {"tiles": sha(layout), **adapter.course_of(layout, domain)}
    if style == "kept":
        domain = layouts.keep_some(layout, domain, drawn)
    cells, status, cost, bound = adapter.repair(layout, domain, polish, int(number))
    return {"cells": sha(cells), "status": status, "cost": float(cost), "bound": float(bound)}
