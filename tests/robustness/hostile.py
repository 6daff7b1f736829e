"""Checkpoints as `torch.save` writes them, put together by chance from instructions of pickles."""

import io
import struct
import zipfile

import numpy as np

from robustness.damage import Chance, pick


def text(value: str) -> bytes:
    """Pickle a string."""
    raw = value.encode()
    return b"X" + struct.pack("<I", len(raw)) + raw


def tensor(size: tuple[int, ...], stride: tuple[int, ...], key: str = "0", count: int = 4) -> bytes:
    """Pickle a tensor as `torch.save` does: rebuild(storage, offset, size, stride, ...)."""
    pid = b"(" + text("storage") + b"ctorch\nFloatStorage\n" + text(key) + text("cpu")
    pid += b"J" + struct.pack("<i", count) + b"tQ"
    shapes = b"".join(
        b"(" + b"".join(b"J" + struct.pack("<i", one) for one in numbers) + b"t"
        for numbers in (size, stride)
    )
    flags = b"\x89ccollections\nOrderedDict\n)R"
    return b"ctorch._utils\n_rebuild_tensor_v2\n(" + pid + b"K\0" + shapes + flags + b"tR"


INSTRUCTIONS = (
    *(b"(", b")", b"}", b"]", b"N", b"\x88", b"\x89", b"t", b"\x85", b"\x86", b"\x87", b"R", b"b"),
    *(b"s", b"u", b"a", b"e", b"Q", b"q\1", b"h\1", b"0", b"1", b"2", b".", b"\x81", b"l", b"d"),
    *(
        b"K\1",
        b"J\0\0\0\x80",
        b"M\xff\xff",
        b"\x8a\1\x7f",
        b"G" + b"\x7f" * 8,
        b"I99\n",
        b"F1e999\n",
    ),
    *(b"\x8b\xff\xff\xff\x7f", b"\x8d" + b"\xff" * 8, b"\x95" + b"\xff" * 8, b"\x93", b"\x94"),
    *(b"ccollections\nOrderedDict\n", b"ctorch\nFloatStorage\n", b"cos\nsystem\n"),
    *(b"ca\x1b[31m\nb\x07\n", b"ctorch._utils\n_rebuild_tensor_v2\n", b"cbuiltins\ngetattr\n"),
    *(text("storage"), text("model"), text("get"), text("__class__"), text("\x1b[2J\n")),
    *(tensor((4,), (1,)), tensor((2, 2), (2, 1)), tensor((2**30,), (0,)), tensor((-1,), (1,))),
    *(tensor((4,), (1,), "1"), tensor((4,), (1,), "0", -4), tensor((9,), (1,)), tensor((), ())),
    *(b")" + b"\x85" * 5000, b"q\1h\1\x86" * 60, b"(" * 5000, b"]" * 5000),
)
WRAPS = ((b"", b""), (b"}" + text("a"), b"s."), (b"}" + text("model"), b"s."), (b"\x80\2}(", b"u."))


def pickled(chance: Chance) -> bytes:
    """Draw a description of tensors, which hardly ever makes sense."""
    before, after = pick(chance, WRAPS)
    body = [pick(chance, INSTRUCTIONS) for _ in range(int(chance.integers(1, 25)))]
    return before + b"".join(body) * (1 + 3000 * int(chance.random() < 0.05)) + after


def checkpoint(chance: Chance) -> bytes:
    """Draw a whole checkpoint: an archive with a description and storages."""
    out = io.BytesIO()
    packing = pick(chance, (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED))
    with zipfile.ZipFile(out, "w") as archive:
        for root in ("m/", "n/")[: 1 + int(chance.random() < 0.05)]:
            # Members without today's date: a seed draws the same bytes.
            archive.writestr(zipfile.ZipInfo(f"{root}data.pkl"), pickled(chance), packing)
            size = pick(chance, (16, 16, 16, 16, 16, 15, 0, 2**24))
            storage = np.zeros(size, np.uint8).tobytes()
            archive.writestr(zipfile.ZipInfo(f"{root}data/0"), storage, packing)
    return out.getvalue()
