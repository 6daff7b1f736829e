"""What jax computes on, and what follows from it: decided here and nowhere else."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Callable
from typing import Any, Literal

from qdenv.lazy import jax
from qdenv.types import InputError

# Where a planner runs; "auto" is the host, beside accelerators, too: an H200 took 96 ms a run (250
# side by side; 33 x 36, 200 agents, T = 1000), one core of its machine 160 ms: two are faster.
Backend = Literal["auto", "xla", "host"]
ACCELERATOR_CHUNK = 10  # layouts simulated by one call on an accelerator


def on_cpu() -> bool:
    """Return True if jax computes on the host's own cores."""
    return jax.default_backend() == "cpu"


def lanes(on_accelerator: int, on_host: int = 1) -> int:
    """Choose how many items to compute side by side (vmap); the rest wait in line (scan)."""
    # On a CPU by themselves: then each pays only for its own work.
    return on_host if on_cpu() else on_accelerator


def count() -> int:
    """Count the devices that share the work: all of this process, or one `jax.default_device`."""
    chosen = getattr(jax.config, "jax_default_device")  # noqa: B009 (jax does not declare it)
    return 1 if chosen else jax.local_device_count()


def threads(on_host: bool = True) -> int:
    """Count the threads that simulate: one per core, or one that feeds an accelerator."""
    return count_cores() if on_host or on_cpu() else 1


def placed(on_host: bool) -> contextlib.AbstractContextManager:
    """Let jax compute on the host's cores within a context, even where it has an accelerator."""
    # A host callback blocks the queue of its device: on an accelerator threads would take turns.
    if on_host and not on_cpu():
        return jax.default_device(jax.local_devices(backend="cpu")[0])
    return contextlib.nullcontext()


def check_memory(make: Callable, argument: Any, what: str, advice: str) -> None:
    """Raise InputError if `make(argument)` would return more than the memory of this machine holds.

    Only shapes are computed. The message is "`what` takes ... of memory: choose `advice`".
    """
    leaves = jax.tree.leaves(jax.eval_shape(lambda: make(argument)))
    needed = sum(leaf.size * leaf.dtype.itemsize for leaf in leaves)
    if needed > os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE"):
        raise InputError(f"{what} takes {needed / 2**30:,.0f} GiB of memory: choose {advice}")


def count_cores() -> int:
    """Count the cores this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1
