"""What a person wants kept, put into a run's configuration."""

import dataclasses
from pathlib import Path

from qdenv.domains.base import make_domain
from qdenv.run.config import RunConfig
from qdenv.study.plans import keep_from


def choose_keep(config: RunConfig, path: Path) -> RunConfig:
    """Put cells that must stay into a configuration, whose size the drawing has.

    Args:
        config: at its final size, with its final numbers of tiles.
        path: the drawing: ``?`` is free, a tile stays this tile.

    Raises:
        InputError: the file is no such drawing, or asks for what no layout can be.
    """
    kept = keep_from(path, make_domain(config.evaluation.domain))
    evaluation = dataclasses.replace(config.evaluation, domain=kept.config)
    return dataclasses.replace(config, evaluation=evaluation)
