"""Golden section: archives of short searches."""

import adapter
from record import sha

PART = (6, 9)
FLOATS = True  # searches and generators of the zoo
_SMALL = {"rows": 13, "cols": 12, "steps": 8, "timesteps": 60, "hidden": 8}
_MAZE = {"timesteps": 40, "simulations": 2, "steps": 8, "rows": 12, "cols": 12}
_SURROGATE = {"epochs": 2, "channels": 4}
_DSAGE = {"timesteps": 60, "initial": 50, "inner_iterations": 20, **_SURROGATE}
CASES = {
    "quick": ("quick", {"timesteps": 60, "evaluations": 100, "seed": 5}),
    "manufacturing-quick": ("manufacturing-quick", {"timesteps": 60, "evaluations": 100}),
    "maze-quick": ("maze-quick", {**_MAZE, "evaluations": 300}),
    "dsage-quick": ("dsage-quick", {**_DSAGE, "evaluations": 150}),
    "map-elites": ("quick", {**_SMALL, "algorithm": "map-elites", "evaluations": 150}),
    "cma-es": ("quick", {**_SMALL, "algorithm": "cma-es", "evaluations": 150}),
    "random-search": ("quick", {**_SMALL, "algorithm": "random", "evaluations": 100}),
    "cma-me": ("quick", {**_SMALL, "algorithm": "cma-me", "evaluations": 150}),
    "screened": (
        "quick",
        {**_SMALL, "algorithm": "cma-mae-screened", "evaluations": 150, **_SURROGATE},
    ),
}


def run(name: str) -> dict:
    """Run one search."""
    columns, last = adapter.search(*CASES[name])
    del last["seconds"]
    return {"metrics": last} | {key: sha(values) for key, values in columns.items()}
