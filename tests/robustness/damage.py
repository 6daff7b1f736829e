"""Bytes that are wrong: good files damaged by chance, JSON with hostile values, hostile archives.

Everything is drawn from a numpy generator; a test's strategy is its seed,
``st.integers(0, 2**32).map(np.random.default_rng)``.
"""

import io
import json
import struct
import zipfile
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

Chance = np.random.Generator
# Values that a file could hold in place of any other.
HOSTILE: tuple[Any, ...] = (
    *(None, True, -1, 0, 1, 2**31, 2**63, -(2**63), 10**30, 0.5, 1e308, float("inf"), float("nan")),
    *("", "a", "\x1b[31m", "two\nlines", "\ud800", "x" * 5000, "../..", "zoo:moon"),
    *([], [[]], [None], {}, {"": {}}, {"name": "moon"}, {"name": []}, [1, 2, 3], ["", "a"]),
)
ARRAYS: tuple[Callable[[], np.ndarray], ...] = (
    lambda: np.zeros(0, np.float32),
    lambda: np.array(np.nan),
    lambda: np.array([-1, 2**62]),
    lambda: np.full((3, 4), np.inf),
    lambda: np.array(["a", "b"]),
    lambda: np.zeros((5, 0, 2), np.int8),
    lambda: np.zeros((2, 2), complex),
    lambda: np.zeros(3, [("a", "f4")]),
    lambda: np.full((40, 7, 7), 99, np.int8),
)
HEADERS = (
    "{'descr': '|O', 'fortran_order': False, 'shape': (1,), }",
    "{'descr': '<f4', 'fortran_order': False, 'shape': (99999999999, 9), }",
    "{'descr': '<f4', 'fortran_order': True, 'shape': (-1,), }",
    "{'descr': '<f4', 'fortran_order': False, 'shape': (1,), 'x': " + "[" * 500 + "}",
    "__import__('os').abort()",
)


STRANGE = (
    *(b"", b"\0" * 500, b"\xff", b"9" * 6000, b"PK\3\4", b"null", b"{}", b"\n" * 3_000_000),
    *(b"[" * 100_000, b'{"a":' * 50_000, b"[" + b"[]," * 400_000 + b"[]]", b"," * 3_000_000),
)


def pick(chance: Chance, values: Any) -> Any:
    """Draw one of some values."""
    return values[int(chance.integers(len(values)))]


def cut(chance: Chance, content: bytes) -> bytes:
    """End somewhere."""
    return content[: int(chance.integers(len(content) + 1))]


def flipped(chance: Chance, content: bytes) -> bytes:
    """Change some bytes."""
    broken = np.frombuffer(content, np.uint8).copy()
    places = chance.integers(0, max(broken.size, 1), int(chance.integers(1, 9)))
    if broken.size:
        broken[places] ^= chance.integers(1, 256, len(places)).astype(np.uint8)
    return broken.tobytes()


def holed(chance: Chance, content: bytes) -> bytes:
    """Fill a stretch with zeros, or take it out."""
    start, end = sorted(chance.integers(0, len(content) + 1, 2).tolist())
    return content[:start] + bytes(end - start) * int(chance.integers(2)) + content[end:]


def stuffed(chance: Chance, content: bytes) -> bytes:
    """Put something in."""
    place = int(chance.integers(len(content) + 1))
    more = pick(
        chance, (b"\0", b"\xff" * 9, b"\n", b'"', b"[" * 50_000, b"\x1b[2J", b",,", b"PK\5\6")
    )
    return content[:place] + more + content[place:]


def repeated(chance: Chance, content: bytes) -> bytes:
    """Say it twice, wholly or from somewhere on."""
    return content + content[int(chance.integers(len(content) + 1)) :]


def strange(chance: Chance, content: bytes) -> bytes:
    """Hold something else altogether."""
    noise = chance.integers(0, 256, int(chance.integers(1, 300))).astype(np.uint8).tobytes()
    return pick(chance, (noise, *STRANGE))


DAMAGES = (cut, flipped, flipped, holed, stuffed, repeated, strange)


def damaged(chance: Chance, content: bytes) -> bytes:
    """Damage the content of a file in one way or another."""
    return pick(chance, DAMAGES)(chance, content)


def twisted(chance: Chance, content: bytes) -> bytes:
    """Change one value of JSON, or a name, to a hostile one."""
    whole = json.loads(content)
    inner = whole
    while isinstance(inner, dict | list) and len(inner):
        key = pick(chance, list(inner) if isinstance(inner, dict) else range(len(inner)))
        if not isinstance(inner[key], dict | list) or not inner[key] or chance.random() < 0.3:
            _change(chance, inner, key)
            break
        inner = inner[key]
    return json.dumps(whole).encode()


def _change(chance: Chance, inner: Any, key: Any) -> None:
    kind = chance.random()
    if kind < 0.15:
        del inner[key]
    elif kind < 0.25 and isinstance(inner, dict):
        inner[pick(chance, ("new", "\x1b[0m", "", "two\nlines"))] = inner.pop(key)
    else:
        inner[key] = pick(chance, HOSTILE)


def rearranged(chance: Chance, content: bytes) -> bytes:
    """Change, drop or add an array of an .npz, or give one a hostile head."""
    with np.load(io.BytesIO(content)) as file:
        arrays = dict(file)
    name = pick(chance, list(arrays))
    kind, out = chance.random(), io.BytesIO()
    if kind < 0.2:
        del arrays[name]
    elif kind < 0.5:
        arrays[name] = pick(chance, ARRAYS)()
    elif kind < 0.8:
        arrays[name] = reshaped(chance, arrays[name])
    else:
        return headed(chance, content, name)
    np.savez(out, **arrays)
    return out.getvalue()


def reshaped(chance: Chance, array: np.ndarray) -> np.ndarray:
    """Give an array other axes, another type, or values out of range."""
    ways: tuple[Callable[[], np.ndarray], ...] = (
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
        return pick(chance, ways)()


def headed(chance: Chance, content: bytes, name: str) -> bytes:
    """Give one member of an .npz a hostile head, another size, or another way of packing."""
    text, out = pick(chance, HEADERS).encode(), io.BytesIO()
    head = b"\x93NUMPY\1\0" + struct.pack("<H", len(text) + 1) + text + b"\n"
    bomb = chance.random() < 0.1
    with zipfile.ZipFile(io.BytesIO(content)) as old, zipfile.ZipFile(out, "w") as new:
        for one in old.namelist():
            member = zipfile.ZipInfo(one)  # without today's date: a seed draws the same bytes
            if one != f"{name}.npy":
                new.writestr(member, old.read(one))
            elif bomb:
                new.writestr(member, head + bytes(2**27), zipfile.ZIP_DEFLATED)
            else:
                new.writestr(member, head + bytes(16))
    return out.getvalue()


def spoilt(chance: Chance, name: str, content: bytes) -> bytes:
    """Damage a file in a way that its kind invites."""
    ways: Mapping[str, Callable[[Chance, bytes], bytes]] = {".json": twisted, ".npz": rearranged}
    ending = name[name.rfind(".") :]
    if ending in ways and chance.random() < 0.6:
        return ways[ending](chance, content)
    return damaged(chance, content)
