"""Priority-based search (under construction: drives as PIBT does)."""

from qdenv.simulate.mapf.pbs.settings import PbsConfig
from qdenv.simulate.mapf.pibt.numba import drive
from qdenv.simulate.mapf.pibt.planner import rollout
from qdenv.simulate.mapf.planner import Planner


def pbs(settings: PbsConfig) -> Planner:
    """Make the planner."""
    del settings
    return Planner(rollout, drive=drive)
