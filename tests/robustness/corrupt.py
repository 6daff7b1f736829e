"""Corrupt files: random damage to good ones, JSON and .npz with hostile values, hostile pickles.

Everything is drawn from a numpy generator, so that a seed repeats it.
"""

import io
import json
import struct
import zipfile
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

Rng = np.random.Generator
# Values that a JSON file could hold in place of any other.
HOSTILE: tuple[Any, ...] = (
    *(None, True, -1, 0, 1, 2**31, 2**63, -(2**63), 10**30, 0.5, 1e308, float("inf"), float("nan")),
    *("", "a", "\x1b[31m", "two\nlines", "\ud800", "x" * 5000, "../..", "zoo:moon"),
    *([], [[]], [None], {}, {"": {}}, {"name": "moon"}, {"name": []}, [1, 2, 3], ["", "a"]),
)
ARRAYS = (
    np.zeros(0, np.float32),
    np.array(np.nan),
    np.array([-1, 2**62]),
    np.full((3, 4), np.inf),
    np.array(["a", "b"]),
    np.zeros((5, 0, 2), np.int8),
    np.zeros((2, 2), complex),
    np.zeros(3, [("a", "f4")]),
    np.full((40, 7, 7), 99, np.int8),
)
HEADERS = (
    "{'descr': '|O', 'fortran_order': False, 'shape': (1,), }",
    "{'descr': '<f4', 'fortran_order': False, 'shape': (99999999999, 9), }",
    "{'descr': '<f4', 'fortran_order': True, 'shape': (-1,), }",
    "{'descr': '<f4', 'fortran_order': False, 'shape': (1,), 'x': " + "[" * 500 + "}",
    "__import__('os').abort()",
)
INSERTED = (b"\0", b"\xff" * 9, b"\n", b'"', b"[" * 50_000, b"\x1b[2J", b",,", b"PK\5\6")
CONTENTS = (
    *(b"", b"\0" * 500, b"\xff", b"9" * 6000, b"PK\3\4", b"null", b"{}", b"\n" * 3_000_000),
    *(b"[" * 100_000, b'{"a":' * 50_000, b"[" + b"[]," * 400_000 + b"[]]", b"," * 3_000_000),
)


def pick(rng: Rng, values: Any) -> Any:
    """Draw one of some values."""
    return values[int(rng.integers(len(values)))]


def truncate(rng: Rng, content: bytes) -> bytes:
    return content[: int(rng.integers(len(content) + 1))]


def flip(rng: Rng, content: bytes) -> bytes:
    """Change up to eight bytes."""
    changed = np.frombuffer(content, np.uint8).copy()
    places = rng.integers(0, max(changed.size, 1), int(rng.integers(1, 9)))
    if changed.size:
        changed[places] ^= rng.integers(1, 256, len(places)).astype(np.uint8)
    return changed.tobytes()


def blank(rng: Rng, content: bytes) -> bytes:
    """Fill a stretch with zeros, or remove it."""
    start, end = sorted(rng.integers(0, len(content) + 1, 2).tolist())
    return content[:start] + bytes(end - start) * int(rng.integers(2)) + content[end:]


def insert(rng: Rng, content: bytes) -> bytes:
    place = int(rng.integers(len(content) + 1))
    return content[:place] + pick(rng, INSERTED) + content[place:]


def repeat(rng: Rng, content: bytes) -> bytes:
    """Append the content again, from somewhere on."""
    return content + content[int(rng.integers(len(content) + 1)) :]


def replace(rng: Rng, content: bytes) -> bytes:
    """Return something else altogether."""
    noise = rng.integers(0, 256, int(rng.integers(1, 300))).astype(np.uint8).tobytes()
    return pick(rng, (noise, *CONTENTS))


DAMAGES = (truncate, flip, flip, blank, insert, repeat, replace)


def damage(rng: Rng, content: bytes) -> bytes:
    """Damage the content of a file of any kind."""
    return pick(rng, DAMAGES)(rng, content)


def corrupt_json(rng: Rng, content: bytes) -> bytes:
    """Change one value of JSON, or a name, to a hostile one."""
    whole = json.loads(content)
    inner = whole
    while isinstance(inner, dict | list) and len(inner):
        key = pick(rng, list(inner) if isinstance(inner, dict) else range(len(inner)))
        if isinstance(inner[key], dict | list) and inner[key] and rng.random() >= 0.3:
            inner = inner[key]
            continue
        kind = rng.random()
        if kind < 0.15:
            del inner[key]
        elif kind < 0.25 and isinstance(inner, dict):
            inner[pick(rng, ("new", "\x1b[0m", "", "two\nlines"))] = inner.pop(key)
        else:
            inner[key] = pick(rng, HOSTILE)
        break
    return json.dumps(whole).encode()


def corrupt_npz(rng: Rng, content: bytes) -> bytes:
    """Change, drop or replace an array of an .npz, or give one a hostile header."""
    with np.load(io.BytesIO(content)) as file:
        arrays = dict(file)
    name = pick(rng, list(arrays))
    kind, out = rng.random(), io.BytesIO()
    if kind < 0.2:
        del arrays[name]
    elif kind < 0.5:
        arrays[name] = pick(rng, ARRAYS)
    elif kind < 0.8:
        arrays[name] = change_array(rng, arrays[name])
    else:
        return change_header(rng, content, name)
    np.savez(out, **arrays)
    return out.getvalue()


def change_array(rng: Rng, array: np.ndarray) -> np.ndarray:
    """Give an array other axes, another type, or values out of range."""
    changes: tuple[Callable[[], np.ndarray], ...] = (
        lambda: array.reshape(-1),
        lambda: array[None],
        lambda: array[:1] if array.ndim else array,
        lambda: array.astype(np.float64),
        lambda: array.astype(np.int8),
        lambda: array.T,
        lambda: array.astype(np.int64) + 2**40,
        lambda: -array.astype(np.int64) - 1,
        lambda: np.concatenate([array, array]) if array.ndim else array,
    )
    with np.errstate(invalid="ignore"):
        return pick(rng, changes)()


def change_header(rng: Rng, content: bytes, name: str) -> bytes:
    """Give one array of an .npz a hostile header, few bytes or a bomb of zeros."""
    text, out = pick(rng, HEADERS).encode(), io.BytesIO()
    header = b"\x93NUMPY\1\0" + struct.pack("<H", len(text) + 1) + text + b"\n"
    bomb = rng.random() < 0.1
    with zipfile.ZipFile(io.BytesIO(content)) as old, zipfile.ZipFile(out, "w") as new:
        for member in old.namelist():
            info = zipfile.ZipInfo(member)  # without today's date: a seed draws the same bytes
            if member != f"{name}.npy":
                new.writestr(info, old.read(member))
            elif bomb:
                new.writestr(info, header + bytes(2**27), zipfile.ZIP_DEFLATED)
            else:
                new.writestr(info, header + bytes(16))
    return out.getvalue()


def corrupt_zip(rng: Rng, content: bytes) -> bytes:
    """Damage one member of an archive, which stays whole."""
    out = io.BytesIO()
    with zipfile.ZipFile(io.BytesIO(content)) as old, zipfile.ZipFile(out, "w") as new:
        damaged = pick(rng, [name for name in old.namelist() if b"<" in old.read(name)])
        for name in old.namelist():
            data = old.read(name)
            info = zipfile.ZipInfo(name)  # without today's date: a seed draws the same bytes
            new.writestr(info, damage(rng, data) if name == damaged else data)
    return out.getvalue()


def corrupt(rng: Rng, name: str, content: bytes) -> bytes:
    """Corrupt a file in a way that suits the ending of its name."""
    special: Mapping[str, Callable] = {
        ".json": corrupt_json,
        ".npz": corrupt_npz,
        ".xlsx": corrupt_zip,
    }
    ending = name[name.rfind(".") :]
    if ending in special and rng.random() < 0.6:
        return special[ending](rng, content)
    return damage(rng, content)


def pickle_text(value: str) -> bytes:
    raw = value.encode()
    return b"X" + struct.pack("<I", len(raw)) + raw


def pickle_tensor(
    size: tuple, stride: tuple, key: str = "0", count: int = 4, storage: str = "FloatStorage"
) -> bytes:
    """Pickle a tensor as `torch.save` does: rebuild(storage, offset, size, stride, ...)."""
    pid = b"(" + pickle_text("storage") + f"ctorch\n{storage}\n".encode()
    pid += pickle_text(key) + pickle_text("cpu") + b"J" + struct.pack("<i", count) + b"tQ"
    shapes = b"".join(
        b"(" + b"".join(b"J" + struct.pack("<i", one) for one in numbers) + b"t"
        for numbers in (size, stride)
    )
    flags = b"\x89ccollections\nOrderedDict\n)R"
    return b"ctorch._utils\n_rebuild_tensor_v2\n(" + pid + b"K\0" + shapes + flags + b"tR"


INSTRUCTIONS = (
    *(b"(", b")", b"}", b"]", b"N", b"\x88", b"\x89", b"t", b"\x85", b"\x86", b"\x87", b"R", b"b"),
    *(b"s", b"u", b"a", b"e", b"Q", b"q\1", b"h\1", b"0", b"1", b"2", b".", b"\x81", b"l", b"d"),
    *(b"K\1", b"J\0\0\0\x80", b"M\xff\xff", b"\x8a\1\x7f", b"G" + b"\x7f" * 8, b"I99\n"),
    *(b"F1e999\n", b"\x8b\xff\xff\xff\x7f", b"\x8d" + b"\xff" * 8, b"\x95" + b"\xff" * 8),
    *(b"\x93", b"\x94"),
    *(b"ccollections\nOrderedDict\n", b"ctorch\nFloatStorage\n", b"cos\nsystem\n"),
    *(b"ca\x1b[31m\nb\x07\n", b"ctorch._utils\n_rebuild_tensor_v2\n", b"cbuiltins\ngetattr\n"),
    *map(pickle_text, ("storage", "model", "get", "__class__", "\x1b[2J\n")),
    *(pickle_tensor(*shape) for shape in (((4,), (1,)), ((2, 2), (2, 1)), ((2**30,), (0,)))),
    *(pickle_tensor((-1,), (1,)), pickle_tensor((4,), (1,), "1")),
    *(pickle_tensor((4,), (1,), "0", -4), pickle_tensor((9,), (1,)), pickle_tensor((), ())),
    *(b")" + b"\x85" * 5000, b"q\1h\1\x86" * 60, b"(" * 5000, b"]" * 5000),
)
FRAMES = (
    *((b"", b""), (b"}" + pickle_text("a"), b"s."), (b"}" + pickle_text("model"), b"s.")),
    (b"\x80\2}(", b"u."),
)


def hostile_pickle(rng: Rng) -> bytes:
    """Draw instructions of a pickle, which hardly ever make sense."""
    before, after = pick(rng, FRAMES)
    body = b"".join([pick(rng, INSTRUCTIONS) for _ in range(int(rng.integers(1, 25)))])
    return before + body * (1 + 3000 * int(rng.random() < 0.05)) + after


def hostile_checkpoint(rng: Rng) -> bytes:
    """Draw a checkpoint like those of `torch.save`: an archive with a pickle and storages."""
    out = io.BytesIO()
    packing = pick(rng, (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED))
    with zipfile.ZipFile(out, "w") as archive:
        for root in ("m/", "n/")[: 1 + int(rng.random() < 0.05)]:
            # Members without today's date: a seed draws the same bytes.
            archive.writestr(zipfile.ZipInfo(f"{root}data.pkl"), hostile_pickle(rng), packing)
            size = pick(rng, (16, 16, 16, 16, 16, 15, 0, 2**24))
            archive.writestr(zipfile.ZipInfo(f"{root}data/0"), bytes(size), packing)
    return out.getvalue()
