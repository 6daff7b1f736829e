# The public names by module: for type checkers, and for __init__.py, which imports each when it is
# first used.

from .domains.base import (
    DOMAINS,
    Domain,
    DomainConfig,
    KnownSize,
    Simulator,
    find_domain,
    make_domain,
)
from .domains.fleet import fleet_simulator
from .generate import GENERATORS, Canvas, Generator, NcaConfig
from .io.layouts import read_layout, write_layout
from .ops.layouts import check, human_layout, make_environment, render, repair_layout, tile_layout
from .ops.networks import convert_agent, evaluate_agent, fit_surrogate, train_agent
from .ops.options import read_plan
from .ops.output import Layout
from .ops.pages import explore, replay, report
from .ops.runs import export, generate_layout, plot, series
from .ops.searches import presets, resume, train, zoo
from .ops.studies import compare, scalability, sweep
from .ops.traffic import simulate_layout
from .pipeline import evaluate, make_pipeline
from .presets import PRESETS, find_preset
from .registry import Entry
from .repair.audit import audit
from .run.config import RunConfig
from .run.directory import RunDirectory
from .run.experiment import make_experiment, make_iteration
from .search.archive import GridArchive
from .search.base import Algorithm, Problem
from .search.registry import ALGORITHMS
from .settings import EvaluationConfig
from .simulate.mapf.goals import beside_goal, tile_goal
from .simulate.mapf.negotiated.settings import NegotiatedConfig
from .simulate.mapf.pbs.settings import PbsConfig
from .simulate.mapf.pibt.settings import PibtConfig
from .simulate.mapf.planner import AgentState, Planner, World
from .simulate.mapf.settings import PLANNERS, FleetConfig
from .study.elites import grow_elite
from .types import Adjacency, Count, Goal, InputError, Measure, Rules, Score, TaskRule, Traffic
from .view.runs import plot_run

__version__: str
