"""Golden section: the settings that a preset and what is stated beside it resolve to."""

import json

import adapter
from record import sha

PART = (1, 8)
SETTINGS = [
    {},
    {"seed": 3},
    {"evaluations": 300, "alpha": 1.0},
    {"evaluations": 0},
    {"rows": 17, "cols": 16},
    {"rows": 101, "cols": 102},
    {"rows": 66, "cols": 66},
    {"rows": 45, "cols": 48, "shelves": 200},
    {"rows": 45, "cols": 48, "agents": 99},
    {"rows": 45, "cols": 48, "steps": 12, "timesteps": 77},
    {"rows": 2, "cols": 2},
    {"shelves": 60},
    {"shelves": 100_000},
    {"agents": 40},
    {"agents": 100_000},
    {"timesteps": 50, "simulations": 3},
    {"planner": "pbs"},
    {"planner": "pibt"},
    {"planner": "none"},
    {"effort": "high"},
    {"effort": "low", "planner": "pbs"},
    {"effort": "lower"},
    {"domain": "manufacturing"},
    {"domain": "warehouse-uneven", "agents": 33},
    {"domain": "maze-walls"},
    {"domain": "maze-entropy", "rows": 30, "cols": 31},
    {"domain": "labyrinth"},
    {"algorithm": "map-elites"},
    {"algorithm": "cma-es", "batch": 20},
    {"algorithm": "dsage"},
    {"algorithm": "cma-mae-screened", "screen": 2},
    {"algorithm": "random", "sigma": 0.5},
    {"algorithm": "annealing"},
    {"learning_rate": 0.5, "sigma0": 0.1},
    {"strategy": "sep", "ahead": 1},
    {"polish": "full"},
    {"polish": "best"},
    {"archive": ((0, 50, 10), (0, 1, 10))},
    {"hidden": 8, "kernel_sizes": (5, 5)},
    {"shelfs": 3},
]
COMMANDS = [
    "", "--seed 3", "--rows 45 --cols 48", "--rows 101 --cols 102", "--planner pbs --rule plain",
    "--domain manufacturing --agents 30", "--algorithm map-elites --sigma-iso 0.05",
    "--archive 0 10 5 0 1 5", "--shelves 60", "--no-such-option 3", "--strategy xNES",
    "--evaluations -1", "--effort high --last-resort wait", "--kernel-sizes 3 4",
]  # fmt: skip
_COMMANDED = ("quick", "maze-quick", "manufacturing", "dsage-laptop")
CASES = [f"api {preset}" for preset in adapter.qdenv.PRESETS] + [
    f"command {preset} {words}".strip() for preset in _COMMANDED for words in COMMANDS
]


def run(name: str) -> object:
    """Resolve one command line, or all settings beside one preset."""
    way, preset, *words = name.split()
    if way == "command":
        return _brief(adapter.resolve_command(preset, words))
    found = {json.dumps(stated): adapter.resolve_config(preset, stated) for stated in SETTINGS}
    return {key: value if key == "{}" else _brief(value) for key, value in found.items()}


def _brief(config: dict | str) -> str:
    return config if isinstance(config, str) else sha(json.dumps(config))
