"""Maze: one trained agent looks for the goal at the far end of the longest path (appendix B.3)."""

from __future__ import annotations

import hashlib
from collections.abc import Collection
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any, Self

import numpy as np

from qdenv import devices, score
from qdenv.domains.base import Domain, DomainConfig, KnownSize, Simulator, environment_entropy
from qdenv.grid import inside_frame
from qdenv.lazy import LazyModule, jax, jnp
from qdenv.ranges import NonNegativeInt, PositiveInt
from qdenv.registry import Entry
from qdenv.simulation.maze import policy, world
from qdenv.types import Measure, Tile

# Imported when it first runs: it loads jax.
episode: Any = LazyModule("qdenv.simulation.maze.episode")
_MARGIN = (1, 1)
_MEANINGS = {
    " ": Tile("empty", "the agent walks here; the longest path joins start and goal"),
    "X": Tile("wall", "the agent goes around it", True, also="#@"),
}
# On an accelerator all episodes of a population run side by side to the horizon; on a CPU one
# layout's at a time, because then the layout's episodes may stop with the last of them.
_ACCELERATOR_LANES = 7500


@dataclass(frozen=True)
class MazeConfig(DomainConfig):
    """Settings of a maze whose first measure is the number of walls."""

    rows: NonNegativeInt = 18  # rows of the maze with its ring of walls
    cols: NonNegativeInt = 18  # columns of the maze with its ring of walls
    timesteps: PositiveInt = 648  # actions after which an episode fails, T
    agent: str = ""  # an .npz agent; by default the shipped one

    def scaled(self, ratio: float, size: KnownSize | None, given: Collection[str]) -> Self:
        """Scale the length of an episode, or take the known one."""
        if "timesteps" in given:
            return self
        timesteps = size.timesteps if size else max(1, round(self.timesteps * ratio))
        return replace(self, timesteps=timesteps)


@dataclass(frozen=True)
class EntropyMazeConfig(MazeConfig):
    """Settings of a maze whose first measure is the environment entropy."""


# Reads an agent's file once (the shipped one for "").
agent_weights = lru_cache(maxsize=8)(policy.load_weights)


def checksum_of_agent(agent: str) -> str:
    """Return a checksum of an agent's weights."""
    digest = hashlib.blake2b(digest_size=6)
    for array in agent_weights(agent):
        digest.update(np.ascontiguousarray(array).tobytes())
    return digest.hexdigest()


def maze(config: MazeConfig) -> Domain:
    """Make a maze of one size; the type of the settings chooses its first measure."""

    def weights() -> policy.Weights:
        return jax.tree.map(jnp.asarray, agent_weights(config.agent))

    def run(prepared: Any, key: jax.Array) -> Any:
        loop = episode.until_done if devices.on_cpu() else episode.all_timesteps
        return episode.run_episode(weights(), prepared, key, config.timesteps, loop)

    def walls(layout: jax.Array, runs: Any) -> jax.Array:
        return score.count(inside_frame(layout, _MARGIN), "X", world.TILES)

    def path_length(layout: jax.Array, runs: Any) -> jax.Array:
        return runs.length.mean(dtype=jnp.float32)  # an episode that fails counts in full

    def start_and_goal(layout: np.ndarray) -> dict[str, int]:
        course = world.longest_path(layout)
        return {"start": int(course.start), "goal": int(course.goal)} if course.length else {}

    first = Measure("number of walls", 0, 256, 256, walls, "area")
    if isinstance(config, EntropyMazeConfig):
        first = environment_entropy(len(world.TILES), _MARGIN)
    return Domain(
        config=config,
        tiles=world.TILES,
        generated=world.TILES,
        seed_block=("XX", "XX"),
        margin=_MARGIN,
        frame=lambda area: jnp.pad(area, 1, constant_values=world.WALL),
        rules=None,
        simulator=Simulator(
            prepare=lambda layout: policy.prepare(weights(), layout),
            run=run,
            accelerator_lanes=_ACCELERATOR_LANES,
            layout_at_once=True,
        ),
        objective=lambda layout, runs: (runs.shortest > 0).any().astype(jnp.float32),
        objective_name="solvable [0 or 1]",
        # Nearly every maze is solvable; among those the one with the longest way shows most.
        tie_break="shortest",
        marks=start_and_goal,
        measures=(first, Measure("mean agent path length", 0, 648, 162, path_length, "timesteps")),
        meanings=_MEANINGS,
        known={(66, 66): KnownSize(steps=200, timesteps=2 * 66 * 66)},  # S_eval of the paper
        reads=lambda: {"agent": checksum_of_agent(config.agent)},
    )


WALLS = Entry(MazeConfig, maze)
ENTROPY = Entry(EntropyMazeConfig, maze)
