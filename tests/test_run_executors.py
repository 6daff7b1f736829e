"""A cluster finds what threads find, whatever happens to its workers."""

import contextlib
import dataclasses
import os
import signal
import threading

import pytest
from conftest import SMALL

from experiments.__main__ import share_certificate
from experiments.ledger import Case, complete, read_runs
from qdenv import interrupt
from qdenv.cli.main import run as qdenv
from qdenv.domains.base import find_domain
from qdenv.repairs import pool as pools
from qdenv.run import evaluate, executors, loop
from qdenv.run.directory import RunDirectory
from qdenv.run.executors import ClusterExecutor, Execution, WrongWorkerError, versions
from qdenv.run.experiment import make_experiment
from qdenv.types import InputError, RepairStatus

dask, distributed = pytest.importorskip("dask"), pytest.importorskip("distributed")
# Dask's own clean-up of sockets and threads at the end of a cluster is not ours to judge.
pytestmark = [pytest.mark.slow, pytest.mark.filterwarnings("default")]

EVALUATIONS = 24


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """The run as threads make it."""
    path = tmp_path_factory.mktemp("threads") / "run"
    options = SMALL.replace("--evaluations 6", f"--evaluations {EVALUATIONS}").split()
    assert qdenv(["train", "quick", "--out", str(path), *options]) == 0
    return RunDirectory.open(path)


@pytest.fixture(scope="module")
def local():
    """A cluster of two worker processes."""
    with (
        dask.config.set(executors.SETTINGS),
        distributed.LocalCluster(
            n_workers=2, threads_per_worker=1, memory_limit=0, dashboard_address=None
        ) as cluster,
    ):
        yield cluster


def wait_for_both(client, local) -> None:
    """Wait for both workers, of which a test may have retired one."""
    try:
        client.wait_for_workers(2, timeout=6)
    except TimeoutError:
        local.scale(0)
        local.scale(2)
        client.wait_for_workers(2, timeout=60)


def assert_alike(run: RunDirectory, whole: RunDirectory) -> None:
    assert (run.path / "archive.npz").read_bytes() == (whole.path / "archive.npz").read_bytes()
    timeless = [[row._replace(seconds=0.0) for row in one.read_metrics()] for one in (run, whole)]
    assert timeless[0] == timeless[1] and len(timeless[0]) == EVALUATIONS // 6


def trained(whole, path, local):
    execution = Execution("dask", scheduler=local.scheduler_address)
    return loop.train(whole.config, path, progress=False, execution=execution)


def test_a_cluster_finds_bit_for_bit_what_threads_find(whole, local, tmp_path):
    assert_alike(trained(whole, tmp_path / "run", local), whole)


def test_short_layouts_share_tasks_and_nothing_else_changes(whole, local, tmp_path, monkeypatch):
    monkeypatch.setattr(evaluate, "_LONGEST", 1000.0)
    sizes, submit = [], ClusterExecutor.submit

    def record(self, work, *arguments):
        sizes.append(len(arguments[1]))
        return submit(self, work, *arguments)

    monkeypatch.setattr(ClusterExecutor, "submit", record)
    assert_alike(trained(whole, tmp_path / "run", local), whole)
    # Of the first population nobody knows yet how long a layout takes.
    assert sizes == [1] * 6 + [3, 2, 1] * (EVALUATIONS // 6 - 1)


@contextlib.contextmanager
def beside(function):
    """Call a function with a short pause between, in another thread, until the block ends."""
    over = threading.Event()

    def repeat():
        while not over.wait(0.02):
            function()

    thread = threading.Thread(target=repeat)
    thread.start()
    try:
        yield
    finally:
        over.set()
        thread.join()


def test_workers_that_are_killed_cost_time_and_no_results(whole, local, tmp_path):
    killed = []
    with distributed.Client(local.scheduler_address) as client:
        wait_for_both(client, local)

        def kill_who_works():
            busy = [worker for worker, tasks in client.processing().items() if tasks]
            if busy and len(killed) < 2:
                for pid in client.run(os.getpid, workers=busy[:1], on_error="ignore").values():
                    os.kill(pid, signal.SIGKILL)
                    killed.append(pid)

        with beside(kill_who_works):
            run = trained(whole, tmp_path / "run", local)
    assert killed
    assert_alike(run, whole)


def test_the_layouts_of_a_worker_that_hangs_go_to_another(whole, local, tmp_path, monkeypatch):
    now = [0.0]  # of a clock that moves only when nobody but the worker that hangs has work
    monkeypatch.setattr(executors, "monotonic", lambda: now[0])
    monkeypatch.setattr(executors, "_TICK", 0.02)
    with distributed.Client(local.scheduler_address) as client:
        wait_for_both(client, local)
        stopped, pid = next(iter(client.run(os.getpid).items()))
        moved = []

        def lose_patience():
            processing = client.processing()
            if [worker for worker, tasks in processing.items() if tasks] == [stopped]:
                now[0] += 1000 * executors.PATIENCE
                moved.append(1)

        os.kill(pid, signal.SIGSTOP)
        try:
            with beside(lose_patience):
                run = trained(whole, tmp_path / "run", local)
        finally:
            os.kill(pid, signal.SIGKILL)  # its nanny starts a new one
    assert moved
    assert_alike(run, whole)


def test_runs_of_a_study_are_the_same_on_a_cluster(local, tmp_path):
    domain = find_domain("warehouse-even").resized(9, 12)
    plan = domain.human()
    cases = [Case("hall", plan, domain, agents, 40, "low") for agents in (3, 6)]
    here = complete(tmp_path / "here.csv", cases, range(3))
    with distributed.Client(local.scheduler_address) as client:
        there = complete(tmp_path / "there.csv", cases, range(3), client=client)
    assert len({run.throughput for run in here}) > 2
    assert [run._replace(cpu_seconds=0) for run in here] == [
        run._replace(cpu_seconds=0) for run in there
    ]
    assert [run.key for run in read_runs(tmp_path / "there.csv")] == [run.key for run in here]


def test_an_error_that_comes_each_time_is_raised_and_once_is_not(local, tmp_path):
    def fail_once(mark):
        if not mark.exists():
            mark.touch()
            raise ValueError("bad luck")
        return "done"

    def fail_always():
        raise ValueError("for good")

    with distributed.Client(local.scheduler_address) as client:
        with ClusterExecutor(client) as executor:
            assert executor.submit(fail_once, tmp_path / "mark").result() == "done"
            with pytest.raises(ValueError, match="for good"):
                executor.submit(fail_always).result()
            assert list(executor.map(pow, [2, 3], [5, 2])) == [32, 9]
        with pytest.raises(RuntimeError, match="has ended"):
            executor.submit(fail_always)


def test_without_its_scheduler_an_executor_fails_instead_of_waiting_for_ever(local):
    client = distributed.Client(local.scheduler_address)
    executor = ClusterExecutor(client)
    client.close()
    interrupt.advise("run")
    with pytest.raises(InputError, match="scheduler is gone; `qdenv resume run` goes on"):
        executor.submit(pow, 2, 5).result(timeout=60)


def test_a_worker_that_dies_is_started_again_however_long_that_takes():
    given_up_at_once = {"distributed.deploy.lost-worker-timeout": "1ms"}
    with dask.config.set(given_up_at_once), Execution("dask", workers=1).connect() as client:
        (pid,) = client.run(os.getpid).values()
        os.kill(pid, signal.SIGKILL)
        assert client.submit(os.getpid, pure=False, retries=9).result(timeout=60) != pid


def test_a_cluster_of_ones_own_obeys_nobody_else():
    pytest.importorskip("cryptography")
    with Execution("dask", workers=1).connect() as client:
        assert client.run(os.getuid) and client.submit(pow, 2, 5).result() == 32
        address = client.scheduler.address
        assert address.startswith("tls://127.0.0.1:")
        own = Execution("dask", scheduler=address)
        with share_certificate(client), own.connect() as another:
            assert another.submit(pow, 2, 5).result() == 32
        with pytest.raises(OSError):
            distributed.Client(address, timeout=1, security=distributed.Security.temporary())


def make_foreign() -> None:
    """Pretend, on a worker, that other packages are installed there."""
    executors.versions = lambda: "python 2.7"


def test_a_worker_of_other_versions_is_sent_away(whole, local, tmp_path):
    with distributed.Client(local.scheduler_address) as client:
        wait_for_both(client, local)
        client.run(make_foreign, workers=list(client.scheduler_info()["workers"])[:1])
        assert_alike(trained(whole, tmp_path / "run", local), whole)
        assert len(client.scheduler_info()["workers"]) == 1


def test_where_every_worker_has_other_versions_the_search_is_refused(whole, local, tmp_path):
    with distributed.Client(local.scheduler_address) as client:
        client.run(make_foreign)
        with pytest.raises(InputError, match="every worker has other versions than the search"):
            trained(whole, tmp_path / "run", local)


def test_a_worker_of_another_version_computes_nothing():
    with pytest.raises(WrongWorkerError, match=versions()):
        executors.perform("another", pow, (2, 5))


def test_an_address_where_nobody_answers_is_refused(whole, tmp_path, monkeypatch):
    monkeypatch.setattr(executors, "_ANSWER", 1)
    execution = Execution("dask", scheduler="tcp://127.0.0.1:9")
    with pytest.raises(InputError, match="start `dask scheduler`"):
        loop.train(whole.config, tmp_path / "run", False, execution)


def test_a_repair_that_ran_out_of_memory_is_tried_again(whole, monkeypatch):
    domain = make_experiment(whole.config).pipeline.domain
    layout, tries, original = whole.best.layout, [], pools.repair_layout

    def short_of_memory(*given):
        tries.append(1)
        if len(tries) == 1:
            raise MemoryError
        return original(*given)

    monkeypatch.setattr(pools, "repair_layout", short_of_memory)
    with pools.RepairPool(domain.rules(), whole.config.evaluation.repair) as pool:
        assert pool.submit(layout).result().status == RepairStatus.OPTIMAL
    assert len(tries) == 2
    monkeypatch.setattr(pools, "repair_layout", lambda *given: (_ for _ in ()).throw(MemoryError))
    settings = dataclasses.replace(whole.config.evaluation.repair, workers=1)
    with pools.RepairPool(domain.rules(), settings) as pool:
        assert pool.submit(layout).result().status == RepairStatus.FAILED
