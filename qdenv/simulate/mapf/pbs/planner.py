"""The planner: windowed priority-based search, as in the published simulator.

Every `horizon` timesteps all agents are planned from scratch for a window. Deviations from the
published program: two goals are always known, services are checked to find their cell free, the
limit is one of nodes and not of time, and an unsolved window is driven by PIBT where its best plan
has conflicts.
"""

import functools

from qdenv.simulate.mapf.pbs.drive import drive
from qdenv.simulate.mapf.pbs.settings import MAX_WINDOW, PbsConfig
from qdenv.simulate.mapf.planner import Planner


def pbs(settings: PbsConfig) -> Planner:
    """Make the planner, which drives whole runs in compiled host code only."""
    return Planner(None, MAX_WINDOW, drive=functools.partial(drive, settings))
