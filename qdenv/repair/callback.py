"""The repair inside jit: one host callback for the whole population."""

from typing import Any

import jax
import numpy as np

from qdenv.repair.pool import RepairPool
from qdenv.types import Array, Repair


def repair_in_jit(pool: RepairPool, layouts: Array, seed: Array | int) -> Repair:
    """Repair a batch from inside jit or scan.

    Args:
        pool: where to repair.
        layouts: int8 [B, H, W].
        seed: int32 or uint32 scalar, the base seed.

    Returns:
        A `Repair` whose fields have a leading axis B.
    """
    batch = layouts.shape[:1]

    def on_host(layouts: Array, seed: Array) -> Repair:
        # Only numpy here: a jax call inside a callback can wait for the very device it blocks.
        return pool.repair(np.asarray(layouts), int(np.asarray(seed)))

    shapes: dict[str, Any] = {
        "layout": jax.ShapeDtypeStruct(layouts.shape, np.int8),
        "status": jax.ShapeDtypeStruct(batch, np.int32),
        "cost": jax.ShapeDtypeStruct(batch, np.float32),
        "lower_bound": jax.ShapeDtypeStruct(batch, np.float32),
        "seconds": jax.ShapeDtypeStruct(batch, np.float32),
    }
    promised = Repair(**shapes)
    repaired: Repair = jax.pure_callback(on_host, promised, layouts, seed, vmap_method="sequential")
    return repaired
