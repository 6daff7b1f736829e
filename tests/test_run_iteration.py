"""A whole iteration as one program: a warehouse with a fleet, and no host code but the repair."""

from dataclasses import replace

import jax
import numpy as np
import pytest

import qdenv
from qdenv import devices
from qdenv.domains.warehouse import WarehouseConfig
from qdenv.nca import NcaConfig
from qdenv.pipeline import EvaluationConfig, PipelinedEvaluator
from qdenv.run.evaluate import Threads
from qdenv.run.experiment import observed
from qdenv.search.cma_mae import CmaMaeConfig
from qdenv.simulation.mapf.fleet import FleetConfig
from qdenv.simulation.mapf.negotiated.settings import LOW

pytestmark = [pytest.mark.slow, pytest.mark.usefixtures("emitted")]

NUMBERS = np.arange(1, 4)  # of iterations


def experiment(backend: str) -> qdenv.RunConfig:
    fleet = FleetConfig(agents=6, timesteps=30, planner=replace(LOW, backend=backend))
    evaluation = EvaluationConfig(
        domain=WarehouseConfig(rows=9, cols=10, shelves=6, fleet=fleet),
        generator=NcaConfig(steps=6, kernel_sizes=(3, 1), hidden=4),
        simulations=2,
    )
    config = qdenv.RunConfig(
        evaluation=evaluation,
        algorithm=CmaMaeConfig(emitters=2, batch=9, sigma0=0.5),
        archive=((0, 8, 8), (0, 1, 10)),
    )
    return qdenv.make_experiment(config, batch=2)


def callbacks(experiment) -> int:
    """Count the places in an iteration that leave the device."""
    state = experiment.algorithm.init(experiment.search_key)
    return str(jax.make_jaxpr(qdenv.make_iteration(experiment))(state, 1)).count("_callback[")


@pytest.fixture(scope="module")
def in_xla():
    return experiment("xla")


def test_an_archive_keeps_the_numbers_of_runs_that_earlier_archives_hold(in_xla):
    state = in_xla.algorithm.init(in_xla.search_key)
    held = set(in_xla.algorithm.archive(state).extra_scores) - {"unrepaired", "repaired"}
    runs = {"throughput", "congested", "end_timestep", "waiting", "path_length"}
    assert held == {"similarity", "status", *runs}


def test_only_the_repair_leaves_the_device(in_xla):
    assert callbacks(in_xla) == 1
    assert callbacks(experiment("host")) > 1


@pytest.fixture(scope="module")
def together(in_xla):
    """The elites after some iterations in one program."""
    iterate = qdenv.make_iteration(in_xla)
    run = jax.jit(lambda state: jax.lax.scan(lambda s, i: (iterate(s, i), None), state, NUMBERS)[0])
    return in_xla.algorithm.archive(run(in_xla.algorithm.init(in_xla.search_key))).elites()


@pytest.mark.parametrize("accelerated", [False, True])
def test_one_program_in_xla_finds_what_the_pipelined_loop_on_the_host_finds(
    in_xla, together, accelerated, monkeypatch
):
    """Beside an accelerator fleets are simulated on the host's cores all the same."""
    state = in_xla.algorithm.init(in_xla.search_key)
    if accelerated:
        monkeypatch.setattr(devices, "on_cpu", lambda: False)
    on_host = experiment("auto")
    evaluator = PipelinedEvaluator(on_host.pipeline, Threads(on_host.pipeline))
    ask, tell = jax.jit(on_host.algorithm.ask), jax.jit(on_host.algorithm.tell)
    for number in NUMBERS:
        solutions, state = ask(state)
        key = jax.random.fold_in(on_host.evaluation_key, number)
        evaluation = evaluator.begin(solutions, key)()
        state = tell(state, solutions, evaluation.score, observed(evaluation))
    apart = on_host.algorithm.archive(state).elites()
    assert len(apart["index"]) >= 1
    assert apart.keys() == together.keys()
    for name, values in apart.items():
        np.testing.assert_array_equal(together[name], values, err_msg=name)
