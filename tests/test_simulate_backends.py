"""One set of numbers: compiled host code, XLA, and a program exported without any callback."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from fleet_runs import AGENTS, PLAIN, SERVICES, give_little_room, programs
from jax import export
from robustness.fleets import SHAPE, random_layout

from qdenv.domains.base import find_domain
from qdenv.simulation.mapf import fleet
from qdenv.simulation.mapf.host.distances import empty_fields
from qdenv.simulation.mapf.host.state import make_run
from qdenv.simulation.mapf.negotiated.settings import LOW, NegotiatedConfig
from qdenv.simulation.mapf.pibt import numba as pibt_on_host
from qdenv.simulation.mapf.pibt import planner as pibt_in_xla
from qdenv.simulation.mapf.planner import NOBODY
from qdenv.simulation.mapf.settings import PibtConfig
from qdenv.study.engine import _program

pytestmark = pytest.mark.slow

# The settings of each planner with the backends "host" and "xla".
BACKENDS = {
    "pibt": (PibtConfig("host"), PibtConfig("xla")),
    "negotiated": (replace(LOW, backend="host"), replace(LOW, backend="xla")),
}


@pytest.mark.parametrize("planner", BACKENDS)
def test_a_simulation_in_xla_is_exported_whole_and_gives_the_hosts_numbers(planner):
    """A host callback could not be exported, so what goes through a file has none."""
    domain, (host, xla) = find_domain("warehouse-uneven").resized(13, 16), BACKENDS[planner]
    task = domain.simulator.tasks

    def simulation(settings):
        config = fleet.FleetConfig(agents=12, timesteps=53, planner=settings)

        def run(layout, key_data):
            key = jax.random.wrap_key_data(key_data)
            return tuple(fleet.simulate(fleet.prepare(layout, task, config), key, config))

        return jax.jit(run)

    layout = jnp.asarray(domain.human())
    arguments = layout, jax.random.key_data(jax.random.key(2))
    stored = export.export(simulation(xla))(*arguments).serialize()
    exported = export.deserialize(stored).call(*arguments)
    on_host = simulation(host)(*arguments)
    assert on_host[0] > 0.2  # tasks per timestep
    jax.tree.map(np.testing.assert_array_equal, exported, on_host)
    with pytest.raises(Exception, match="callback"):
        export.export(simulation(host))(*arguments).serialize()


@pytest.mark.parametrize("device", ["cpu", "default"])
@pytest.mark.parametrize("keep", [False, True])
@pytest.mark.parametrize("planner", BACKENDS)
def test_a_run_outside_of_xla_is_the_one_inside_bit_for_bit(planner, keep, device, monkeypatch):
    """Studies drive on the host without a program around it; seven agents have room for nine."""
    # An accelerator calls the host in another way.
    monkeypatch.setattr(jax.lax, "platform_dependent", lambda *inputs, **by: by[device](*inputs))
    config = fleet.FleetConfig(agents=9, timesteps=53, planner=BACKENDS[planner][0])
    layout = random_layout(np.random.default_rng(5), 0.2)
    prepare, run, _ = _program(SERVICES, config, layout.shape, keep, priced=False)

    @jax.jit
    def inside(layout, key, count):
        return fleet.record(fleet.prepare(layout, SERVICES, config), key, config, count)

    for seed, agents in ((0, 7), (3, 9), (0, 10)):
        outside, recording = jax.tree.map(np.asarray, run(prepare(layout), seed, agents))
        traffic, tape = inside(layout, jax.random.key(seed), np.int32(agents))
        jax.tree.map(np.testing.assert_array_equal, outside, traffic)
        assert outside.finished.sum() > 0 or agents > 9
        if keep and agents <= 9:
            jax.tree.map(np.testing.assert_array_equal, recording, tape)
        assert (recording is None) != keep


@pytest.mark.parametrize(
    ("rule", "settings"),
    [
        (SERVICES, {}),
        (SERVICES, {"conflict_levels": 1, "remember": False, "lanes": 5, "penalties": (0.5, 3.0)}),
        (PLAIN, {"conflict_levels": 4, "lookahead": 7, "rounds": 2.0, "penalties": (0.5, 1e6)}),
    ],
    ids=["services", "one level, no memory", "no services, seven steps ahead"],
)
def test_the_host_negotiates_as_xla_does(rule, settings):
    outcomes = []
    for backend in ("host", "xla"):
        planner = NegotiatedConfig(backend=backend, **settings)
        config = fleet.FleetConfig(
            agents=AGENTS, timesteps=100, planner=planner, stop_when_congested=False
        )
        prepare, run = programs(rule, config)
        outcomes.append([])
        for seed in range(6):
            layout = random_layout(np.random.default_rng(seed), 0.3 * (seed % 2))
            agents = int((0.3 + 0.05 * seed) * min(AGENTS, (layout != 1).sum()))
            key, count = jax.random.key(seed), jnp.int32(agents)
            result = run(prepare(jnp.asarray(layout)), key, count)
            outcomes[-1].append(jax.tree.map(np.asarray, result))
            assert result[0].finished.sum() > 0
    jax.tree.map(np.testing.assert_array_equal, *outcomes)


def test_the_host_pushes_as_xla_does():
    size, count = SHAPE[0] * SHAPE[1], 70
    in_xla = jax.jit(lambda *given: pibt_in_xla.one_step(*given, size))
    rollout = pibt_on_host.make_rollout(count, 1, size)
    config = fleet.FleetConfig(agents=count, planner=PibtConfig("host"), window=1, horizon=1)
    layout = random_layout(np.random.default_rng(0), 0.1)
    world = jax.tree.map(np.asarray, fleet.prepare(layout, PLAIN, config))
    block = fleet.blank_outcome(world, config, False).block
    run = make_run(world, fleet.run_settings(config), count, jax.tree.map(np.asarray, block))
    fields = empty_fields(world.traversable.shape, len(run.grid.goals), 1)
    moved = 0
    for seed in range(80):
        rng = np.random.default_rng(seed)
        position = rng.permutation(size)[:count].astype(np.int32)
        row, column = position // SHAPE[1], position % SHAPE[1]
        ways = [(0, 0), (0, 1), (0, -1), (1, 0), (-1, 0)]
        near = np.stack(
            [
                np.clip(row + down, 0, SHAPE[0] - 1) * SHAPE[1]
                + np.clip(column + right, 0, SHAPE[1] - 1)
                for down, right in ways
            ],
            axis=1,
        )
        candidates = rng.permuted(near, axis=1).astype(np.int32)
        allowed = rng.integers(1, 6, count).astype(np.int32)
        order = rng.permutation(count).astype(np.int32)
        rollout.path[:, 0], rollout.candidates[:] = position, candidates
        rollout.num_allowed[:], rollout.occupant[position] = allowed, np.arange(count)
        rollout.order[:] = order
        pibt_on_host.push_along(run, fields, rollout, 0, None)
        host = rollout.path[:, 1]
        np.testing.assert_array_equal(in_xla(candidates, position, allowed, order), host)
        assert len(set(host.tolist())) == count
        assert (rollout.occupant == NOBODY).all() and (rollout.claimant == NOBODY).all()
        moved += int((host != position).sum())
    assert moved > 80 * count / 4


@pytest.mark.parametrize("planner", BACKENDS)
def test_distances_on_demand_change_nothing(planner, monkeypatch):
    """XLA keeps two rows per agent, the host measures what is asked: the same runs as a table."""
    host, xla = BACKENDS[planner]
    layout = jnp.asarray(random_layout(np.random.default_rng(4), 0.2))

    def outcome(settings):
        config = fleet.FleetConfig(agents=40, timesteps=60, planner=settings)
        prepare, run = programs(SERVICES, config)
        world = prepare(layout)
        return world, jax.tree.map(np.asarray, run(world, jax.random.key(5), jnp.int32(33)))

    table, expected = outcome(xla)
    assert table.distance is not None and expected[0].finished.sum() > 20
    monkeypatch.setattr(fleet, "_TABLE_BYTES", 0)
    for settings in (xla, host):
        world, found = outcome(settings)
        assert world.distance is None
        jax.tree.map(np.testing.assert_array_equal, found, expected)


def test_little_room_for_distances_changes_nothing(monkeypatch):
    """A window that lacks room is planned again with more, from where it began."""
    domain = find_domain("warehouse-even").resized(60, 61)
    layout, rule = jnp.asarray(domain.human()), domain.simulator.tasks
    config = fleet.FleetConfig(agents=90, timesteps=60, planner=LOW)

    def outcome():
        prepare, run = programs(rule, config)
        return jax.tree.map(np.asarray, run(prepare(layout), jax.random.key(1), jnp.int32(90)))

    expected = outcome()
    rooms = give_little_room(monkeypatch)
    jax.tree.map(np.testing.assert_array_equal, outcome(), expected)
    assert rooms and expected[0].finished.sum() > 20
