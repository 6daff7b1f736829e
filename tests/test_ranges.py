"""Ranges of settings: one check for all, and no number among the settings without one."""

import dataclasses
import math
from typing import Annotated, Literal, get_type_hints

import numpy as np
import pytest
from annotated_types import Interval

from qdenv.agent.settings import LevelConfig, PPOConfig, RewardConfig, TrainConfig
from qdenv.domains.base import DOMAINS
from qdenv.generators import GENERATORS
from qdenv.ranges import (
    FiniteFloat,
    NonNegativeInt,
    PositiveFloat,
    PositiveInt,
    Ranged,
    Seed,
    Share,
    check_range,
)
from qdenv.repairs.settings import RepairConfig
from qdenv.run.config import RunConfig
from qdenv.search.registry import ALGORITHMS
from qdenv.settings import EvaluationConfig
from qdenv.simulation.mapf.settings import PLANNERS, FleetConfig
from qdenv.surrogates.settings import SurrogateConfig
from qdenv.types import InputError

WITHIN = [
    *((PositiveInt, value) for value in (1, np.int32(7), 2**31 - 1)),
    *((Share, value) for value in (0, 1, 0.5, np.float32(1))),
    *((FiniteFloat, value) for value in (-1e300, 0, 1e300)),
    *((PositiveInt | None, value) for value in (None, 3)),
    *((tuple[NonNegativeInt, ...], value) for value in ((), (0, 5))),
    *((Literal["never"] | PositiveInt, value) for value in ("never", 4)),
    (Annotated[float, Interval(gt=0)], math.inf),
    (int, -3),
]
BEYOND = [
    *((PositiveInt, value, "at least 1") for value in (0, -5)),
    (PositiveInt, 2**31, "at most 2147483647"),
    (PositiveInt, "7", "a number"),
    (Seed, 2**32, "at most 4294967295"),
    (Share, 1.0001, "at most 1"),
    (Share, -0.1, "at least 0"),
    (PositiveFloat, 0.0, "above 0"),
    (Annotated[float, Interval(lt=3)], 3, "below 3"),
    *((kind, math.nan, "a finite number") for kind in (Share, PositiveFloat, FiniteFloat)),
    *((FiniteFloat, value, "a finite number") for value in (math.inf, -math.inf)),
    (PositiveInt | None, 0, "at least 1"),
    (tuple[NonNegativeInt, ...], (3, -1), "at least 0"),
    (tuple[PositiveInt, PositiveFloat], (1, 0.0), "above 0"),
    (Literal["never"] | PositiveInt, 0, "at least 1"),
]


@pytest.mark.parametrize(("kind", "value"), WITHIN)
def test_what_lies_within_its_range_passes(kind, value):
    assert check_range("some_number", value, kind) is None


@pytest.mark.parametrize(("kind", "value", "wanted"), BEYOND)
def test_what_lies_beyond_is_refused_by_name(kind, value, wanted):
    with pytest.raises(InputError, match=f"^some-number must be {wanted}, not "):
        check_range("some_number", value, kind)


@pytest.mark.parametrize("kind", [PositiveInt, FiniteFloat, PositiveFloat])
@pytest.mark.parametrize("digits", [310, 5000])  # more than a float holds, than Python prints
def test_numbers_of_any_length_are_refused_in_words(kind, digits):
    with pytest.raises(InputError, match=r"^some-number must "):
        check_range("some_number", 10**digits, kind)


@dataclasses.dataclass(frozen=True)
class Drive(Ranged):  # noqa: D101
    robots: PositiveInt = 1
    share: "Share" = 0.5
    name: str = "yard"


def test_a_record_checks_its_fields_however_it_is_made():
    assert dataclasses.replace(Drive(), robots=3).robots == 3
    with pytest.raises(InputError, match="robots must be at least 1, not 0"):
        Drive(robots=0)
    with pytest.raises(InputError, match="share must be at most 1, not 2"):
        dataclasses.replace(Drive(), share=2)


CHOSEN = [
    registry.config(name)
    for registry in (DOMAINS, GENERATORS, PLANNERS, ALGORITHMS)
    for name in registry.names()
]
RECORDS = {
    *(RunConfig, EvaluationConfig, RepairConfig, FleetConfig, SurrogateConfig),
    *(TrainConfig, PPOConfig, RewardConfig, LevelConfig),
    # Plug-ins that other tests register have their own rules.
    *(type(config) for config in CHOSEN if type(config).__module__.startswith("qdenv.")),
}
ELSEWHERE = {"threshold_min"}  # checked where another setting is known


@pytest.mark.parametrize("record", sorted(RECORDS, key=lambda one: one.__name__))
def test_no_number_among_the_settings_is_without_a_range(record):
    hints = get_type_hints(record, include_extras=True)
    numbers = (int, float, int | None, float | None)
    bare = {field.name for field in dataclasses.fields(record) if hints[field.name] in numbers}
    assert bare <= ELSEWHERE
