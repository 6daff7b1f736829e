"""One run to be looked at: where everybody was at every timestep, and where they were going."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from qdenv.progress import Progress, silent
from qdenv.ranges import Seed, check_range
from qdenv.simulate.mapf.settings import FleetConfig
from qdenv.study.options import fleet_tasks
from qdenv.study.plans import Plan
from qdenv.types import InputError, Traffic

if TYPE_CHECKING:
    from qdenv.simulate.maze.policy import Weights

MAZES = ("maze-walls", "maze-entropy")
MOST_SHOWN = 20_000_000  # agent-steps of a run that a browser still moves through


class Motion(NamedTuple):
    """What moved in one run of E timesteps with A agents; cells are ``row * columns + column``."""

    positions: np.ndarray  # int32 [E + 1, A]
    goals: np.ndarray  # int32 [E + 1, A], the cell each agent is heading for at each timestep
    finished: np.ndarray  # bool [E, A], tasks finished by each step
    congested: tuple[tuple[int, int], ...]  # (begin, end) of each stretch of congested windows
    timesteps: int  # T, of which E are driven
    # int8 [E + 1], where the agent of a maze looks: 0 right, 1 down, 2 left, 3 up; None for robots,
    # which look nowhere
    headings: np.ndarray | None = None
    shortest: int = 0  # moves of the maze's shortest path; 0 for robots

    @property
    def steps(self) -> int:
        """Say how many timesteps were driven, E."""
        return len(self.positions) - 1

    @property
    def waits(self) -> np.ndarray:
        """Tell who waits in which step (bool [E, A]): no move, anywhere but on the own goal."""
        after = self.positions[1:]
        return (after == self.positions[:-1]) & (after != self.goals[:-1])


def check_run(agents: int, timesteps: int, seed: int) -> None:
    """Refuse what no replay can show.

    Raises:
        InputError: the seed is none, or the run is too long.
    """
    check_range("seed", seed, Seed)
    if agents * timesteps > MOST_SHOWN:
        raise InputError(
            f"{agents} agents over {timesteps} timesteps are too much for a browser: replay at "
            f"most {MOST_SHOWN // agents} timesteps"
        )


def record_fleet(
    plan: Plan, config: FleetConfig, seed: int = 0, progress: Progress = silent
) -> tuple[Motion, Traffic]:
    """Simulate one run of a fleet and keep every step.

    Args:
        plan: where.
        config: the numbers.
        seed: of starts, goals and ties; the run that `simulate` counts for this seed.
        progress: called with the progress.

    Raises:
        InputError: the fleet cannot work on this layout, or the run is too long to be shown.
    """
    check_run(config.agents, config.timesteps, seed)
    tasks = fleet_tasks(plan.layout, plan.domain.simulator.tasks, config.agents)
    from qdenv.study.engine import run_seeds  # imports the simulator

    def read(seed: int, run: Traffic, recording: Any) -> Motion:
        end = int(run.end_timestep)
        return Motion(
            positions=recording.positions[: end + 1],
            goals=recording.goals[: end + 1],
            finished=recording.finished[:end],
            congested=_congested(recording, end, config.horizon),
            timesteps=config.timesteps,
        )

    done = run_seeds(plan.layout, tasks, config, (seed,), read=read, progress=progress)
    return done.readings[0], done.runs[0]


def _congested(recording: Any, end: int, horizon: int) -> tuple[tuple[int, int], ...]:
    """Find the windows in which more than half of the agents are stuck, as `simulate` says it."""
    count = end // horizon
    positions, serving = recording.positions, recording.remaining_service > 0
    stretches: list[tuple[int, int]] = []
    for begin in range(0, count * horizon, horizon):
        window = slice(begin, begin + horizon)
        stuck = (positions[window] == positions[begin]).all(0) & ~serving[window].any(0)
        if stuck.sum() > stuck.size // 2:
            since = stretches.pop()[0] if stretches and stretches[-1][1] == begin else begin
            stretches.append((since, begin + horizon))
    return tuple(stretches)


def trace_agent(
    plan: Plan, seed: int = 0, timesteps: int | None = None, weights: Weights | None = None
) -> Motion:
    """Let an agent walk through a maze once and keep every pose.

    Args:
        plan: the maze.
        seed: of the first heading and of all actions.
        timesteps: actions after which the episode fails; as `evaluate-agent` unless given.
        weights: of the agent; those of the shipped one unless given.

    Raises:
        InputError: there is nothing to solve, or the seed is none.
    """
    check_run(1, timesteps or 1, seed)
    import jax
    import jax.numpy as jnp

    from qdenv.agent.evaluate import default_horizon
    from qdenv.simulate.maze.episode import trace_episode
    from qdenv.simulate.maze.policy import load_weights, prepare

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
