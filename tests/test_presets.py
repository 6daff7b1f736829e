"""The presets of the paper's rows: what the authors published, a base and an algorithm each."""

from dataclasses import replace

import pytest

from qdenv.configurations import PRESETS
from qdenv.search.settings import CmaEsConfig, MapElitesConfig

WITH_FLEETS = ("warehouse-even", "warehouse-uneven", "manufacturing")
MAZES = ("maze-walls", "maze-entropy")


@pytest.mark.parametrize("base", [*WITH_FLEETS, *MAZES])
def test_map_elites_rows_differ_from_cma_maes_in_the_algorithm_alone(base):
    row = PRESETS[f"{base}-map-elites"]
    assert isinstance(row.algorithm, MapElitesConfig)
    assert replace(row, algorithm=PRESETS[base].algorithm) == PRESETS[base]
    maze = base in MAZES
    assert row.evaluations == (100_000 if maze else 10_000)
    published = (5, 30, 1.0, float("-inf")) if maze else (5, 10, 0.01, 0.0)
    found = row.algorithm
    assert (found.emitters, found.batch, found.learning_rate, found.threshold_min) == published
    assert (found.sigma_iso, found.sigma_line) == (0.01, 0.2)


@pytest.mark.parametrize("base", WITH_FLEETS)
def test_cma_es_rows_have_its_defaults(base):
    row = PRESETS[f"{base}-cma-es"]
    assert row == replace(PRESETS[base], algorithm=CmaEsConfig())
