"""What a worker of a cluster does: repair and simulate one layout, as the search itself would."""

from __future__ import annotations

import hashlib
import json
import platform
import time
from collections.abc import Callable
from functools import lru_cache
from importlib import metadata
from pathlib import Path
from typing import Any

import numpy as np

# Packages whose version decides a result.
PACKAGES = ("jax", "jaxlib", "numpy", "numba", "highspy", "flax")


class WrongWorkerError(RuntimeError):
    """A worker has other versions than the search: nothing it finds may enter the archive."""


@lru_cache(maxsize=1)
def versions() -> str:
    """Name what decides a result: versions of packages, and the very code of this one."""
    code = hashlib.blake2b(digest_size=8)
    home = Path(__file__).parents[2]
    for path in sorted(home.rglob("*.py")):
        code.update(path.relative_to(home).as_posix().encode() + path.read_bytes())
    known = [f"{name} {metadata.version(name)}" for name in PACKAGES]
    python = ".".join(platform.python_version_tuple()[:2])
    return ", ".join([f"python {python}", *known, f"qdenv {code.hexdigest()}"])


def check_versions(wanted: str) -> None:
    """Refuse work for a search of other versions, which is a `WrongWorkerError`."""
    if versions() != wanted:
        raise WrongWorkerError(versions())


def timed(work: Callable[..., Any], *given: Any) -> tuple[float, Any]:
    """Do something and say how many seconds it took."""
    begun = time.perf_counter()
    answer = work(*given)
    return time.perf_counter() - begun, answer


@lru_cache(maxsize=2)
def _chain(settings: str) -> Any:
    """Build a run's chain once per worker: (pipeline, compiled simulator)."""
    import jax

    from qdenv.pipeline import make_pipeline
    from qdenv.training.config import config_from_json

    config = config_from_json(json.loads(settings), Path("the search"))
    pipeline = make_pipeline(config.evaluation, repair_seed=config.seed)
    return pipeline, jax.jit(pipeline.simulate)


def evaluate_layout(
    settings: str, wanted: str, layout: np.ndarray, index: int, key: np.ndarray
) -> tuple[np.ndarray, int, list[np.ndarray]]:
    """Repair and simulate one layout.

    Args:
        settings: a whole `RunConfig` as JSON.
        wanted: `versions` of the search.
        layout: int8 [H, W], unrepaired.
        index: of the layout in its population.
        key: uint32, the data of the population's key.

    Returns:
        the repaired layout int8 [H, W], its status, and the leaves of its runs, each with a leading
        axis 1.

    Raises:
        WrongWorkerError: this worker has other versions.
    """
    check_versions(wanted)
    import jax

    from qdenv.pipeline import unrepaired_as_is

    pipeline, simulate = _chain(settings)
    if pipeline.pool is None:
        repair = unrepaired_as_is(layout)
    else:
        repair = pipeline.pool.submit(layout, pipeline.repair_seed).result()
    repaired, whole = np.asarray(repair.layout), jax.random.wrap_key_data(jax.numpy.asarray(key))
    runs = simulate(repaired[None], np.array([index], np.int32), whole)
    return repaired, int(repair.status), [np.asarray(leaf) for leaf in jax.tree.leaves(runs)]
