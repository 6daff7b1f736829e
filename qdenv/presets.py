"""Named configurations: quick looks, a laptop's half hour, the paper's rows (Table 1)."""

from dataclasses import replace

from qdenv.domains.base import EvaluationConfig
from qdenv.search.cma_mae import CmaMaeConfig
from qdenv.train.config import RunConfig
from qdenv.types import look_up

_WAREHOUSE = EvaluationConfig()
_PAPER = RunConfig()

# A small warehouse: 40 shelves leave a handful to forty components.
_QUICK = RunConfig(
    evaluation=replace(
        _WAREHOUSE, rows=17, cols=16, steps=20, shelves=40, agents=60, timesteps=200, simulations=2
    ),
    algorithm=CmaMaeConfig(learning_rate=0.1),
    evaluations=600,
    archive=((0, 40, 20), (0, 1, 20)),
)


# One agent, no repair, and a soft archive that learns fast (Table 1).
_MAZE = RunConfig(
    evaluation=EvaluationConfig(
        domain="maze-walls",
        rows=18,
        cols=18,
        shelves=0,
        agents=1,
        timesteps=648,
        simulations=50,
        alpha=0.0,
    ),
    algorithm=CmaMaeConfig(batch=30, learning_rate=0.5, ranker="2imp", selection="filter"),
    evaluations=100_000,
    checkpoint_every=20,
)


def _paper(domain: str, alpha: float) -> RunConfig:
    return replace(_PAPER, evaluation=replace(_WAREHOUSE, domain=domain, alpha=alpha))


PRESETS: dict[str, RunConfig] = {
    "quick": _QUICK,
    "laptop": replace(_PAPER, evaluations=1000),
    "warehouse-even": _paper("warehouse-even", 5.0),
    "warehouse-even-a1": _paper("warehouse-even", 1.0),
    "warehouse-even-a0": _paper("warehouse-even", 0.0),
    "warehouse-uneven": _paper("warehouse-uneven", 5.0),
    "warehouse-uneven-a1": _paper("warehouse-uneven", 1.0),
    "warehouse-uneven-a0": _paper("warehouse-uneven", 0.0),
    "manufacturing": _paper("manufacturing", 5.0),
    "manufacturing-quick": replace(
        _QUICK,
        evaluation=replace(_QUICK.evaluation, domain="manufacturing"),
        archive=((0, 140, 20), (0, 1, 20)),
    ),
    "maze-walls": _MAZE,
    "maze-entropy": replace(_MAZE, evaluation=replace(_MAZE.evaluation, domain="maze-entropy")),
    "maze-quick": replace(
        _MAZE,
        evaluation=replace(_MAZE.evaluation, simulations=10, timesteps=250),
        evaluations=3000,
        archive=((0, 256, 32), (0, 250, 25)),
    ),
}


def find_preset(name: str) -> RunConfig:
    """Look a preset up by name.

    Raises:
        InputError: no preset has this name.
    """
    return look_up(PRESETS, name, "preset")
