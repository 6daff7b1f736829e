"""The attack of kills finds no fault, and does find one that is planted."""

import errno
from collections import Counter
from pathlib import Path

import numpy as np
import pytest
from robustness import kills
from robustness.dying import DeathError, Trouble
from robustness.kept import differences

from qdenv.io.files import write_atomically
from qdenv.types import InputError


def attempts(folder: Path, numbers: range) -> tuple[Counter, list[str]]:
    """Attack so many times: (what happened, faults)."""
    happened, faults = Counter(), []
    for number in numbers:
        place = folder / str(number)
        place.mkdir()
        attempt = kills.attempt_operations(np.random.default_rng(number), place)
        happened.update(attempt.notes)
        faults += attempt.faults
    return happened, faults


def test_runs_that_die_while_they_write_are_resumed_to_the_same_bytes(tmp_path):
    happened, faults = attempts(tmp_path, range(6, 7))
    assert happened["death"] > 1 and faults == []


def test_what_nobody_sweeps_is_found_out(tmp_path, monkeypatch):
    monkeypatch.setattr("qdenv.run.directory.sweep", lambda folder: None)
    monkeypatch.setattr(kills, "MOST_TROUBLES", 1)
    happened, faults = attempts(tmp_path, range(10, 11))
    assert happened == {"death": 1}
    assert [fault for fault in faults if "was left behind" in fault] == faults != []


def test_after_its_death_a_process_writes_nothing_more(tmp_path):
    path = tmp_path / "file"
    write_atomically(path, b"old")
    count = Trouble(tmp_path)
    with count.looming():
        write_atomically(path, b"same")
    endings = Counter()
    for at in range(1, count.operations + 1):
        for late in (False, True):
            path.write_bytes(b"old")
            trouble = Trouble(tmp_path, "death", at, late)
            with pytest.raises(DeathError), trouble.looming():
                write_atomically(path, b"new")
            assert trouble.happened
            endings[path.read_bytes(), len(list(tmp_path.iterdir())) > 1] += 1
            for left in tmp_path.glob(".*"):
                left.unlink()
    # Old or new, never half of it; what died on its way lies beside it.
    assert {content for content, _ in endings} == {b"old", b"new"}
    assert endings[b"old", True] > 3


def test_a_full_disk_and_a_failure_are_said_in_one_line(tmp_path):
    for kind, code in (("full disk", errno.ENOSPC), ("failure", errno.EIO)):
        trouble = Trouble(tmp_path, kind, at=2)
        with pytest.raises(InputError, match="cannot be written"), trouble.looming():
            write_atomically(tmp_path / "file", b"new")
        assert trouble.happened and code
        assert list(tmp_path.iterdir()) == []


def test_differences_are_told_apart():
    wanted = {"a": b"1", "b": b"2", "c": b"3"}
    assert differences(wanted, wanted) == []
    found = {"a": b"1", "b": b"x", ".d.12345678": b""}
    assert differences(wanted, found) == [
        "c is missing",
        ".d.12345678 was left behind",
        "b differs",
    ]
