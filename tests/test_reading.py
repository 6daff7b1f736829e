"""The reader of files: good ones bit for bit, damaged and hostile ones in one line, at no cost."""

import json
import struct
import time
import tracemalloc
import zipfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np
import pytest

from qdenv.io.arrays import Column, read_arrays, read_state, write_arrays, write_state
from qdenv.io.files import read_text
from qdenv.io.records import parse_json, read_json, read_table, structured
from qdenv.simulation.maze.policy import SHIPPED_AGENT, load_weights
from qdenv.types import DamagedError, InputError

ARRAYS = {
    "fractions": np.array([[0.1, -0.0], [np.inf, np.nan]], np.float32),
    "bits": np.array([True, False, True]),
    "words": np.array(["shelf", "way"]),
    "number": np.float64(3.5),
    "none": np.zeros((0, 7)),
    "columns first": np.asfortranarray(np.arange(24).reshape(2, 3, 4)),
    "big end first": np.arange(5, dtype=">i4"),
}


@pytest.mark.parametrize("save", [np.savez, np.savez_compressed, write_arrays])
def test_arrays_are_read_bit_for_bit(save, tmp_path):
    path = tmp_path / "a.npz"
    save(path, **ARRAYS) if save is not write_arrays else save(path, ARRAYS, True)
    found = read_arrays(path)
    assert list(found) == list(ARRAYS)
    for name, array in ARRAYS.items():
        assert found[name].shape == array.shape and found[name].dtype.isnative
        np.testing.assert_array_equal(found[name], array, strict=name != "big end first")


def npz(path: Path, member: bytes, kind: int = zipfile.ZIP_STORED) -> Path:
    with zipfile.ZipFile(path, "w", kind) as archive:
        archive.writestr("a.npy", member)
    return path


def npy(header: str, content: bytes, version: int = 1) -> bytes:
    length = struct.pack("<H" if version == 1 else "<L", len(header))
    return b"\x93NUMPY" + bytes([version, 0]) + length + header.encode() + content


def head(descr: str, shape: str) -> str:
    return f"{{'descr': {descr}, 'fortran_order': False, 'shape': {shape}, }}\n"


MEMBERS = {
    "objects": npy(head("'|O'", "(1,)"), b"\x80\x04N."),
    "records": npy(head("[('a', '<f4')]", "(1,)"), bytes(4)),
    "a size of none": npy(head("'<f3'", "(1,)"), bytes(3)),
    "more than there is": npy(head("'<f8'", "(99999999999,)"), bytes(8)),
    "overflow": npy(head("'<f8'", "(9223372036854775807, 2)"), bytes(8)),
    "less than there is": npy(head("'<f8'", "(1,)"), bytes(16)),
    "negative": npy(head("'<f8'", "(-1,)"), b""),
    "code": npy(head("'<f8'", "(__import__('os').abort(),)"), bytes(8)),
    "deep": npy(head("'<f8'", "(" * 60_000), bytes(8), 2),
    "long": npy(head("'<f8'", "(1,)") + " " * 10**6, bytes(8), 2),
    "no header": b"\x93NUMPY\1\0",
    "another version": npy(head("'<f8'", "(1,)"), bytes(8), 9),
    "nothing": b"",
}


@pytest.mark.parametrize("name", MEMBERS)
def test_members_that_are_no_plain_arrays_are_refused(name, tmp_path):
    with pytest.raises(DamagedError) as refusal:
        read_arrays(npz(tmp_path / "a.npz", MEMBERS[name]))
    assert str(refusal.value).isprintable() and str(tmp_path / "a.npz") in str(refusal.value)


def damaged_archives(good: bytes) -> dict[str, bytes]:
    twice = good[:-22].replace(b"b.npy", b"a.npy") + good[-22:]
    return {
        "empty": b"",
        "no archive": b"PK\3\4",
        "zeros": bytes(1000),
        "cut": good[: len(good) // 2],
        "one byte": good[:150] + bytes([good[150] ^ 255]) + good[151:],
        "two of one name": twice,
        "a directory of gigabytes": good[:-10] + struct.pack("<L", 2**31) + good[-6:],
        "another directory": good[:-6] + struct.pack("<L", 7) + good[-2:],
        "comment": good[:-2] + b"\4\0PK\5\6",
        "encrypted": good.replace(b"PK\1\2\x14\3\x14\0\0\0", b"PK\1\2\x14\3\x14\0\1\0"),
        "packed in a way of tomorrow": good.replace(
            b"PK\1\2\x14\3\x14\0\0\0\0\0", b"PK\1\2\x14\3\x14\0\0\0\x63\0"
        ),
    }


@pytest.mark.parametrize("name", damaged_archives(b"-" * 400))
def test_damaged_archives_are_refused(name, tmp_path):
    path = tmp_path / "a.npz"
    with zipfile.ZipFile(path, "w") as archive:
        for member in ("a.npy", "b.npy"):
            archive.writestr(member, npy(head("'|u1'", "(100,)"), bytes(100)))
    assert read_arrays(path).keys() == {"a", "b"}
    bad = damaged_archives(path.read_bytes())[name]
    assert bad != path.read_bytes()
    path.write_bytes(bad)
    with pytest.raises(DamagedError, match="cannot be read"):
        read_arrays(path)


def test_bombs_are_refused_before_they_expand(tmp_path):
    bomb = npy(head("'|u1'", f"({100 * 2**20},)"), bytes(100 * 2**20))
    path = npz(tmp_path / "bomb.npz", bomb, kind=zipfile.ZIP_DEFLATED)
    del bomb
    assert path.stat().st_size < 2**20
    tracemalloc.start()
    with pytest.raises(DamagedError, match="would take 100 MB"):
        read_arrays(path)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 2**20


def test_columns_are_checked_by_name_kind_axes_and_finiteness(tmp_path):
    np.savez(tmp_path / "a.npz", x=np.array([1.0, np.nan]))
    assert read_arrays(tmp_path / "a.npz", {"x": Column("f", 1)}).keys() == {"x"}
    for wanted, said in (
        ({"y": Column()}, "y is missing"),
        ({"x": Column("iu")}, "x holds float64"),
        ({"x": Column("f", 2)}, "x has 1 axes, not 2"),
        ({"x": Column("f", 1, finite=True)}, "x holds numbers that are not finite"),
    ):
        with pytest.raises(DamagedError, match=said):
            read_arrays(tmp_path / "a.npz", wanted)


@dataclass(frozen=True)
class Wall:
    """A record that refuses other fields."""

    rows: int
    share: float = 0.5
    kind: Literal["brick", "hedge"] = "brick"
    limit: int | None = None
    cells: tuple[tuple[int, int], ...] = ()


class Garden(NamedTuple):
    """A record that passes other fields over."""

    walls: list[Wall]
    names: dict[str, str] = {}  # noqa: RUF012


GOOD = {"walls": [{"rows": 3, "share": 1, "cells": [[1, 2]]}], "names": {"a": "b"}, "more": 1}


def test_a_good_record_has_the_types_it_says():
    found = structured(GOOD, Garden, "g.json")
    assert found == Garden([Wall(3, 1.0, cells=((1, 2),))], {"a": "b"})
    assert type(found.walls[0].share) is float


def with_wall(**changes: Any) -> str:
    return json.dumps(GOOD | {"walls": [{"rows": 1}, {"rows": 3} | changes]})


TEXTS = {
    "": "not a JSON file",
    "[1]": "must be an object, not [1]",
    "{}": "walls: is missing",
    '{"walls": "abc"}': 'walls: must be a list, not "abc"',
    '{"walls": {"rows": 3}}': "walls: must be a list",
    '{"walls": [3]}': "walls[0]: must be an object, not 3",
    '{"walls": [], "names": ["a"]}': "names: must be an object",
    '{"walls": [], "names": {"a": 1}}': "names['a']: must be a word, not 1",
    '{"walls": [], "walls": []}': "'walls' is there twice",
    '{"walls": [], "x": NaN}': "NaN is not allowed",
    '{"walls": [' + "9" * 5000 + "]}": "a number of 5000 digits",
    "[" * 100_000: "too deep",
    "[" + "0," * 1_000_001 + "0]": "more than 1,000,000 values",
    '{"walls": [], "\\ud800": 1, "\\u001b[2J\\n": ': "not a JSON file",
    with_wall(rows="3"): "walls[1].rows: must be a whole number",
    with_wall(rows=True): "walls[1].rows: must be a whole number, not true",
    with_wall(rows=3.0): "walls[1].rows: must be a whole number, not 3.0",
    with_wall(rows=2**70): "fits into 64 bits",
    with_wall(share="1"): 'walls[1].share: must be a finite number, not "1"',
    with_wall(share=1).replace("1}]", "1e999}]"): "walls[1].share: must be a finite number",
    with_wall(kind=3): "walls[1].kind: must be a word, not 3",
    with_wall(limit="x"): "walls[1].limit: must be a whole number or null",
    with_wall(cells=[[1]]): "walls[1].cells[0]: must be 2 values, not 1",
    with_wall(cells=["ab"]): "walls[1].cells[0]: must be a list",
    with_wall(towers=1): "walls[1]: has no setting 'towers'",
    with_wall(**{"\x1b[31m\n": 1}): "has no setting",
}


@pytest.mark.parametrize("text", TEXTS, ids=lambda text: TEXTS[text])
def test_records_are_read_strictly_and_the_line_names_the_field(text, tmp_path):
    (tmp_path / "g.json").write_text(text)
    with pytest.raises(DamagedError) as refusal:
        read_json(tmp_path / "g.json", Garden)
    line = str(refusal.value)
    assert TEXTS[text] in line and "g.json: cannot be read" in line
    assert line.isprintable() and len(line) < 2100


class Row(NamedTuple):
    """A row of a table."""

    step: int
    best: float
    whole: bool = True


def test_tables_are_read_strictly_and_rows_before_the_damage_come_first(tmp_path):
    path = tmp_path / "t.csv"
    path.write_text("step,best\n1,2.5\n2,-3\n")
    assert list(read_table(path, Row)) == [Row(1, 2.5), Row(2, -3.0)]
    for text, said in {
        "": "no table",
        "step,step\n": "names of their own",
        "step\n1\n": "best is missing",
        "step,best,x\n1,2,3\n": "x is missing or unknown",
        "step,best\n1,2,3\n": "row 1 has 3 cells",
        "step,best\n1,2\n3\n": "row 2 has 1 cells",
        "step,best\n1.5,2\n": "row 1, step: '1.5' is not a whole number",
        "step,best\n1,nan\n": "nan is not a finite number",
        "step,best\n1,-inf\n": "-inf is not a finite number",
        f"step,best\n{'9' * 30},1\n": "too large",
        f"step,best\n{'9' * 5000},1\n": "is not a whole number",
        "step,best,whole\n1,2,Maybe\n": "'Maybe' is not True or False",
        'step,best\n1,"2': "not a CSV file",
        f"step,best\n1,{'x' * 200_000}\n": "not a CSV file",
    }.items():
        path.write_text(text)
        with pytest.raises(DamagedError, match=said):
            list(read_table(path, Row))
    path.write_text("step,best\n1,2\n3,x\n")
    rows = read_table(path, Row)
    assert next(rows) == Row(1, 2.0)
    with pytest.raises(DamagedError, match="row 2, best"):
        next(rows)


def test_nothing_larger_than_allowed_is_read_not_even_from_a_device():
    with pytest.raises(DamagedError, match="bigger than 1 MB"):
        read_text("/dev/zero", 2**20)
    for name in ("a\0b", "x" * 5000):
        with pytest.raises(InputError):
            read_text(name)


def test_hostile_json_takes_linear_time_and_little_memory():
    many = ", ".join(f'"k{n}": 0' for n in range(40_000))
    escaped = f'["{chr(92) * 400_000}"]'
    tracemalloc.start()
    before = time.process_time()
    with pytest.raises(DamagedError, match="'z' is there twice"):
        parse_json(f'{{{many}, "z": 0, "z": 0}}', "file")
    parse_json(escaped, "file")
    assert time.process_time() - before < 4  # in quadratic time it takes ten
    assert tracemalloc.get_traced_memory()[1] < 2**26
    tracemalloc.stop()


class Facts(NamedTuple):
    """Facts of a state."""

    done: int = 0


@pytest.mark.parametrize(
    "facts", ["", "[]", "{}", '{"schema": "2"}', '{"schema": 2, "done": 1.5}', "[" * 9999]
)
def test_facts_of_a_state_are_read_strictly(facts, tmp_path):
    path = tmp_path / "s.npz"
    write_state(path, {"0": np.arange(3)}, {"done": 4}, "facts")
    assert read_state(path, "facts", Facts)[1] == Facts(4)
    write_arrays(path, {"facts": np.frombuffer(facts.encode(), np.uint8)})
    with pytest.raises(DamagedError):
        read_state(path, "facts", Facts)


def test_every_flipped_byte_of_an_agent_is_refused_or_changes_nothing(tmp_path):
    whole, rng = SHIPPED_AGENT.read_bytes(), np.random.default_rng(5)
    good = load_weights()
    for _ in range(200):
        broken = bytearray(whole)
        broken[rng.integers(len(whole))] ^= rng.integers(1, 256)
        (tmp_path / "bad.npz").write_bytes(broken)
        try:
            found = load_weights(tmp_path / "bad.npz")
        except InputError as error:
            assert str(error).isprintable()
        else:
            assert all((one == other).all() for one, other in zip(found, good, strict=True))


def test_messages_are_printable_lines_of_a_sensible_length():
    assert str(InputError("plain: Größe")) == "plain: Größe"
    assert str(InputError("a\n\tb\r\nc\x1b[31m\x00\u202e")) == "a b c\\x1b[31m\\x00\\u202e"
    assert len(str(InputError("x" * 10**6))) < 2100
