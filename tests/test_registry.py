"""Choices by settings or name: what is found, what is refused, what a broken plug-in may do."""

from dataclasses import dataclass
from itertools import product

import pytest

from qdenv import devices
from qdenv.domains.base import DOMAINS, find_domain
from qdenv.generators import GENERATORS
from qdenv.registry import Entry, Registry
from qdenv.search.registry import ALGORITHMS
from qdenv.simulation.mapf.negotiated.settings import NegotiatedConfig
from qdenv.simulation.mapf.settings import PLANNERS, PibtConfig
from qdenv.types import InputError


@dataclass(frozen=True)
class TeaConfig:
    """How long tea draws."""

    minutes: int = 4


TEA = Entry(TeaConfig, lambda config, cups: f"{cups} cups after {config.minutes} minutes")
HERE = f"{__name__}:TEA"


def drinks(**more: str) -> Registry:
    return Registry("drink", "no.such.group", {"tea": HERE, **more})


def test_a_choice_is_found_by_its_name_and_by_the_type_of_its_settings():
    registry = drinks()
    assert registry.names() == ("tea",)
    assert registry.config("tea") == TeaConfig(4)
    assert registry.name_of(TeaConfig(7)) == "tea"
    assert registry.make(TeaConfig(7), 2) == "2 cups after 7 minutes"


def test_settings_derived_from_others_are_another_choice():
    class Strong(TeaConfig):
        pass

    registry = drinks()
    with pytest.raises(InputError, match="no drink is registered for Strong: choose from tea"):
        registry.name_of(Strong())
    registry.register("strong", Entry(Strong, lambda config: "strong"))
    assert registry.name_of(Strong()) == "strong"
    assert registry.name_of(TeaConfig()) == "tea"


def test_unknown_names_are_refused_with_what_there_is():
    with pytest.raises(InputError, match="unknown drink 'coffee': choose one of tea"):
        drinks().entry("coffee")


@pytest.mark.parametrize(
    ("reference", "said"),
    [
        ("no_such_module:COFFEE", "cannot be loaded"),
        (f"{__name__}:NOTHING", "cannot be loaded"),
        (f"{__name__}:HERE", "is not a qdenv.Entry"),
    ],
)
def test_a_broken_plugin_is_named_and_disturbs_nobody_else(reference, said):
    registry = drinks(coffee=reference)
    with pytest.raises(InputError, match=said) as refusal:
        registry.entry("coffee")
    assert "\n" not in str(refusal.value)
    assert registry.name_of(TeaConfig()) == "tea"
    with pytest.raises(InputError, match="no drink is registered"):
        registry.name_of(devices)


@pytest.mark.parametrize("registry", [DOMAINS, PLANNERS, GENERATORS, ALGORITHMS])
def test_every_built_in_choice_has_defaults_and_returns_from_its_settings(registry):
    for name in registry.names():
        assert registry.name_of(registry.config(name)) == name
        hash(registry.config(name))


def test_domains_scale_and_read_their_own_numbers():
    warehouse = find_domain("warehouse-even")
    assert warehouse.numbers == {"shelves": 240}
    # 240 shelves on 33 x 32 generated cells are 0.2273 a cell.
    assert warehouse.resized(57, 58).numbers == {"shelves": round(240 * 57 * 54 / (33 * 32))}
    assert warehouse.resized(57, 58, {"shelves": 5}).numbers == {"shelves": 5}
    layout = warehouse.resized(9, 18).human()
    assert warehouse.fitted(layout).numbers == {"shelves": 26}
    assert warehouse.fitted(layout).shape == (9, 18)
    with pytest.raises(InputError, match="manufacturing has no number of shelves"):
        find_domain("manufacturing").resized(33, 36, {"shelves": 5})


def test_planners_run_on_the_host_unless_xla_is_chosen():
    for kind, backend in product((NegotiatedConfig, PibtConfig), ("auto", "host", "xla")):
        on_host = PLANNERS.make(kind(backend=backend)).run_windows is not None
        assert on_host == (backend != "xla")
    assert devices.lanes(128, 4) == (4 if devices.on_cpu() else 128)
