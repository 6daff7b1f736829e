"""What a worker of a cluster does: repair and simulate layouts, as the search itself would."""

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
    """Name what decides a result: versions of packages, and this one's very code and agent."""
    code = hashlib.blake2b(digest_size=8)
    home = Path(__file__).parents[2]
    files = (path for path in home.rglob("*") if path.suffix in (".py", ".npz"))  # and the agent
    for path in sorted(files):
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


Answer = tuple[np.ndarray, int, list[np.ndarray]]


def evaluate_layouts(
    settings: str, wanted: str, layouts: np.ndarray, first: int, key: np.ndarray
) -> list[Answer]:
    """Repair and simulate layouts, one by one.

    Args:
        settings: a whole `RunConfig` as JSON.
        wanted: `versions` of the search.
        layouts: int8 [n, H, W], unrepaired.
        first: index of the first of them in its population.
        key: uint32, the data of the population's key.

    Returns:
        for each the repaired layout int8 [H, W], its status, and the leaves of its runs, each with
        a leading axis 1.

    Raises:
        WrongWorkerError: this worker has other versions.
    """
    check_versions(wanted)
    return [_evaluate(settings, one, first + place, key) for place, one in enumerate(layouts)]


def _evaluate(settings: str, layout: np.ndarray, index: int, key: np.ndarray) -> Answer:
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
