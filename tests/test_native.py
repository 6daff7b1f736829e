"""Compiled host code: kept between processes, and never stale."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from qdenv import native

pytestmark = pytest.mark.slow

OUTER = """
from qdenv.inner import plus
from qdenv.native import compiled

@compiled
def answer(x):
    return plus(x)

print(answer(40), sum(answer.stats.cache_hits.values()))
"""
INNER = """
from qdenv.native import shared

@shared
def plus(x):
    return x + {}
"""

KERNELS = """
import numpy as np
from qdenv.native import kernel

@kernel
def plus(x):
    return x + 2

@kernel
def answer(numbers):
    return plus(numbers[0]) + plus(numbers.size) - plus(1)

print(answer(np.array([40], np.int32)), plus(40), len(getattr(plus, "signatures", ())))
"""


@pytest.fixture
def package(tmp_path: Path) -> Path:
    """Make a package of three files around a copy of `qdenv.native`."""
    folder = tmp_path / "qdenv"
    folder.mkdir()
    (folder / "__init__.py").touch()
    shutil.copy(native.__file__, folder)
    (folder / "outer.py").write_text(OUTER)
    (folder / "inner.py").write_text(INNER.format(2))
    return folder


def run(
    package: Path, cache: Path, program: str = "import qdenv.outer", **variables: str
) -> list[int]:
    """Import `outer` in a fresh process; returns the answer and how often the cache served."""
    environment = dict(os.environ, PYTHONPATH=str(package.parent), XDG_CACHE_HOME=str(cache))
    environment.pop("NUMBA_CACHE_DIR", None)
    done = subprocess.run(
        [sys.executable, "-c", program],
        env=environment | variables,
        stdout=subprocess.PIPE,
        text=True,
        check=True,
        cwd=package.parent,
    )
    return [int(word) for word in done.stdout.split()]


def test_an_edit_in_another_file_is_seen_by_the_next_process(package: Path, tmp_path: Path):
    cache = tmp_path / "cache"
    assert run(package, cache) == [42, 0]
    assert run(package, cache) == [42, 1]
    (package / "inner.py").write_text(INNER.format(3))
    assert run(package, cache) == [43, 0]
    (package / "inner.py").write_text(INNER.format(2))
    assert run(package, cache) == [42, 1]
    elsewhere = shutil.copytree(
        package, tmp_path / "elsewhere" / "qdenv", copy_function=shutil.copy
    )
    (elsewhere / "stranger.py").write_text("not imported = by any of them")
    assert run(elsewhere, cache) == [42, 1]
    assert len(list((cache / "qdenv").iterdir())) == 2


def test_the_users_own_cache_folder_is_respected(package: Path, tmp_path: Path):
    own = tmp_path / "own"
    assert run(package, tmp_path / "cache", NUMBA_CACHE_DIR=str(own)) == [42, 0]
    assert run(package, tmp_path / "cache", NUMBA_CACHE_DIR=str(own)) == [42, 1]
    assert not (tmp_path / "cache").exists()


def test_without_a_place_to_write_it_works_without_a_cache(package: Path, tmp_path: Path):
    blocked = tmp_path / "file"
    blocked.touch()  # a folder in it can be made by nobody, not even by root
    assert run(package, blocked) == [42, 0]
    assert run(package, blocked) == [42, 0]


@pytest.mark.parametrize("ending", ["nbi", "nbc"])
def test_a_damaged_cache_is_compiled_anew_once(ending: str, package: Path, tmp_path: Path):
    cache = tmp_path / "cache"
    assert run(package, cache) == [42, 0]
    (damaged,) = cache.rglob(f"*.{ending}")
    damaged.write_bytes(damaged.read_bytes()[:20])
    assert run(package, cache) == [42, 0]
    assert run(package, cache) == [42, 1]


# No disk is full here: writing fails as it does on one.
FULL = """
import numba.core.caching as caching
def full(self, *_):
    raise OSError(28, "No space left on device")
caching.IndexDataCacheFile._save_index = full
import qdenv.outer
"""


def test_a_full_cache_is_named_and_costs_time_alone(package, tmp_path, capfd):
    cache = tmp_path / "cache"
    assert run(package, cache, program=FULL) == [42, 0]
    assert "cannot be kept here (No space left on device)" in capfd.readouterr().err


def test_a_kernel_is_compiled_once_for_all_integers_and_called_by_python_too(package, tmp_path):
    (package / "outer.py").write_text(KERNELS)
    # Compiled, found on disk, not compiled.
    for variables, programs in (({}, 1), ({}, 0), ({"NUMBA_DISABLE_JIT": "1"}, 0)):
        assert run(package, tmp_path / "cache", **variables) == [42, 42, programs]


def test_only_the_last_used_folders_are_kept(tmp_path: Path):
    theirs = tmp_path / "runs of somebody who calls a folder of caches his own"
    for age in range(native.MAX_FOLDERS + 3):
        folder = tmp_path / f"{age:016}" if age <= native.MAX_FOLDERS else theirs
        folder.mkdir(exist_ok=True)
        os.utime(folder, (10**9 - age, 10**9 - age))
    native._forget_old(tmp_path)
    kept = {folder.name for folder in tmp_path.iterdir()}
    assert kept == {theirs.name, *(f"{age:016}" for age in range(native.MAX_FOLDERS))}
