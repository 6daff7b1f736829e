"""A search begins where another one ended: at a generator of a run, kept in its own folder."""

import json
import shutil
import subprocess
from dataclasses import replace

import numpy as np
import pytest
import toy

from qdenv.nca import NcaConfig
from qdenv.registry import Entry
from qdenv.run import loop
from qdenv.run.directory import RunDirectory, find_start
from qdenv.search.registry import ALGORITHMS
from qdenv.search.settings import CmaEsConfig, CmaMaeConfig, MapElitesConfig
from qdenv.types import InputError

pytestmark = pytest.mark.slow


class DeafConfig(CmaMaeConfig):
    """Settings of an algorithm whose maker takes no start."""


@pytest.fixture(scope="module")
def first(tmp_path_factory) -> RunDirectory:
    return loop.train(toy.CONFIG, tmp_path_factory.mktemp("start") / "first", progress=False)


def cell_of(run: RunDirectory, row: int) -> str:
    return ",".join(map(str, run.archive.cells[row]))


@pytest.mark.parametrize("kind", [CmaEsConfig, CmaMaeConfig, MapElitesConfig])
def test_the_first_population_lies_around_the_elite_that_is_named(kind, first, tmp_path):
    row = len(first.archive) // 2
    near = {"sigma0": 1e-6} if kind is not MapElitesConfig else {"sigma_iso": 1e-6}
    start = f"{first.path}@{cell_of(first, row)}"
    config = replace(toy.CONFIG, algorithm=kind(**near), start=start, evaluations=8)
    found = loop.train(config, tmp_path / "second", progress=False)
    expected = first.archive.columns["solution"][row]
    np.testing.assert_allclose(
        found.archive.columns["solution"], expected[None].repeat(len(found.archive), 0), atol=1e-4
    )


def test_the_best_is_the_start_where_no_cell_is_named(first):
    config = replace(toy.CONFIG, start=str(first.path))
    np.testing.assert_array_equal(find_start(config), first.best.solution)
    # Neither the steps nor the arithmetic need be those of the start.
    longer = replace(toy.CONFIG.evaluation, generator=NcaConfig(9, (3, 1), 4, "float"))
    np.testing.assert_array_equal(
        find_start(replace(config, evaluation=longer)), first.best.solution
    )
    assert find_start(toy.CONFIG) is None


def test_a_folder_whose_name_has_the_sign_before_a_cell_is_a_start(first, tmp_path):
    shutil.copytree(first.path, tmp_path / "a@b" / "run")
    for end in ("", "@best"):
        config = replace(toy.CONFIG, start=f"{tmp_path / 'a@b' / 'run'}{end}")
        np.testing.assert_array_equal(find_start(config), first.best.solution)


def test_a_start_that_no_setting_names_is_read_again(tmp_path):
    start = np.ones(3, np.float32)
    assert RunDirectory.create(tmp_path, toy.CONFIG, (), start).config.start == ""
    np.testing.assert_array_equal(RunDirectory.open(tmp_path).read_start(), start)
    (tmp_path / "config.json").unlink()  # as if it had been killed before it wrote that
    RunDirectory.create(tmp_path, toy.CONFIG, ())
    assert RunDirectory.open(tmp_path).read_start() is None


def test_the_revision_is_not_that_of_the_repository_that_it_was_installed_into(
    tmp_path, monkeypatch
):
    monkeypatch.setattr("qdenv.run.directory.__file__", str(tmp_path / "directory.py"))
    git = ["git", "-C", str(tmp_path), "-c", "user.name=a", "-c", "user.email=b"]
    for words in (["init", "-q"], ["commit", "-q", "--allow-empty", "-m", "theirs"]):
        subprocess.run([*git, *words], check=True)
    RunDirectory.create(tmp_path / "run", toy.CONFIG, ())
    manifest = json.loads((tmp_path / "run" / "manifest.json").read_text())
    assert manifest["git_revision"] is None


def test_it_resumes_to_the_same_bits_without_the_run_that_it_began_from(first, tmp_path):
    shutil.copytree(first.path, tmp_path / "source")
    config = replace(toy.CONFIG, start=str(tmp_path / "source"), evaluations=32)
    whole = loop.train(config, tmp_path / "whole", progress=False)
    loop.train(replace(config, evaluations=16), tmp_path / "half", progress=False)
    shutil.rmtree(tmp_path / "source")
    resumed = loop.resume(tmp_path / "half", False, 32)
    assert toy.same(resumed.archive.columns, whole.archive.columns)
    (tmp_path / "half" / "start.npz").unlink()
    with pytest.raises(InputError, match=r"start.npz is missing: copy it back"):
        loop.resume(tmp_path / "half", False, 64)


def test_what_cannot_be_a_start_is_refused_before_anything_is_written(first, tmp_path):
    deaf = Entry(DeafConfig, lambda config, problem: None)
    ALGORITHMS.register("deaf", deaf)
    config = replace(toy.CONFIG, start=str(first.path))
    wrong = {
        "nothing here": replace(config, start=f"{tmp_path}/nothing here"),
        "nearest elite": replace(config, start=f"{first.path}@0,0"),
        "its generator differs in": replace(
            config, evaluation=replace(config.evaluation, generator=NcaConfig(5, (3, 3), 4))
        ),
        "this domain has .*#": replace(config, start="zoo:warehouse-even/best"),
        "deaf begins by itself": replace(config, algorithm=DeafConfig()),
    }
    for message, one in wrong.items():
        with pytest.raises(InputError) as raised:
            loop.train(one, tmp_path / "second", progress=False)
        assert message in str(raised.value)
        assert not (tmp_path / "second" / "config.json").exists()
