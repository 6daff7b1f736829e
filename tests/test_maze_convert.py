"""The checkpoint converter: a home-made torch.save zip, and files that mean harm."""

import io
import pickle
import time
import tracemalloc
import zipfile
from pathlib import Path

import jax
import numpy as np
import pytest
from maze_oracle import recorded_network
from robustness.corrupt import pickle_tensor, pickle_text

from qdenv.agent.convert import from_torch, read_checkpoint
from qdenv.ops.networks import convert_agent
from qdenv.simulation.maze.policy import Weights, load_weights
from qdenv.types import InputError


def steps(array: np.ndarray) -> tuple[int, ...]:
    """List strides in elements."""
    return tuple(stride // array.itemsize for stride in array.strides)


def write(path: Path, pickled: bytes, storages: dict[str, bytes]) -> Path:
    """Zip a description and its storages."""
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("model/data.pkl", pickled)
        archive.writestr("model/version", "3\n")
        for key, raw in storages.items():
            archive.writestr(f"model/data/{key}", raw)
    return path


def checkpoint(path: Path, tensors: dict[str, np.ndarray], wrapper: str = "") -> Path:
    """Write tensors as torch.save would."""
    body = b"ccollections\nOrderedDict\n)R("
    for key, (name, array) in enumerate(tensors.items()):
        body += pickle_text(name) + pickle_tensor(array.shape, steps(array), str(key), array.size)
    body += b"u"
    if wrapper:
        body = b"}" + pickle_text(wrapper) + body + b"s"
    raws = {str(key): array.tobytes() for key, array in enumerate(tensors.values())}
    return write(path, b"\x80\x02" + body + b".", raws)


@pytest.fixture(scope="module")
def tensors():
    return recorded_network()


@pytest.mark.parametrize("wrapper", ["", "model", "state_dict"])
def test_a_checkpoint_is_converted_bit_for_bit(tmp_path, tensors, wrapper):
    path = checkpoint(tmp_path / "model.tar", tensors, wrapper)
    found = read_checkpoint(path)
    assert found.keys() == tensors.keys()
    for name in tensors:
        np.testing.assert_array_equal(found[name], tensors[name])
    convert_agent(path, tmp_path / "agent.npz")
    jax.tree.map(
        np.testing.assert_array_equal, load_weights(tmp_path / "agent.npz"), from_torch(tensors)
    )


def test_hostile_pickles_are_refused_and_run_nothing(tmp_path):
    trap = tmp_path / "trap"
    harmful = [
        f'cbuiltins\nexec\n(S\'open("{trap}", "w").close()\'\ntR.'.encode(),
        f"}}S'model'\ncbuiltins\neval\n(S'open(\"{trap}\", \"w\").close()'\ntRs.".encode(),
        pickle.dumps(trap),
        pickle.dumps({"model": np.ones(3)}),
        f"cos\nsystem\n(S'touch {trap}'\ntR.".encode(),
        b"cbuiltins\ngetattr\n(ctorch._utils\n_rebuild_tensor_v2\nS'__globals__'\ntR.",
        b"ctorch\nload\n.",
        b"ctorch._utils\n_rebuild_tensor_v2\n(K\x01K\x00)))tR.",
        b"\x80\x02" + pickle_tensor((1,), (1,), "0", 1, "DoubleStorage") + b".",
        b"ccollections\nOrderedDict\n)\x81}S'__class__'\ncos\nsystem\nsb.",
    ]
    pickle.loads(harmful[0])
    trap.unlink()  # the trap works, where an unpickler trusts it
    for pickled in harmful:
        with pytest.raises(InputError):
            read_checkpoint(write(tmp_path / "bad.tar", pickled, {"0": b"\0" * 4}))
    assert not trap.exists()


@pytest.mark.parametrize(
    ("count", "size", "stride", "raw"),
    [
        (4, (5,), (1,), 16),
        (4, (2, 2), (1, 9), 16),
        (4, (2,), (-1,), 16),
        (4, (2, 2), (1,), 16),
        (4, (2**30, 2**30), (0, 0), 16),
        (4, (4,), (1,), 12),
        (-4, (4,), (1,), 16),
    ],
    ids=["long", "wide", "backwards", "ragged", "huge", "cut", "negative"],
)
def test_tensors_outside_their_storage_are_refused(tmp_path, count, size, stride, raw):
    pickled = b"\x80\x02}" + pickle_text("a") + pickle_tensor(size, stride, "0", count) + b"s."
    with pytest.raises(InputError):
        read_checkpoint(write(tmp_path / "bad.tar", pickled, {"0": b"\0" * raw}))


DEEP = b")" + b"\x85" * 90_000  # a tuple in a tuple in a tuple
DOUBLED = b"K\x00" + b"q\x01h\x01\x86" * 60  # (x, x) of (x, x) of ...: 2 ** 60 parts
DICTIONARY = b"ccollections\nOrderedDict\n"
HOSTILE = {
    "deep key": b"}" + DEEP + b"K\x01s.",
    "deep pid": DEEP + b"Q.",
    "deeper than any": b")" + b"\x85" * 2_000_000 + b"K\x01s.",
    "doubled key": b"}" + DOUBLED + b"K\x01s.",
    "doubled pid": DOUBLED + b"Q.",
    "doubled key of an old dictionary": b"(" + DOUBLED + b"K\x01d.",
    "doubled part of a set": b"\x8f(" + DOUBLED + b"\x90.",
    "doubled part of a frozen set": b"(" + DOUBLED + b"\x91.",
    "attributes of the class": DICTIONARY + b"}" + pickle_text("zzz") + b"K\x01sb0.",
    "attributes of the builder": b"ctorch._utils\n_rebuild_tensor_v2\n}"
    + pickle_text("__defaults__") + b")sb.",
    "newline and escape": b"c" + b"a\x1b[31m\n" + b"b\x1b]0;c\x07\n.",
    "key of escapes": b"}" + pickle_text("a") + pickle_tensor((4,), (1,), "\x1b[2J\r", 4) + b"s.",
    "stretched": b"}" + pickle_text("a") + pickle_tensor((2**29,), (0,), "0", 4) + b"s.",
    "endless": b"0" * 200_000,
    "too many": b"N" * 200_000 + b".",
    "no end": b"}",
}  # fmt: skip


@pytest.mark.parametrize("name", HOSTILE)
def test_hostile_descriptions_are_refused_in_one_printable_line_at_once(name, tmp_path):
    path = write(tmp_path / "bad.tar", HOSTILE[name], {"0": b"\0" * 16})
    begun = time.process_time()
    with pytest.raises(InputError) as refusal:
        from_torch(read_checkpoint(path), str(path))
    assert time.process_time() - begun < 5
    assert str(refusal.value).isprintable() and len(str(refusal.value)) < 3000


@pytest.mark.parametrize("state", ["get", "items", "keys", "__class__"])
def test_attributes_of_a_dictionary_change_nothing(state, tmp_path, tensors):
    whole = checkpoint(tmp_path / "model.tar", tensors)
    with zipfile.ZipFile(whole) as archive:
        pickled = archive.read("model/data.pkl")
        raws = {str(key): archive.read(f"model/data/{key}") for key in range(len(tensors))}
    built = pickled[:-1] + b"}" + pickle_text(state) + b"K\x01sb."
    found = read_checkpoint(write(tmp_path / "built.tar", built, raws))
    assert found.keys() == tensors.keys()


def test_a_storage_that_is_asked_for_often_is_held_once(tmp_path):
    raw = 8 * 2**20
    body = b"".join(
        pickle_text(f"t{n}") + pickle_tensor((raw // 4,), (1,), "0", raw // 4) for n in range(40)
    )
    path = write(tmp_path / "big.tar", b"\x80\x02}(" + body + b"u.", {"0": bytes(raw)})
    tracemalloc.start()
    found = read_checkpoint(path)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert len(found) == 40 and peak < 4 * raw


def test_a_member_that_expands_to_gigabytes_is_refused_before_it_does(tmp_path):
    with zipfile.ZipFile(tmp_path / "bomb.tar", "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("model/data.pkl", b"N.")
        with archive.open("model/data/0", "w") as member:
            for _ in range(80):
                member.write(bytes(2**20))
    with pytest.raises(InputError, match="would take 80 MB"):
        read_checkpoint(tmp_path / "bomb.tar")


def test_damaged_files_are_refused(tmp_path, tensors):
    whole = checkpoint(tmp_path / "model.tar", tensors).read_bytes()
    bad = tmp_path / "bad.tar"
    rng = np.random.default_rng(0)
    for cut in (0, 1, 30, len(whole) // 2, len(whole) - 1):
        bad.write_bytes(whole[:cut])
        with pytest.raises(InputError):
            convert_agent(bad, tmp_path / "out.npz")
    for _ in range(60):  # flipped bytes: refused, or harmless (a header field nobody reads)
        broken = bytearray(whole)
        broken[rng.integers(len(whole))] ^= 255
        bad.write_bytes(broken)
        try:
            convert_agent(bad, tmp_path / "out.npz")
        except InputError as error:
            assert "\n" not in str(error)
    with pytest.raises(InputError, match="there is no checkpoint"):
        read_checkpoint(tmp_path / "none.tar")


def test_other_networks_are_refused(tmp_path, tensors):
    less = {name: array for name, array in tensors.items() if "critic" not in name}
    with pytest.raises(InputError, match="it lacks critic"):
        convert_agent(checkpoint(tmp_path / "a.tar", less), tmp_path / "out.npz")
    wrong = {**tensors, "actor.0.0.bias": tensors["actor.0.0.bias"][:3]}
    with pytest.raises(InputError, match="actor_bias is"):
        convert_agent(checkpoint(tmp_path / "a.tar", wrong), tmp_path / "out.npz")
    spoilt = {**tensors, "critic.1.bias": np.array([np.nan], np.float32)}
    with pytest.raises(InputError, match="not finite"):
        convert_agent(checkpoint(tmp_path / "a.tar", spoilt), tmp_path / "out.npz")
    two = io.BytesIO(checkpoint(tmp_path / "a.tar", tensors).read_bytes())
    with zipfile.ZipFile(two, "a") as archive:
        archive.writestr("other/data.pkl", b"N.")
    (tmp_path / "a.tar").write_bytes(two.getvalue())
    with pytest.raises(InputError, match=r"no single data\.pkl"):
        convert_agent(tmp_path / "a.tar", tmp_path / "out.npz")
    with pytest.raises(InputError, match="no dictionary"):
        read_checkpoint(write(tmp_path / "a.tar", b"N.", {}))
    assert not (tmp_path / "out.npz").exists()


def test_weights_keep_their_meaning(tensors):
    weights = from_torch(tensors)
    assert isinstance(weights, Weights)
    theirs = tensors["image_conv.0.weight"]  # filter, channel, x, y
    assert weights.kernel[0, 2, 1, 7] == theirs[7, 1, 0, 2]
    total = tensors["rnn.rnn.bias_ih_l0"] + tensors["rnn.rnn.bias_hh_l0"]
    np.testing.assert_array_equal(weights.gates_bias, total)
