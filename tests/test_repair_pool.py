"""The pool and the host callback: equal results however layouts are batched, nothing lost."""

import threading

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from qdenv.domains.base import find_domain
from qdenv.repairs import pool as pools
from qdenv.repairs.audit import audit
from qdenv.repairs.pool import RepairPool, repair_in_jit
from qdenv.repairs.recipe import repair_layout
from qdenv.repairs.settings import RepairConfig
from qdenv.types import RepairStatus

RULES = find_domain("warehouse-even").resized(8, 12, {"shelves": 12}).rules()
CONFIG = RepairConfig("quick", moves_per_cell=60, workers=2)


def batch(count: int, seed: int = 0) -> np.ndarray:
    layouts = np.random.default_rng(seed).integers(0, 3, (count, 8, 12)).astype(np.int8)
    fixed = RULES.allowed.sum(-1) == 1
    return np.where(fixed, RULES.allowed.argmax(-1), layouts).astype(np.int8)


def same(one, two) -> bool:
    names = ("layout", "status", "cost", "lower_bound")
    return all((np.asarray(getattr(one, n)) == np.asarray(getattr(two, n))).all() for n in names)


def test_pool_gives_what_single_repairs_give_in_any_order():
    layouts = batch(6)
    single = [repair_layout(layout, RULES, 3, CONFIG) for layout in layouts]
    with RepairPool(RULES, CONFIG) as pool:
        together = pool.repair(layouts, 3)
    with RepairPool(RULES, RepairConfig("quick", moves_per_cell=60, workers=1)) as pool:
        backwards = pool.repair(layouts[::-1], 3)
    for index, record in enumerate(single):
        assert same(record, type(record)(*(field[index] for field in together)))
        assert same(record, type(record)(*(field[5 - index] for field in backwards)))
    assert not any(audit(layout, RULES) for layout in together.layout)


def test_equal_layouts_are_repaired_once():
    layouts = batch(2)[[0, 1, 0, 0]]
    with RepairPool(RULES, CONFIG) as pool:
        first = pool.repair(layouts)
        again = pool.repair(layouts)
        other = pool.repair(layouts, seed=1)
    assert (first.seconds > 0).tolist() == [True, True, False, False]
    assert (again.seconds == 0).all() and same(first, again)
    assert (other.seconds > 0).tolist() == [True, True, False, False]


def test_callback_works_inside_jit_and_scan_and_is_traced_once():
    layouts, traced = batch(3), []
    with RepairPool(RULES, CONFIG) as pool:

        @jax.jit
        def twice(layouts, seeds):
            traced.append(1)
            return jax.lax.scan(lambda c, s: (c, repair_in_jit(pool, layouts, s)), 0, seeds)[1]

        records = twice(jnp.asarray(layouts), jnp.arange(2))
        twice(jnp.asarray(batch(3, 1)), jnp.arange(2))
        expected = [pool.repair(layouts, seed) for seed in range(2)]
    for seed in range(2):
        assert same(jax.tree.map(lambda field, s=seed: field[s], records), expected[seed])
    assert len(traced) == 1
    assert records.layout.shape == (2, 3, 8, 12) and records.layout.dtype == jnp.int8


def test_a_failing_worker_loses_nothing_and_is_not_remembered(monkeypatch):
    layouts, broken = batch(4), batch(4)[2]

    def fragile(layout, rules, seed, config):
        if (layout == broken).all():
            raise RuntimeError("solver died")
        return repair_layout(layout, rules, seed, config)

    monkeypatch.setattr(pools, "repair_layout", fragile)
    with RepairPool(RULES, CONFIG) as pool:
        records = pool.repair(layouts)
        monkeypatch.setattr(pools, "repair_layout", repair_layout)
        healed = pool.submit(broken).result()
    assert (records.status == RepairStatus.FAILED).tolist() == [False, False, True, False]
    assert (records.layout[2] == broken).all()
    assert healed.status < RepairStatus.IMPOSSIBLE


@pytest.fixture
def gate(monkeypatch):
    """Repairs that wait until the gate opens."""
    opened = threading.Event()

    def slow(layout, rules, seed, config):
        assert opened.wait(600)
        return repair_layout(layout, rules, seed, config)

    monkeypatch.setattr(pools, "repair_layout", slow)
    yield opened
    opened.set()


def test_what_has_not_begun_can_be_cancelled(gate):
    layouts = batch(3)
    with RepairPool(RULES, RepairConfig("none", moves_per_cell=60, workers=1)) as pool:
        running, waiting, kept = (pool.submit(layout) for layout in layouts)
        assert waiting.cancel()
        gate.set()
        assert running.result().status == kept.result().status == RepairStatus.ANNEALED
        assert pool.submit(layouts[1]).result().status == RepairStatus.ANNEALED


def test_a_full_queue_makes_submit_wait(gate, monkeypatch):
    monkeypatch.setattr(pools, "_WAITING_PER_WORKER", 2)
    layouts, queued = batch(4), []
    with RepairPool(RULES, RepairConfig("none", moves_per_cell=60, workers=1)) as pool:
        feeder = threading.Thread(
            target=lambda: queued.extend(pool.submit(layout) for layout in layouts)
        )
        feeder.start()
        feeder.join(0.3)
        assert feeder.is_alive() and pool._threads._work_queue.qsize() <= 2
        gate.set()
        feeder.join(600)
        assert len([future.result() for future in queued]) == 4
