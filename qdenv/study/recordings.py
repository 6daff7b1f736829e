"""What recordings of runs show: where agents wait, cell by cell, and one run step by step."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from qdenv.grid import NUM_MOVES, move_steps
from qdenv.progress import Progress, silent
from qdenv.ranges import Seed, check_range
from qdenv.simulation.mapf.settings import FleetConfig
from qdenv.stats import standard_error
from qdenv.study.plans import Plan
from qdenv.types import InputError, Traffic

if TYPE_CHECKING:  # imports the simulators
    from qdenv.simulation.mapf.metrics import Recording
    from qdenv.simulation.maze.policy import Weights

FADING = 0.05  # share by which falling throughput shows that a jam builds up
_DOUBT = 3.0  # standard errors by which it must fall, were tasks finished independently
MAZES = ("maze-walls", "maze-entropy")
MOST_SHOWN = 20_000_000  # agent-steps of a run that a browser still moves through


class Maps(NamedTuple):
    """What happened on each cell of a layout; of one run, or the mean of several.

    Waiting is a timestep without a move anywhere but on the agent's own goal: time that is spent
    being served there is work. An agent without an order does not wait.
    """

    usage: np.ndarray  # [H, W], agents on the cell, averaged over time
    # [H, W], agents that wait there, averaged over time: the share of time in which one does, as a
    # cell holds one agent
    waiting: np.ndarray
    visits: np.ndarray  # [H, W], agents that come to the cell, per timestep
    # [H, W], tasks finished there per timestep of the whole T; throughput in all
    finished: np.ndarray
    agents: float  # how many take part
    moves: np.ndarray  # [5, H, W], see `count_moves`

    @property
    def waiting_share(self) -> float:
        """Share of all the agents' time that is spent waiting."""
        return float(self.waiting.sum() / max(self.agents, 1))


def map_run(shape: tuple[int, int], run: Traffic, recording: Recording) -> Maps:
    """Count what happened on each cell of a layout of this shape in one recorded run.

    Only the timesteps that were driven count.
    """
    end, active = int(run.end_timestep), np.asarray(recording.active)
    positions = np.asarray(recording.positions)[: end + 1, active]
    goals = np.asarray(recording.goals)[:end, active]
    finished = np.asarray(recording.finished)[:end, active]
    before, after = positions[:-1], positions[1:]
    still = before == after

    def count(cells: np.ndarray) -> np.ndarray:
        return np.bincount(cells, minlength=shape[0] * shape[1]).reshape(shape) / max(end, 1)

    return Maps(
        usage=count(after.reshape(-1)),
        waiting=count(after[still & (after != goals) & (goals >= 0)]),
        visits=count(np.concatenate([positions[0], after[~still]])),
        # Per timestep of all of T, as throughput is: a run that congests finishes nothing more.
        finished=count(after[finished]) * end / len(np.asarray(run.finished)),
        agents=float(active.sum()),
        moves=count_moves(positions, shape),
    )


def count_moves(positions: np.ndarray, shape: tuple[int, int]) -> np.ndarray:
    """Count the moves away from each cell per timestep, and the waits there (float [5, H, W]).

    In the order of costs of moves; `positions` (int [E + 1, A]) are cells of a layout of `shape`.
    """
    cells, step = shape[0] * shape[1], np.diff(positions, axis=0)
    # Up and down come first: in a layout of one column they are the same steps as right and left.
    kinds = range(NUM_MOVES)[::-1]
    kind = np.select([step == one for one in move_steps(shape[1])[::-1]], kinds)
    counts = np.bincount((kind * cells + positions[:-1]).reshape(-1), minlength=NUM_MOVES * cells)
    return counts.reshape(NUM_MOVES, *shape) / max(len(step), 1)


def worst_cells(layout: np.ndarray, maps: Maps, most: int = 10) -> list[dict[str, Any]]:
    """List the cells of a layout (int8 [H, W]) with the most waiting, the worst first.

    Return for each row and column (from 0 at the top left), tile (index of what lies there), share
    (of all waiting, in 0 to 1), waiting (share of time in which an agent waits there) and
    wait_per_visit (timesteps that an agent waits there each time it comes by).
    """
    waiting, total = maps.waiting.reshape(-1), maps.waiting.sum()
    # Stable: of equal cells the first ones of the layout, on every machine.
    worst = np.argsort(-waiting, kind="stable")[:most]
    visits, tiles = maps.visits.reshape(-1), np.asarray(layout).reshape(-1)
    return [
        {
            "row": int(cell // layout.shape[1]),
            "column": int(cell % layout.shape[1]),
            "tile": int(tiles[cell]),
            "share": float(waiting[cell] / total),
            "waiting": float(waiting[cell]),
            "wait_per_visit": float(waiting[cell] / visits[cell]),
        }
        for cell in worst
        if waiting[cell] > 0
    ]


def cells_with_half(maps: Maps) -> int:
    """Count the fewest cells that together hold half of all waiting; 0 where no agent waits."""
    ordered = np.sort(maps.waiting.reshape(-1))[::-1].cumsum()
    return int(np.searchsorted(ordered, ordered[-1] / 2)) + 1 if ordered[-1] > 0 else 0


def throughput_over_time(runs: Sequence[Traffic], windows: int = 40) -> np.ndarray:
    """Average finished tasks per timestep over equal windows of whole timesteps.

    Return [3, n]: where each window ends, the mean over the runs, and its standard error (NaN for
    one run).
    """
    finished = np.stack([np.asarray(run.finished) for run in runs]).astype(float)
    steps = finished.shape[1]
    ends = np.unique(np.linspace(0, steps, min(windows, steps) + 1).astype(int))
    parts = np.add.reduceat(finished, ends[:-1], axis=1) / np.diff(ends)
    return np.stack([ends[1:], parts.mean(axis=0), standard_error(parts)])


def fading(runs: Sequence[Traffic]) -> float:
    """Return by which share of itself throughput falls as time goes on: a jam builds up.

    From the second quarter of the time to the last one, all runs together; the first one is spent
    setting out. 0 where the difference may be chance.
    """
    finished = np.sum([np.asarray(run.finished) for run in runs], axis=0)
    quarter = len(finished) // 4
    early, late = finished[quarter : 2 * quarter].sum(), finished[len(finished) - quarter :].sum()
    # Counts of independent events have their own number as variance (Poisson).
    return float(1 - late / early) if early - late > _DOUBT * np.sqrt(early + late) else 0.0


class Motion(NamedTuple):
    """What moved in one run of E timesteps with A agents; cells are ``row * columns + column``."""

    positions: np.ndarray  # int32 [E + 1, A]
    # int32 [E + 1, A], the cell each agent is heading for at each timestep; -1 without an order
    goals: np.ndarray
    finished: np.ndarray  # bool [E, A], tasks finished by each step
    congested: tuple[tuple[int, int], ...]  # (begin, end) of each stretch of congested windows
    timesteps: int  # T, of which E are driven
    # int8 [E + 1], heading of the agent of a maze: 0 right, 1 down, 2 left, 3 up; None for robots,
    # which have none
    headings: np.ndarray | None = None
    shortest: int = 0  # moves of the maze's shortest path; 0 for robots

    @property
    def steps(self) -> int:
        """Number of timesteps that were driven, E."""
        return len(self.positions) - 1

    @property
    def waits(self) -> np.ndarray:
        """Which agents wait in which step (bool [E, A]), as in `Maps`."""
        after = self.positions[1:]
        still = after == self.positions[:-1]
        return still & (after != self.goals[:-1]) & (self.goals[:-1] >= 0)


def _check_run(agents: int, timesteps: int, seed: int) -> None:
    """Raise InputError if the seed is none, or if the run is too long for a replay."""
    check_range("seed", seed, Seed)
    if agents * timesteps > MOST_SHOWN:
        long = f"{agents} agents over {timesteps} timesteps are too much for a browser"
        raise InputError(f"{long}: replay at most {MOST_SHOWN // agents} timesteps")


def record_fleet(
    plan: Plan, config: FleetConfig, seed: int = 0, progress: Progress = silent
) -> tuple[Motion, Traffic]:
    """Simulate and record the run of a fleet that `simulate` counts for this seed.

    Raises InputError if the fleet cannot work on this layout, or the run is too long to be shown.
    """
    _check_run(config.agents, config.timesteps, seed)
    # These import the simulator.
    from qdenv.simulation.mapf.audit import jammed_windows
    from qdenv.study.engine import run_seeds

    def read(seed: int, run: Traffic, recording: Recording) -> Motion:
        end = int(run.end_timestep)
        positions = np.asarray(recording.positions)[: end + 1]
        goals = np.asarray(recording.goals)[: end + 1]
        serving = (np.asarray(recording.remaining_service)[: end + 1] > 0) | (goals < 0)
        stretches: list[tuple[int, int]] = []
        for jam in jammed_windows(positions, serving, config.horizon):
            since = jam - config.horizon
            if stretches and stretches[-1][1] == since:
                since, _ = stretches.pop()
            stretches.append((since, jam))
        return Motion(
            positions=positions,
            goals=goals,
            finished=np.asarray(recording.finished)[:end],
            congested=tuple(stretches),
            timesteps=config.timesteps,
        )

    tasks = plan.domain.simulator.tasks
    done = run_seeds(plan.floor, tasks, config, (seed,), read=read, progress=progress)
    return done.readings[0], done.runs[0]


def trace_agent(
    plan: Plan, seed: int = 0, timesteps: int | None = None, weights: Weights | None = None
) -> Motion:
    """Record one walk of an agent through a maze; its first heading and actions are of a seed.

    The episode fails after `timesteps` actions, as in `evaluate-agent` unless given; the weights
    are those of the shipped agent unless given. Raises InputError if there is nothing to solve, or
    the seed is none.
    """
    _check_run(1, timesteps or 1, seed)
    import jax  # here: refusals are faster without it
    import jax.numpy as jnp

    from qdenv.agent.evaluate import default_horizon
    from qdenv.simulation.maze.episode import trace_episode
    from qdenv.simulation.maze.policy import load_weights, prepare

    steps = timesteps or default_horizon(plan.layout)
    weights = load_weights() if weights is None else weights
    tables = prepare(weights, jnp.asarray(plan.layout))
    episode, poses = trace_episode(weights, tables, jax.random.key(seed), steps)
    length = int(episode.length)
    if not length:
        raise InputError("this maze has no two empty tiles that touch: nothing to solve")
    finished = np.zeros((length, 1), bool)
    finished[-1] = bool(episode.success)
    return Motion(
        positions=np.asarray(poses.position)[: length + 1, None],
        goals=np.full((length + 1, 1), int(tables.course.goal), np.int32),
        finished=finished,
        congested=(),
        timesteps=steps,
        headings=np.asarray(poses.heading)[: length + 1].astype(np.int8),
        shortest=int(episode.shortest),
    )
