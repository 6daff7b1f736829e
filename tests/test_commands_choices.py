"""What a command line chooses by name: domain, planner, algorithm, and a domain's own numbers."""

import re
from dataclasses import fields, is_dataclass

import pytest
from small_warehouse import ROWS

from qdenv.cli.main import run
from qdenv.configurations import PRESETS
from qdenv.domains.manufacturing import ManufacturingConfig
from qdenv.domains.warehouse import UnevenWarehouseConfig
from qdenv.run.config import choose_algorithm, choose_domain, choose_planner
from qdenv.search.map_elites import MapElitesConfig
from qdenv.search.registry import ALGORITHMS
from qdenv.simulation.mapf.negotiated.settings import HIGH
from qdenv.simulation.mapf.settings import PibtConfig
from qdenv.types import InputError

QUICK = PRESETS["quick"]


def test_another_domain_keeps_what_the_preset_states_and_both_have():
    uneven = choose_domain(QUICK, "warehouse-uneven")
    domain = uneven.evaluation.domain
    assert isinstance(domain, UnevenWarehouseConfig)
    assert (domain.rows, domain.cols, domain.shelves, domain.left_odds) == (17, 16, 40, 5.0)
    assert (domain.fleet, uneven.archive) == (QUICK.evaluation.domain.fleet, QUICK.archive)
    factory = choose_domain(QUICK, "manufacturing")
    own = ManufacturingConfig(rows=17, cols=16, fleet=QUICK.evaluation.domain.fleet)
    assert factory.evaluation.domain == own
    assert factory.archive == ()  # its ranges were those of other measures


def test_planners_are_chosen_by_effort_or_name_where_a_fleet_drives():
    assert choose_planner(QUICK, None, None) == QUICK
    high = choose_planner(QUICK, "high", None)
    assert high.evaluation.domain.fleet.planner == HIGH
    pibt = choose_planner(QUICK, None, "pibt")
    assert pibt.evaluation.domain.fleet.planner == PibtConfig()
    with pytest.raises(InputError, match="no fleet drives"):
        choose_planner(PRESETS["maze-quick"], "low", None)


def test_an_algorithm_comes_with_its_own_defaults():
    assert choose_algorithm(QUICK, "map-elites").algorithm == MapElitesConfig()


@pytest.mark.parametrize("name", ALGORITHMS.names())
def test_help_lists_the_settings_of_the_algorithm_that_is_named_and_no_others(name, capsys):
    with pytest.raises(SystemExit):
        run(["train", "quick", "--algorithm", name, "--help-all"])
    options = set(re.findall(r"--([a-z][\w-]*)", capsys.readouterr().out))

    def settings(algorithm):
        config = ALGORITHMS.config(algorithm)
        plain = (one.name for one in fields(config) if not is_dataclass(getattr(config, one.name)))
        return {one.replace("_", "-") for one in plain}

    own, others = settings(name), set().union(*map(settings, ALGORITHMS.names()))
    assert own and own <= options
    shared = {"seed", "evaluations", "archive"}
    assert not (others - own - shared) & options


@pytest.mark.parametrize(
    ("words", "names"),
    [
        ([], {"shelves"}),
        (["--domain", "manufacturing"], set()),
        (["--domain=maze-walls"], set()),
        (["--domain", "manufacturing", "--domain", "warehouse-even"], {"shelves"}),
    ],
)
@pytest.mark.parametrize("command", ["repair", "check", "layout tile"])
def test_a_command_has_an_option_for_each_number_of_its_domain(command, words, names, capsys):
    with pytest.raises(SystemExit):
        run([*command.split(), *words, "--help"])
    assert ("--shelves" in capsys.readouterr().out) == bool(names)


def test_a_stated_zero_is_no_missing_number(folder, capsys):
    (folder / "plan.txt").write_text("\n".join(ROWS))
    assert run(["check", "plan.txt", "--shelves", "0"]) == 1
    assert "exactly 0" in capsys.readouterr().out


@pytest.mark.parametrize(
    "name", ["simulate", "replay", "compare", "sweep", "scalability", "report"]
)
def test_robots_are_agents_in_every_command(name, tmp_path, capsys):
    (tmp_path / "plan.txt").write_text("w.e@\nw.e@\n")
    with pytest.raises(SystemExit):
        run([name, "--help"])
    assert "--robots" in (said := capsys.readouterr().out) and "--agents" in said
    for option in ("--robots", "--agents"):
        assert run([name, str(tmp_path / "plan.txt"), option, "-3"]) == 2
        assert "-3" in capsys.readouterr().err


def test_robots_are_agents_in_a_preset_and_in_guide(tmp_path, capsys):
    words = "train quick --robots 7 --evaluations 0".split()  # noqa: SIM905
    assert run(words) == 2
    assert "evaluations must be at least 1" in capsys.readouterr().err
    for command in ("train quick", "guide x.txt"):
        assert run([*command.split(), "--robots", "many"]) == 2
        assert "--robots or --agents must be an integer, not 'many'" in capsys.readouterr().err
