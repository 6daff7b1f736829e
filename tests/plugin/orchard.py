"""An orchard for qdenv: a domain with a fleet, a planner and a search algorithm."""

from dataclasses import dataclass, field
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

import qdenv

TILES = ".Tb"  # grass, tree, basket


@dataclass(frozen=True)
class OrchardConfig(qdenv.DomainConfig):
    """Pickers carry fruit from beside the trees to the baskets."""

    rows: int = 8
    cols: int = 9
    trees: int = 10  # exact number of trees
    # agents, horizon and planner
    fleet: qdenv.FleetConfig = field(default_factory=lambda: qdenv.FleetConfig(4, 60))


def orchard(config: OrchardConfig) -> qdenv.Domain:
    """Make an orchard of one size."""
    picking = qdenv.beside_goal(".", "T", stay=2, tiles=TILES)
    tasks = qdenv.TaskRule(TILES, ".b", (picking, qdenv.tile_goal("b", TILES)))
    rules = qdenv.Rules(
        tiles=TILES,
        counts=(qdenv.Count("T", config.trees, config.trees), qdenv.Count("b", 4)),
        adjacency=(qdenv.Adjacency("T", "."),),
        connected=".b",
        allowed=np.ones((config.rows, config.cols, len(TILES)), bool),
        change_cost=np.ones((config.rows, config.cols)),
    )
    return qdenv.Domain(
        config=config,
        tiles=TILES,
        generated=TILES,
        seed_block=("Tb",),
        rules=lambda: rules,
        simulator=qdenv.fleet_simulator(tasks, config.fleet),
        objective=lambda layout, runs: runs.throughput.mean(),
        measures=(
            qdenv.Measure("baskets", 0, 20, 10, lambda layout, runs: 1.0 * (layout == 2).sum()),
            qdenv.Measure("waiting", 0, 1, 10, lambda layout, runs: runs.waiting.mean()),
        ),
        counted={"trees": "T"},
    )


@dataclass(frozen=True)
class TurnsConfig:
    """Agents move one after the other, each to the free cell that looks nearest to its goal."""

    noise: float = 1.5  # steps by which a cell may look nearer than it is, so that jams dissolve


def take_turns(config: TurnsConfig) -> qdenv.Planner:
    """Make the planner: a window of steps for all agents, no two of which conflict."""

    def plan(
        world: qdenv.World, state: qdenv.AgentState, horizon: int, key: jax.Array
    ) -> jax.Array:
        width, agents = world.traversable.shape[1], jnp.arange(state.position.size)
        target = world.goals.cells[state.goal[0]]
        busy = (state.remaining_service > 0) | ~state.active
        moves = jnp.array([0, 1, -1, width, -width])

        def step(before: jax.Array, key: jax.Array) -> tuple[jax.Array, jax.Array]:
            noise = jax.random.uniform(key, (agents.size, 5)) * config.noise

            def move(now: jax.Array, agent: jax.Array) -> tuple[jax.Array, None]:
                cells = now[agent] + moves
                # Free now and a moment ago, so that nobody meets or swaps.
                met = (cells[:, None] == now[None]) | (cells[:, None] == before[None])
                met = met & (state.active & (agents != agent))[None]
                free = (world.traversable.reshape(-1)[cells] & ~met.any(1)).at[0].set(True)
                to_go = state.distance[state.row[0, agent], cells] + noise[agent]
                best = cells[jnp.argmin(jnp.where(free, to_go, 1e9))]
                stays = busy[agent] | (now[agent] == target[agent])
                return now.at[agent].set(jnp.where(stays, now[agent], best)), None

            after = jax.lax.scan(move, before, agents)[0]
            return after, after

        keys = jax.random.split(key, state.previous.shape[0] - 1)
        paths = jax.lax.scan(step, state.position, keys)[1]
        return jnp.concatenate([state.position[None], paths])

    return qdenv.Planner(plan)


@dataclass(frozen=True)
class MutateBestConfig:
    """Mutate the best solution so far."""

    batch: int = 8  # solutions per iteration
    sigma: float = 0.3  # standard deviation of the mutation


def mutate_best(config: MutateBestConfig, problem: qdenv.Problem) -> qdenv.Algorithm:
    """Make the algorithm; its state is the words of a random key, and the archive."""

    def init(key: jax.Array) -> tuple:
        blank = jnp.zeros(problem.solution_dim)
        archive = qdenv.GridArchive.empty(blank, problem.measures, problem.extras)
        return jax.random.key_data(key), archive

    def ask(state: tuple) -> tuple[jax.Array, tuple]:
        words, archive = state
        key, now = jax.random.split(jax.random.wrap_key_data(words))
        best = archive.genotypes[jnp.argmax(archive.objectives)]
        parent = jnp.where(archive.filled.any(), best, 0.0)
        noise = config.sigma * jax.random.normal(now, (config.batch, problem.solution_dim))
        return parent[None] + noise, (jax.random.key_data(key), archive)

    def tell(state: tuple, solutions: jax.Array, score: qdenv.Score, extras: Any) -> tuple:
        words, archive = state
        found = (solutions, score.result_objective, score.measures, extras, score.success)
        return words, archive.insert(*found)[0]

    return qdenv.Algorithm(init, ask, tell, lambda state: state[1], config.batch)


ORCHARD = qdenv.Entry(OrchardConfig, orchard)
TURNS = qdenv.Entry(TurnsConfig, take_turns)
MUTATE_BEST = qdenv.Entry(MutateBestConfig, mutate_best)
