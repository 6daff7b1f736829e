"""Where a search begins: zeros, or a generator that an earlier run found."""

from dataclasses import replace

import numpy as np

from qdenv.domains.base import make_domain
from qdenv.generate.generator import GENERATORS
from qdenv.io.arrays import Column, read_arrays
from qdenv.training.config import RunConfig
from qdenv.training.records import START, RunDirectory
from qdenv.types import InputError


def find_start(config: RunConfig) -> np.ndarray | None:
    """Find the generator that `config.start` names: its parameters, float [P]; None for zeros.

    Raises:
        InputError: there is no such run or elite, or its generator is of another kind.
    """
    if not config.start:
        return None
    source, _, cell = config.start.partition("@")
    run = RunDirectory.open(source)
    found = run.archive.elite(cell or "best")
    tiles = make_domain(config.evaluation.domain).tiles
    if run.tiles != tiles:
        raise InputError(f"start {config.start}: it draws {run.tiles}, this domain has {tiles}")
    asked, kept = config.evaluation.generator, run.config.evaluation.generator
    if hasattr(kept, "steps") and type(asked) is type(kept):
        kept = replace(kept, steps=asked.steps)  # it grows for as long as it is asked to
    if asked != kept:
        names = [GENERATORS.name_of(one) for one in (kept, asked)]
        raise InputError(
            f"start {config.start}: its generator ({names[0]}) and this search's ({names[1]}) have "
            f"other settings: take those of {run}"
        )
    return found.solution


def read_start(run: RunDirectory) -> np.ndarray | None:
    """Read the start that a run keeps, float [P]; None for zeros.

    Raises:
        InputError: the file is missing or damaged.
    """
    if not run.config.start:
        return None
    path = run.path / START
    if not path.exists():
        raise InputError(f"{path} is missing: copy it back, or train anew in another folder")
    return read_arrays(path, {"solution": Column("f", 1)}, None)["solution"]
