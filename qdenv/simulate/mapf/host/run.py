"""One run as one callback: jax's buffers in, compiled host code, jax's buffers out."""

import contextlib
from collections.abc import Iterator
from typing import Any

import jax
import numpy as np
from jax.experimental.buffer_callback import buffer_callback

from qdenv.simulate.mapf.host.crew import CONGESTED, MOVES, TIME, Crew, Numbers, Run, Tally, Tape
from qdenv.simulate.mapf.host.crew import place as place_crew
from qdenv.simulate.mapf.host.fields import empty_fields, make_room
from qdenv.simulate.mapf.host.site import site_of
from qdenv.simulate.mapf.metrics import Outcome
from qdenv.simulate.mapf.planner import Drive, World

SPARE_ROWS = 64  # fields of distances for more goals than two per agent


def empty_run(world: World, numbers: Numbers, agents: int, tape: Tape) -> Run:
    """Begin a run whose agents stand nowhere yet.

    Args:
        world: of numpy arrays.
        numbers: of the run.
        agents: how many take part.
        tape: where to record.
    """
    site = site_of(world)
    windows = -(-numbers.timesteps // numbers.horizon)
    crew = Crew(
        position=np.zeros(agents, np.int64),
        kind=np.zeros(agents, np.int64),
        goal=np.zeros((2, agents), np.int64),
        remaining_service=np.zeros(agents, np.int64),
        age=np.zeros(agents, np.int64),
        legs=np.zeros(agents, np.int64),
        paths=np.zeros((agents, numbers.window + 1), np.int64),
        stuck=np.zeros(agents, np.bool_),
    )
    tally = Tally(
        total=np.zeros(3, np.int64),
        finished=np.zeros(windows * numbers.horizon, np.int32),
        visits=np.zeros(site.free.size, np.int32),
    )
    return Run(site, crew, tally, tape, numbers)


def drive_to_the_end(drive: Drive, run: Run, shape: tuple[int, int]) -> None:
    """Drive a run whose agents have been placed, with as much room for distances as it takes."""
    goals, agents = run.site.goals.size, run.crew.position.size
    fields = empty_fields(shape, goals, min(goals, 2 * agents + SPARE_ROWS))
    while not drive(run, fields):
        fields = make_room(fields, run.crew.goal.reshape(-1))


def run_on_host(
    drive: Drive, world: World, seed: jax.Array, agents: jax.Array, numbers: Numbers, like: Outcome
) -> Outcome:
    """Run a simulation in a callback that works on jax's own buffers.

    Args:
        drive: of the planner.
        world: the layout.
        seed: uint32, of all that is drawn.
        agents: int32, how many take part.
        numbers: of the run, but for the seed.
        like: the shapes of what is returned.
    """

    def on_host(_: Any, *buffers: Any) -> None:
        # Only numpy here: a jax call inside a callback can wait for the very device it blocks.
        outcome, world, seed, agents = jax.tree.map(np.asarray, buffers)
        drive_into(outcome, drive, world, int(agents), numbers._replace(seed=int(seed)))

    result: Outcome = buffer_callback(on_host, like, vmap_method="sequential")(world, seed, agents)
    return result


def drive_into(outcome: Any, drive: Drive, world: World, agents: int, numbers: Numbers) -> None:
    """Run a simulation and write what happens into the numpy arrays of an `Outcome`.

    Args:
        outcome: all zeros, of the shapes that `fleet.blank_outcome` gives.
        drive: of the planner.
        world: of numpy arrays.
        agents: how many take part.
        numbers: of the run, its seed among them.
    """
    run = empty_run(world, numbers, agents, Tape(*outcome.buffer.block))
    if world.valid:
        place_crew(run)
        outcome.buffer.start[:agents] = run.crew.position
        with _under_way(run):
            rows, cols = world.traversable.shape
            drive_to_the_end(drive, run, (rows, cols))
    _report(run, outcome)


_runs: dict[int, Run] = {}  # those that are being driven now, in any thread


@contextlib.contextmanager
def _under_way(run: Run) -> Iterator[None]:
    """Let others see how far a run is."""
    _runs[id(run)] = run
    try:
        yield
    finally:
        del _runs[id(run)]


def steps_under_way() -> int:
    """Count the timesteps driven so far by all runs of this process that have not ended yet."""
    return sum(int(run.tally.total[TIME]) for run in list(_runs.values()))


def _report(run: Run, outcome: Any) -> None:
    """Write what happened into the buffers of an outcome."""
    metrics, total = outcome.metrics, run.tally.total
    metrics.time[...], metrics.congested_at[...] = total[TIME], total[CONGESTED]
    metrics.moves[...] = total[MOVES]
    metrics.finished[...], metrics.visits[...] = run.tally.finished, run.tally.visits
    outcome.heading[: run.crew.position.size] = run.site.goals[run.crew.goal[0]]
