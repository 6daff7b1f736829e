"""Runs small enough to be made twice: by one device, and by as many as this process is given."""

import sys
from dataclasses import replace
from pathlib import Path

import jax
import numpy as np
import toy

from qdenv.domains.maze import MazeConfig
from qdenv.domains.warehouse import WarehouseConfig
from qdenv.generators import GuidedNcaConfig, NcaConfig
from qdenv.run import loop
from qdenv.run.config import RunConfig
from qdenv.run.experiment import make_experiment, make_iteration
from qdenv.search.settings import CmaMaeConfig
from qdenv.settings import EvaluationConfig
from qdenv.simulation.mapf.settings import FleetConfig, PibtConfig

_NCA = NcaConfig(steps=4, kernel_sizes=(3, 1), hidden=4)
_PLANNER = PibtConfig(backend="xla")  # the quickest to compile
_FLEET = FleetConfig(agents=4, timesteps=10, window=2, horizon=1, planner=_PLANNER)

# Batches that eight devices do not divide: 6 layouts with 2 runs each, 2 with 5.
FLEET = RunConfig(
    evaluation=EvaluationConfig(
        domain=WarehouseConfig(rows=9, cols=10, shelves=6, fleet=_FLEET),
        generator=_NCA,
        simulations=2,
    ),
    algorithm=CmaMaeConfig(emitters=2, batch=3, sigma0=0.5),
    evaluations=12,
    archive=((0, 10, 5), (0, 1, 5)),
)
_GUIDED = GuidedNcaConfig(steps=4, kernel_sizes=(3, 1), hidden=4)
GUIDED = replace(FLEET, evaluation=replace(FLEET.evaluation, generator=_GUIDED), evaluations=6)
MAZE = RunConfig(
    evaluation=EvaluationConfig(
        domain=MazeConfig(rows=6, cols=6, timesteps=40), generator=_NCA, simulations=5, alpha=0.0
    ),
    algorithm=CmaMaeConfig(emitters=1, batch=2, sigma0=0.5, ahead=1),
    evaluations=6,
    archive=((0, 16, 8), (0, 40, 8)),
)


def make_runs(folder: Path) -> None:
    """Search both domains, and iterate the garden under jit, whole."""
    loop.train(FLEET, folder / "fleet", progress=False)
    loop.train(GUIDED, folder / "guided", progress=False)
    loop.train(MAZE, folder / "maze", progress=False)
    experiment = make_experiment(replace(toy.CONFIG, seed=3))
    iterate = jax.jit(make_iteration(experiment))
    state = experiment.algorithm.init(experiment.search_key)
    for number in (1, 2, 3):
        state = iterate(state, np.int32(number))
    np.savez(folder / "garden.npz", **experiment.algorithm.archive(state).elites())


if __name__ == "__main__":
    make_runs(Path(sys.argv[1]))
    print(jax.local_device_count())
