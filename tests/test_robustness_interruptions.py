"""The attack on runs finds no fault, and finds a planted one."""

from collections import Counter

import numpy as np
import pytest
from robustness import interruptions
from robustness.faulty_disk import DeathError, FaultyDisk

from qdenv import InputError
from qdenv.io.files import write_atomically

pytestmark = pytest.mark.slow


def test_runs_that_die_while_they_write_are_resumed_to_the_same_bytes(tmp_path):
    attempt = interruptions.fail_operations(np.random.default_rng(6), tmp_path)
    assert attempt.notes["death"] > 1 and attempt.faults == []


def test_files_that_nobody_removes_are_found(tmp_path, monkeypatch):
    monkeypatch.setattr("qdenv.io.files.sweep", lambda folder: None)
    monkeypatch.setattr(interruptions, "MOST_TROUBLES", 1)
    attempt = interruptions.fail_operations(np.random.default_rng(10), tmp_path)
    assert attempt.notes == {"death": 1}
    assert attempt.faults and all("was left behind" in fault for fault in attempt.faults)


def test_after_its_death_a_process_writes_nothing_more(tmp_path):
    path = tmp_path / "file"
    write_atomically(path, b"old")
    whole = FaultyDisk(tmp_path)
    with whole.active():
        write_atomically(path, b"same")
    endings = Counter()
    for at in range(1, whole.operations + 1):
        for late in (False, True):
            path.write_bytes(b"old")
            disk = FaultyDisk(tmp_path, "death", at, late)
            with pytest.raises(DeathError), disk.active():
                write_atomically(path, b"new")
            assert disk.happened
            endings[path.read_bytes(), len(list(tmp_path.iterdir())) > 1] += 1
            for left in tmp_path.glob(".*"):
                left.unlink()
    # Old or new, never half of it; a temporary file may be left beside it.
    assert {content for content, _ in endings} == {b"old", b"new"}
    assert endings[b"old", True] > 3


@pytest.mark.parametrize("kind", ["full disk", "failure"])
def test_a_full_disk_and_a_failure_are_reported_in_one_line(kind, tmp_path):
    disk = FaultyDisk(tmp_path, kind, at=2)
    with pytest.raises(InputError, match="cannot be written"), disk.active():
        write_atomically(tmp_path / "file", b"new")
    assert disk.happened and list(tmp_path.iterdir()) == []


def test_missing_new_and_changed_files_are_listed():
    expected = {"a": b"1", "b": b"2", "c": b"3"}
    assert interruptions.differences(expected, expected) == []
    actual = {"a": b"1", "b": b"x", ".d.12345678": b""}
    faults = ["c is missing", ".d.12345678 was left behind", "b differs"]
    assert interruptions.differences(expected, actual) == faults
