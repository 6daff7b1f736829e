"""Several accelerators: the items of a batch are shared out among them.

Each item is computed by one device, as it would be alone, and nothing is added up across devices:
their number decides how long a batch takes and no bit of what comes out.
"""

import threading
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.sharding import Mesh, NamedSharding, PartitionSpec

_AXIS = "devices"
# Held during a call that devices share: they wait for each other in it, and two calls at once
# could deadlock.
turn = threading.Lock()


def map_items(function: Callable[..., Any], *items: Any) -> Any:
    """Apply a function to batches of items, an equal share on each device; traceable.

    The function, traceable and without host callbacks, turns shares of the batches (trees of
    arrays with leading axis B) into results, each item's from that item alone. What the devices do
    not divide is filled up. The results, with leading axis B, are whole on every device.
    """
    devices = jax.local_devices()
    mesh = Mesh(np.asarray(devices), (_AXIS,))
    # Replicated on both sides: else the compiler would shard what comes before and after, and
    # add up in another order there.
    whole = NamedSharding(mesh, PartitionSpec())
    size = len(jax.tree.leaves(items)[0])
    full = jax.tree.map(lambda leaf: _filled(leaf, -(-size // len(devices)) * len(devices)), items)
    shared = jax.shard_map(
        function,
        mesh=mesh,
        in_specs=PartitionSpec(_AXIS),
        out_specs=PartitionSpec(_AXIS),
        check_vma=False,  # loops begin from constants, which do not vary, and end with what does
    )
    results = shared(*jax.lax.with_sharding_constraint(full, whole))
    results = jax.lax.with_sharding_constraint(results, whole)
    return jax.tree.map(lambda leaf: leaf[:size], results)


def map_runs(function: Callable[..., Any], layouts: Any, runs: jax.Array) -> Any:
    """Apply a function to layouts and their runs, so that few layouts use all devices as well.

    The function is that of `map_items`: (layouts [b, H, W], runs [b, s]) -> results with leading
    axes b, s. `layouts` are arrays [B, ...], `runs` [B, S] what the runs of each layout draw from.
    """
    count, seeds = runs.shape
    parts = count_parts(count, seeds, jax.local_device_count())
    filled = _filled(runs.T, -(-seeds // parts) * parts)  # [parts * s, B]
    drawn = filled.reshape(parts, -1, count).swapaxes(1, 2).reshape(parts * count, -1)
    copies = jax.tree.map(lambda leaf: jnp.concatenate([leaf] * parts), layouts)
    results = map_items(function, copies, drawn)

    def ordered(leaf: jax.Array) -> jax.Array:
        by_part = leaf.reshape(parts, count, *leaf.shape[1:]).swapaxes(0, 1)
        return by_part.reshape(count, -1, *leaf.shape[2:])[:, :seeds]

    return jax.tree.map(ordered, results)


def count_parts(layouts: int, seeds: int, devices: int) -> int:
    """Choose into how many parts the runs of each layout are cut: a divisor of the devices.

    The busiest device has as few runs as possible; of equal choices the fewest parts win, for
    each computes again what the runs of its layout share.
    """
    divisors = (one for one in range(1, devices + 1) if devices % one == 0)
    return min(divisors, key=lambda parts: -(-layouts * parts // devices) * -(-seeds // parts))


def _filled(leaf: jax.Array, size: int) -> jax.Array:
    """Lengthen the leading axis with items from its beginning."""
    return leaf if size == len(leaf) else leaf[np.arange(size) % len(leaf)]
