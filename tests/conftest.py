"""What every test runs under: strict numerics, and where layouts lie."""

import gc
import json
import os
import tempfile
import time
import zlib
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from functools import partial
from pathlib import Path
from types import MappingProxyType

import jax
import llvmlite.binding as llvm
import numpy as np
import platformdirs
import pytest

from experiments.benchmarks.pages import find_browser, open_page, start_browser
from qdenv.cli.main import run as qdenv
from qdenv.io.layouts import read_drawing, to_layout
from qdenv.run.directory import RunDirectory

TESTS = Path(__file__).parent
OWN_LAYOUTS = TESTS / "data" / "layouts"
# The layouts published with the paper: not ours to ship, used wherever somebody has a copy.
STUDY_DATA = Path(os.environ.get("QDENV_STUDY_DATA", TESTS.parents[1] / "shared" / "reference"))


SMALL = (
    "--rows 9 --cols 10 --shelves 6 --agents 6 --timesteps 20 --simulations 2 --steps 6 --hidden 4 "
    "--emitters 2 --batch 3 --evaluations 6 --seed 0 --no-progress --archive 0 10 5 0 1 5"
)

WEEK = 7 * 24 * 3600  # seconds
EMITTERS = "xla_cpu_use_fusion_emitters"

# A shape that broadcasts by chance is a mistake: every axis is written out.
jax.config.update("jax_numpy_rank_promotion", "raise")


def pytest_configure(config: pytest.Config) -> None:
    """Keep what XLA compiles: many tests make the same search, and the next test run makes it too.

    The processes of a run share it, those that tests start as well; what is a week old is deleted.
    Most programs run for less time than XLA takes to optimize them, so it does not; it emits loops
    in its older way, and each program in one piece, which halves the time that compiling takes.
    `JAX_DISABLE_MOST_OPTIMIZATIONS=0 XLA_FLAGS=` tests what users run.
    """
    gc.set_threshold(200_000, 20, 100)  # programs live on: to look at them takes a twentieth
    if not hasattr(config, "workerinput"):  # the first process, whose environment others inherit
        os.environ.setdefault("JAX_DISABLE_MOST_OPTIMIZATIONS", "1")
        flags = f"--{EMITTERS}=false --xla_cpu_parallel_codegen_split_count=1"
        os.environ.setdefault("XLA_FLAGS", flags)
        cache = platformdirs.user_cache_path("qdenv-tests")
        for path in cache.rglob("*-cache"):
            if path.stat().st_mtime < time.time() - WEEK:
                path.unlink(missing_ok=True)
        # Machine code for one kind of processor: a home may be shared by several.
        features = llvm.get_host_cpu_features().flatten().encode()
        folder = cache / f"{llvm.get_host_cpu_name()}-{zlib.crc32(features):08x}"
        os.environ["JAX_COMPILATION_CACHE_DIR"] = str(folder)
        os.environ["JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS"] = "0"
    plain = os.environ["JAX_DISABLE_MOST_OPTIMIZATIONS"] == "1"
    jax.config.update("jax_disable_most_optimizations", plain)
    jax.config.update("jax_compilation_cache_dir", os.environ["JAX_COMPILATION_CACHE_DIR"])
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)


def pytest_sessionfinish() -> None:
    """Look once for what nothing holds any more: pytest would look through all five times."""
    gc.collect()
    gc.freeze()


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Mark what is not slow as fast: `pytest -m fast` is the set for daily work."""
    for item in items:
        if item.get_closest_marker("slow") is None:
            item.add_marker("fast")


@pytest.fixture
def optimized() -> Iterator[None]:
    """Let XLA optimize, as it does for users: for a test that runs longer than it compiles."""
    before = jax.config.read("jax_disable_most_optimizations")
    jax.config.update("jax_disable_most_optimizations", False)
    yield
    jax.config.update("jax_disable_most_optimizations", before)


@pytest.fixture(scope="module")
def emitted() -> Iterator[None]:
    """Emit loops as for users: the older way rounds a program otherwise than its parts."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(jax, "jit", partial(jax.jit, compiler_options={EMITTERS: True}))
        yield


def read_layout(path, tiles, meanings=MappingProxyType({})) -> np.ndarray:
    """Read a layout (int8 [H, W]) of an alphabet, with no domain's rules or facts."""
    return to_layout(read_drawing(path).rows, path, tiles, meanings, "this domain")


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Work in an empty folder."""
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.fixture(scope="session")
def published() -> Callable[[str], Path]:
    """Find a layout file published with the paper by its stem; skip the test where it is absent."""

    def find(name: str) -> Path:
        path = STUDY_DATA / "layouts" / f"{name}.json"
        if not path.exists():
            pytest.skip(f"{name}: no published layouts here (QDENV_STUDY_DATA names their folder)")
        return path

    return find


@pytest.fixture(scope="session")
def own_layout() -> Callable[[str], Path]:
    """Find one of our own layout files by its stem (tests/data/layouts)."""
    return lambda name: OWN_LAYOUTS / f"{name}.json"


@pytest.fixture(scope="session")
def small_run(tmp_path_factory) -> RunDirectory:
    """A search of six evaluations on a warehouse of 9 x 10; tests only read it.

    Of an automaton of floats, like the saved runs of the tables.
    """
    path = tmp_path_factory.mktemp("runs") / "warehouse-even"
    small = [*SMALL.split(), "--arithmetic", "float"]
    assert qdenv(["train", "quick", "--run-dir", str(path), *small]) == 0
    return RunDirectory.open(path)


@pytest.fixture(scope="module")
def opened() -> Iterator[Callable[..., AbstractContextManager]]:
    """Open a page from disk, offline: `opened(path, ready)`, in one browser for all of a module.

    Gives a page of Playwright, once `ready` holds; a word on its console or a request fails the
    test. Skips where no browser is.
    """
    if find_browser() is None:
        pytest.skip("no Chromium on this machine (Debian: apt install chromium)")

    @contextmanager
    def open_one(path: Path, ready: str = "true", width: int = 1280) -> Iterator:
        with open_page(browser, path, width) as (page, complaints):
            page.wait_for_function(ready)
            yield page
        assert not complaints, complaints

    with start_browser() as browser:
        yield open_one


def facts_of(*words: str) -> dict:
    """Run a command that must succeed, and return the facts that it writes."""
    with tempfile.TemporaryDirectory() as place:
        facts = Path(place) / "facts.json"
        assert qdenv([*words, "--json", str(facts)]) == 0
        return json.loads(facts.read_text())


def refusal(arguments: list[str], capsys: pytest.CaptureFixture[str]) -> str:
    """Run a command that must fail, and return its one line."""
    capsys.readouterr()
    assert qdenv(arguments) == 2, arguments
    said = capsys.readouterr().err
    assert said.startswith("qdenv: ") and said.count("\n") == 1
    return said
