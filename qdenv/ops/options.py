"""The arguments that operations share, each with its type in Python and its form on command lines.

A type is `Annotated` where the command line reads it in a form of its own. What an option stands
for depends on a choice in the same command line at four places: the settings of the chosen
planner, of the chosen preset, the numbers of tiles and the tasks of the chosen domain. Their types
are marked here (`Mark`, `PlannerOptions`, `TaskOptions`), `qdenv.cli.rules` resolves them.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from enum import Enum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, TypeAlias, TypedDict, get_type_hints

import numpy as np
from annotated_types import Interval
from tyro.conf import Positional, arg
from tyro.constructors import PrimitiveConstructorSpec

from qdenv.domains.base import DOMAINS, Domain, find_domain
from qdenv.io.facts import FACTS, make_facts
from qdenv.ops.output import Layout
from qdenv.ranges import NonNegativeInt, PositiveFloat, PositiveInt, Seed, check_range
from qdenv.simulation.mapf.settings import (
    OWN,
    FleetConfig,
    check_costs,
    describe_planner,
    find_planner,
    record_planner,
)
from qdenv.study.options import TIMESTEPS, Keep, parse_counts, parse_seeds, usual_fleet
from qdenv.study.plans import Plan, close_parts, guide, name_guidance, with_tasks
from qdenv.study.plans import read_plan as read_file
from qdenv.types import InputError, look_up, to_array
from qdenv.view import parse_width

if TYPE_CHECKING:
    from qdenv.run.directory import RunDirectory


def option(metavar: str, read: Any, names: Any = None) -> Any:
    """Describe an option that the command line reads by `read`."""
    return PrimitiveConstructorSpec(
        nargs=1,
        metavar=metavar,
        choices=names,
        instance_from_str=lambda words: read(*words),
        is_instance=lambda value: True,
        str_from_instance=lambda value: [str(value)],
    )


class Mark(Enum):
    """Arguments that differ between the command line and Python."""

    TRUE = "its default is True there, and False in Python"
    PRESET = "the settings of a search"
    SURROGATE = "the settings of a surrogate"
    TILES = "the exact numbers of tiles of a domain"


class PlannerOptions:
    """Marks the option ``--planner NAME`` with the settings of the planner of that name."""

    usual = ""  # the planner where neither one nor an effort is named: the negotiated one


class PibtOptions(PlannerOptions):
    """`PlannerOptions` of what takes PIBT by default, which is faster than the usual planner."""

    usual = "pibt"


class TaskOptions:
    """Marks the options for settings of a domain that say what robots do at their goals."""


DOMAIN_NAMES = "{" + ",".join(DOMAINS.names()) + "}"
# A layout: path of its file, a `Plan`, a `Layout`, or int [H, W] with ``domain=`` beside it.
Source: TypeAlias = Annotated[
    str | Path | Plan | Layout | np.ndarray | Sequence[Sequence[int]],
    Positional,
    arg(metavar="LAYOUT", constructor=Path),
]
Sources: TypeAlias = Annotated[
    Sequence[Any], Positional, arg(metavar="LAYOUT ...", constructor=tuple[Path, ...])
]
# A `RunDirectory`, its folder, or zoo:DOMAIN/NAME. Only operations on runs import that record:
# other refusals are faster without it.
Run: TypeAlias = Annotated[Any, Positional, arg(metavar="RUN", constructor=Path)]
Runs: TypeAlias = Annotated[
    Sequence[Any], Positional, arg(metavar="RUN ...", constructor=tuple[Path, ...])
]
DomainName: TypeAlias = Annotated[str | None, arg(metavar=DOMAIN_NAMES)]
# 10 for ten runs with the seeds 0 to 9, (3, 5, 9) for these three; on command lines 3,5,9 and 7,
Seeds: TypeAlias = Annotated[int | Sequence[int], option("N|SEED,...", parse_seeds)]
# On command lines agents are robots as well: people who plan halls say so
_ROBOTS = arg(aliases=("--robots",))
# Too many for a layout are refused with the number of its cells
Agents: TypeAlias = Annotated[Annotated[int, Interval(ge=1)] | None, _ROBOTS]
# One number of agents or several; on command lines 200 or 50,100 or 50:400:50
Counts: TypeAlias = Annotated[
    int | Sequence[int] | None, option("N|N,...|FIRST:LAST:STEP", parse_counts), _ROBOTS
]
# A file to write; the command line writes one named `AUTO` where none is named
Out: TypeAlias = Annotated[str | Path | None, option("FILE", Path)]
# A picture to write; ``--plot`` without a name is `AUTO`
Picture: TypeAlias = Annotated[str | Path | None, option("[FILE]", Path)]
# Of a picture, in inches, or of a column or page of a journal
Width: TypeAlias = Annotated[float | str | None, option("{column,page,INCHES}", parse_width)]
# How many there are to be: 1100, or "1000:1200"
Range: TypeAlias = Annotated[
    int | str, option("N|LOW:HIGH", lambda word: int(word) if word.isdecimal() else word)
]
# Numbers of tiles by name, in a hall also ranges; one, or one for each of several sizes
Number: TypeAlias = Annotated[Any, Mark.TILES]
Numbers: TypeAlias = Annotated[Sequence[int], Mark.TILES]
# What must stay, see `keep_from`; on command lines w#+0:7,33:40+FILE
KeepCells: TypeAlias = Annotated[Keep | None, option("TILES|ROWS,COLUMNS|FILE", str)]
# A layout whose size and rules others have, too; any form of `Source`
PlanFile: TypeAlias = Annotated[Any, option("FILE", Path)]
# Of a run that begins
Folder: TypeAlias = Annotated[
    str | Path | None, option("FOLDER", Path), arg(name="out", aliases=("--run-dir",))
]
RepairSeed: TypeAlias = Annotated[Seed, arg(aliases=("--repair-seed",))]
OnCommandLine: TypeAlias = Annotated[bool, Mark.TRUE]
# Costs of moves by name or file, in Python also float [5, H, W], see `guidance`
Guidance: TypeAlias = Annotated[Any, option("FILE|NAME", str)]


class RunOptions(TypedDict, total=False):
    """One run of a fleet."""

    domain: DomainName  # domain of the agents' tasks; by default that of the layout
    # number of timesteps; by default 1000, or the number known for the layout's size
    timesteps: PositiveInt | None
    # effort of the negotiated planner: low for a quick look, high (the default) for numbers to
    # report
    effort: Annotated[str | None, arg(metavar="{low,high}")]
    # planner of the paths, by its registered name or its settings, like `PbsConfig()`;
    # `compare` takes a list of them
    planner: Annotated[Any, arg(name="", constructor=PlannerOptions)]
    # what robots do at their goals, in place of what the plan says: settings of its domain by name,
    # like {"pick": 3}; "demand" is "shelves", a file, zones, or float [H, W]
    tasks: Annotated[dict[str, Any], arg(name="", constructor=TaskOptions)]
    # end a run as soon as it congests, as the paper does; --no-stop continues
    stop: Annotated[bool, arg(help_behavior_hint="(default: True)")]
    # costs of moves: none, crisscross, crisscross-pairs, traffic-flow, human-cost, or a file; by
    # default those in the layout file
    guidance: Guidance


class FleetOptions(RunOptions, total=False):
    """Runs of a fleet, each as `RunOptions` says."""

    # 10 for ten runs, seeds 0 to 9; 3,5,9 for these three; "7," for seed 7
    seeds: Annotated[Seeds, arg(help_behavior_hint="(default: 10)")]
    seconds_per_step: PositiveFloat | None  # length of a timestep, to report tasks per hour as well


class StudyOptions(FleetOptions, total=False):
    """Runs of several fleets (`FleetOptions`), a table of them and a picture."""

    # CSV file to write; by default named after the command, or for sweeps after the layout
    out: Out
    plot: Picture  # picture to write; by default beside the table
    width: Width  # width of the picture in inches; by default what suits it


class GuideOptions(RunOptions, total=False):
    """A search of costs by runs of `RunOptions`, by PIBT unless planner or effort is named."""

    # planner of the paths, by its registered name or its settings, like `PbsConfig()`
    planner: Annotated[Any, arg(name="", constructor=PibtOptions)]
    # search 30 numbers of smooth costs for floors of any size, the cost of each move, or weights of
    # a network that updates costs; by default smooth, or costs where guidance states them all
    method: Literal["smooth", "costs", "update"]
    # number of sets of costs to try, rounded up to whole iterations; by default 2000
    evaluations: PositiveInt
    minutes: PositiveFloat | None  # pause after this many minutes; `qdenv resume` continues
    simulations: PositiveInt  # simulations of each try, with fresh seeds; by default 1
    seed: NonNegativeInt  # seed of the search; by default 0
    # costs of moves where the search begins: a name or a file, as for `simulate`; by default the
    # layout file's, unless --method is another than costs, or the best of none, crisscross and
    # crisscross-pairs
    guidance: Guidance


class ImproveOptions(RunOptions, total=False):
    """A search of better plans, with runs as `RunOptions` says."""

    moves: PositiveInt  # most shelves that the search of some racks moves; by default 20
    shelves: Range  # number of shelves, as 1100 or 1000:1200; else the plan's
    aisle: PositiveInt  # least width of aisles in cells; else the plan's
    rack: str  # shape of the smallest rack, as 2x6; else the plan's
    # most rows or columns with shelves between two straight aisles; else the plan's
    cross_aisle: NonNegativeInt
    both_sides: bool  # whether racks have an aisle on both sides; else the plan's
    minutes: PositiveFloat | None  # for all searches; by default 10, unless evaluations are given
    evaluations: PositiveInt | None  # number of floors, or sets of costs, that each search tries
    seed: NonNegativeInt  # seed of the searches; by default 0


class Fleet:
    """The options of runs of a fleet, resolved."""

    def __init__(self, options: Mapping[str, Any], kind: Any = FleetOptions) -> None:
        """Resolve options of a `kind`; raise InputError if one is not of it, or impossible."""
        kinds = get_type_hints(kind, include_extras=True)
        for name, value in options.items():
            # Functions have agents themselves: it is known here to be suggested for robots.
            check_range(name, value, look_up({"agents": int} | kinds, name, "option"))
        self.domain: str | None = options.get("domain")
        self.timesteps: int | None = options.get("timesteps")
        self.effort: str | None = options.get("effort")
        # The command line gives a name (or "") and what differs from that planner's defaults.
        planner: Any = options.get("planner")
        stated = isinstance(planner, tuple) and isinstance(planner[-1], dict)
        name, changes = planner if stated else (planner, {})
        self.planner = replace(find_planner(self.effort, name or ""), **changes)
        self.stop: bool = options.get("stop", True)
        self.guidance: Any = options.get("guidance")
        self.tasks: Mapping[str, Any] = options.get("tasks") or {}
        if not isinstance(self.tasks, Mapping):
            raise InputError('tasks are settings by name, like {"pick": 3}')
        self.inputs = [self.guidance, self.tasks.get("demand")]  # files that they name are read
        self._first: str | None = None  # the domain of the first plan
        self.seeds = parse_seeds(options.get("seeds", 10))
        self.seconds_per_step: float | None = options.get("seconds_per_step")
        # Number of timesteps per hour; None where their length is not given.
        self.per_hour = self.seconds_per_step and 3600 / self.seconds_per_step
        self.config(1)  # refuses what makes no simulation

    def config(self, agents: int, timesteps: int | None = None) -> FleetConfig:
        """Make the settings of a simulation; raise InputError if a number is impossible."""
        steps = timesteps or self.timesteps or TIMESTEPS
        return FleetConfig(agents, steps, planner=self.planner, stop_when_congested=self.stop)

    def usual(self, plan: Plan, agents: int | None) -> tuple[int, int, str]:
        """Return what `usual_fleet` does, by default for the robots in the plan's file."""
        agents = plan.facts.robots if agents is None else agents
        return usual_fleet(plan.domain, [plan.layout], agents, self.timesteps)

    def read_plan(self, layout: Any) -> Plan:
        """Read a layout as the function of this name does, with its tasks and costs of moves."""
        plan = self.with_tasks(read_plan(layout, self.domain))
        if self.seconds_per_step is None and (length := plan.facts.seconds_per_step):
            self.seconds_per_step, self.per_hour = length, 3600 / length
        return self.guide(close_parts(plan))

    def with_tasks(self, plan: Plan) -> Plan:
        """Give a plan the stated tasks; all plans of one study have those of the first."""
        if self._first in (None, plan.domain.name):
            plan = with_tasks(plan, self.tasks)
        if self._first is None:
            self._first, self.tasks = plan.domain.name, plan.domain.tasks
        return plan

    def guide(self, plan: Plan) -> Plan:
        """Give a plan its costs of moves; InputError if the planner reads none."""
        guided = guide(plan, self.guidance)
        if guided.costs is not None:
            check_costs(self.planner)
        return guided

    def settings(self, timesteps: int | None, plans: Sequence[Plan] = ()) -> dict[str, Any]:
        """Return the options for facts, with the guidance of `plans` where one has costs."""
        stated = {"guidance": name_guidance(plans), "tasks": self.tasks}
        return {name: one for name, one in stated.items() if one} | {
            "domain": self.domain,
            "timesteps": timesteps,
            "seeds": list(self.seeds),
            "effort": self.effort,
            "planner": record_planner(self.planner),
            "stop": self.stop,
            "seconds_per_step": self.seconds_per_step,
        }

    def describe(
        self, agents: str, timesteps: int, plans: Sequence[Plan], planners: Sequence[Any] = ()
    ) -> str:
        """Describe in one line what is simulated, by `self.planner` or by several `planners`."""
        runs = f"{len(self.seeds)} seeds" if len(self.seeds) > 1 else "1 seed"
        end = "" if self.stop else ", no stop at congestion"
        guidance = f"; guidance: {name_guidance(plans)}" if name_guidance(plans) else ""
        stated = {**self.tasks}
        if "demand" in stated:
            stated["demand"] = "by shelf" if stated["demand"] == "shelves" else "by place"
        tasks = "".join(f", {name} {one}" for name, one in stated.items())
        return (
            f"{agents} agents, {timesteps} timesteps{end}, {runs}, {plans[0].whose}{tasks}; "
            f"planner: {' | '.join(map(describe_planner, planners or [self.planner]))}{guidance}"
        )


def each_planner(options: Mapping[str, Any]) -> list[Fleet]:
    """Resolve `StudyOptions` once for each planner: one, or a list of names and settings.

    Raises InputError as `Fleet` does, or if settings are stated beside several planners.
    """
    planners, changes = options.get("planner"), {}
    if planners and isinstance(planners, tuple) and isinstance(planners[-1], dict):
        name, changes = planners  # of a command line
        planners = name.split(",") if name and "," in name else [planners]
    planners = list(planners) if isinstance(planners, list | tuple) else [planners]
    several = len(planners) > 1
    if several and changes:
        name = f"--planner.{next(iter(changes)).replace('_', '-')}"
        raise InputError(f"{name}: several planners have their defaults: leave it out")
    missing = not planners or (several and not all(planners))
    if missing or any(planners.count(one) > 1 for one in planners):
        raise InputError("name each planner once, as in negotiated,pbs,pibt")
    # Among several, an effort is that of the negotiated planner.
    others = {"effort": None} if several else {}
    return [
        Fleet({**options, "planner": one} | ({} if one == OWN else others), StudyOptions)
        for one in planners
    ]


def read_plan(layout: Any, domain: str | None = None) -> Plan:
    """Read a layout: the path of a file, a `Plan`, a `Layout`, or an int array [H, W] of tiles.

    `domain` says whose it is, which arrays alone need. Returns the plan: tiles, domain, and what
    its file states. Raises InputError if it is not a layout, or one of another domain.
    """
    if isinstance(layout, str | Path):
        return read_file(layout, domain)
    name = name_of(layout)
    if isinstance(layout, Plan | Layout):
        if domain not in (None, layout.domain.name):
            raise InputError(f"this layout is of {layout.domain.name}: leave domain out")
        if isinstance(layout, Plan):
            return layout._replace(assumed=False)
        facts = layout.details.get("facts", {})
        facts = make_facts({one: facts[one] for one in FACTS if one in facts}, Path(name))
        own = tuple(layout.details.get("keep", ())), layout.costs
        guidance = "none" if layout.costs is None else name
        tiles = _check_tiles(layout.layout, layout.domain)
        return Plan(name, tiles, layout.domain, False, *own, guidance, facts)
    if domain is None:
        names = ", ".join(repr(name) for name in DOMAINS.names())
        raise InputError(f"an array does not say whose layout it is: give domain, one of {names}")
    found = find_domain(domain)
    return Plan(name, _check_tiles(layout, found), found, assumed=False)


def _check_tiles(layout: Any, domain: Domain) -> np.ndarray:
    """Return tiles as int8 [H, W]; InputError if they are none of the domain's."""
    tiles = to_array(layout)
    if tiles.ndim != 2 or tiles.dtype.kind not in "iu" or not tiles.size:
        raise InputError("a layout is an array of integers with rows and columns")
    if tiles.min() < 0 or tiles.max() >= len(domain.tiles):
        known = f"0 to {len(domain.tiles) - 1} ({domain.tiles!r})"
        raise InputError(f"tiles of {domain.name} are {known}")
    return tiles.astype(np.int8)


def open_run(run: Any) -> RunDirectory:
    """Return a run that is given as its record, its folder or its name in the zoo."""
    from qdenv.run.directory import RunDirectory

    return run if isinstance(run, RunDirectory) else RunDirectory.open(run)


def name_of(layout: Any) -> str:
    """Return the path of a layout's file as given, the name of a plan, or "layout"."""
    if isinstance(layout, str | Path):
        return str(layout)
    return layout.name if isinstance(layout, Plan) else "layout"
