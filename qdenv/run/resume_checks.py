"""What a run must still be to go on from a checkpoint: the same search, with as much left to do."""

import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from qdenv.run.config import RunConfig, config_to_json
from qdenv.types import InputError, Measure

# Settings that decide how long a run takes or how far it goes, but nothing of what it finds.
IDLE = ("evaluations", "checkpoint_every", "workers", "backend")


def settings_of(
    config: RunConfig, measures: Sequence[Measure], reads: Mapping[str, str]
) -> dict[str, Any]:
    """List what decides the result of a run, by the names of config.json (``algorithm.sigma0``).

    Args:
        config: the resolved configuration.
        measures: axes of the archive.
        reads: checksums of what the domain reads beside its settings.
    """
    axes = tuple((float(axis.low), float(axis.high), axis.cells) for axis in measures)
    content = json.loads(json.dumps(config_to_json(replace(config, archive=axes))))
    return dict(_flat(content)) | {f"the {name} of checksum": reads[name] for name in reads}


def _flat(content: dict[str, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    for name, value in content.items():
        if isinstance(value, dict):
            yield from _flat(value, f"{prefix}{name}.")
        elif name not in IDLE:
            yield f"{prefix}{name}", value


def check_settings(now: dict[str, Any], then: Mapping[str, Any], path: Path) -> None:
    """Refuse to go on with other settings than a checkpoint was made with.

    Args:
        now: `settings_of` the run.
        then: those in the checkpoint; only what both know is compared, an older qdenv knew less.
        path: the run directory.

    Raises:
        InputError: a setting differs; the line names it.
    """
    for name, value in now.items():
        if name in then and then[name] != value:
            raise InputError(
                f"{path}: its checkpoint was made with {name} {then[name]}, now it is {value}: "
                "put that back, or train anew in another folder"
            )


def check_total(evaluations: int, done: int, batch: int) -> None:
    """Refuse a new total that is below what is done.

    Args:
        evaluations: the new total.
        done: iterations.
        batch: evaluations of an iteration.

    Raises:
        InputError: it is.
    """
    if -(-evaluations // batch) < done:
        raise InputError(
            f"{done * batch} evaluations are done already: ask for more than that, or leave "
            "--evaluations out"
        )
