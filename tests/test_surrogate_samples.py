"""The ring of the newest samples against a deque, and the order in which they are learnt."""

import functools
from collections import deque

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from qdenv.surrogates.surrogate import Ring, Samples, shuffled

SHAPE = (2, 3)


def batch_of(names):
    """Make samples that all carry their name, in every field."""
    names = np.asarray(names)
    maps = np.broadcast_to(names[:, None, None], (len(names), *SHAPE))
    numbers = np.stack([names, -names, 2 * names], axis=1).astype(np.float32)
    return Samples(maps % 100, (maps + 1) % 100, maps / 1024, numbers)


@functools.cache
def adder():
    return jax.jit(lambda ring, batch, valid: ring.add(batch, valid))


@pytest.mark.parametrize("size", [1, 7, 64])
@pytest.mark.parametrize("batch", [5, 17])
def test_a_ring_keeps_the_newest_valid_samples_each_at_its_turn(size, batch):
    rng = np.random.default_rng(size)
    ring, oracle, name, told = Ring.empty(size, SHAPE, 3), deque(maxlen=size), 1, 0
    for share in (0.0, 1.0, 0.5, 0.1, 1.0, 0.7, 0.0):
        names, valid = np.arange(name, name + batch), rng.random(batch) < share
        name += batch
        for kept in names[valid]:
            oracle.append((told % size, kept))
            told += 1
        ring = adder()(ring, batch_of(names), valid)
        assert int(ring.added) == told and int(ring.known) == len(oracle)
        expected = np.zeros(size, int)
        for place, kept in oracle:
            expected[place] = kept
        found = np.asarray(ring.samples.numbers[:, 0]).astype(int)
        np.testing.assert_array_equal(found, expected)
        blank = expected == 0
        for one, other in zip(ring.samples, batch_of(expected), strict=True):
            np.testing.assert_array_equal(np.asarray(one, float)[~blank], other[~blank])
            assert not np.asarray(one)[blank].any()


def test_what_failed_or_cannot_be_counted_is_no_sample():
    batch = batch_of(np.arange(1, 7))
    numbers, usage = np.array(batch.numbers), np.array(batch.usage)
    numbers[2, 1], usage[4, 0, 0] = np.nan, np.inf
    spoilt = batch._replace(numbers=numbers, usage=usage)
    ring = adder()(Ring.empty(3, SHAPE, 3), spoilt, np.arange(6) != 1)
    np.testing.assert_array_equal(ring.samples.numbers[:, 0], [1, 4, 6])
    assert int(ring.added) == 3


@pytest.mark.parametrize("count", [0, 1, 6, 10])
def test_an_epoch_orders_the_known_samples_and_no_other(count):
    order = np.asarray(shuffled(jax.random.key(0), 10, jnp.int32(count)))
    assert order.dtype == np.int32
    assert sorted(order[:count]) == list(range(count)) and sorted(order) == list(range(10))


def test_every_order_of_three_samples_comes_as_often():
    keys = jax.random.split(jax.random.key(1), 6000)
    orders = np.asarray(jax.jit(jax.vmap(lambda key: shuffled(key, 5, jnp.int32(3))))(keys))[:, :3]
    _, seen = np.unique(orders, axis=0, return_counts=True)
    assert len(seen) == 6
    assert np.square(seen - 1000).sum() / 1000 < 20.5  # chi-square, 5 degrees, once in 1,000
