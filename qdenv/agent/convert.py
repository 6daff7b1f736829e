"""Read the published PyTorch checkpoint into our weights, without PyTorch and without trust.

A .tar of `torch.save` is a zip: ``<name>/data.pkl`` describes tensors whose raw numbers lie in
``<name>/data/<key>``. The description is a pickle, a program that could call anything: here it can
build dictionaries, lists and tuples of plain values and float32 arrays, and nothing else.
"""

import io
import math
import pickle
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from qdenv.io.arrays import open_zip
from qdenv.simulation.maze.policy import Weights, check_weights
from qdenv.types import InputError, about

_MAX_MEMBER = 64 * 2**20  # bytes of one member; the published checkpoint has 2 MB in all
_MAX_DESCRIPTION = 2**16  # bytes; the published checkpoint has a tenth of that
_MAX_AXES = 8
_STORAGE = object()  # stands for torch.FloatStorage
_DESCRIPTION = "data.pkl"
_TENSORS = {
    "kernel": "image_conv.0.weight",
    "kernel_bias": "image_conv.0.bias",
    "compass": "scalar_embed.weight",
    "compass_bias": "scalar_embed.bias",
    "gates_in": "rnn.rnn.weight_ih_l0",
    "gates_back": "rnn.rnn.weight_hh_l0",
    "actor": "actor.0.0.weight",
    "actor_bias": "actor.0.0.bias",
    "logits": "actor.1.linear.weight",
    "logits_bias": "actor.1.linear.bias",
    "critic": "critic.0.0.weight",
    "critic_bias": "critic.0.0.bias",
    "value": "critic.1.weight",
    "value_bias": "critic.1.bias",
}
_GATE_BIASES = ("rnn.rnn.bias_ih_l0", "rnn.rnn.bias_hh_l0")


class _Names(dict):
    """A dictionary of the description."""

    def __setitem__(self, name: Any, value: Any) -> None:
        # The hash of nested tuples takes exponential time, or more stack than there is.
        if type(name) not in (str, int):
            raise InputError("refused: a name in the checkpoint is neither text nor a number")
        super().__setitem__(name, value)


class _Unpickler(pickle._Unpickler):
    """Reads a description; in Python, because the compiled class trusts indices of its memo."""

    append: Callable[[Any], None]  # to the stack
    stack: list[Any]

    def __init__(self, description: bytes, load: Callable[[str, int], np.ndarray]) -> None:
        super().__init__(io.BytesIO(description))
        self._load = load  # (key, count) -> float32 [count], a storage

    def find_class(self, module: str, name: str) -> Any:
        known = {
            "collections.OrderedDict": lambda: _Names(),  # a function: the class would take values
            "torch.FloatStorage": _STORAGE,
            "torch._utils._rebuild_tensor_v2": _cut,
        }
        if f"{module}.{name}" not in known:
            raise InputError(f"refused: the checkpoint asks for {module}.{name}")
        return known[f"{module}.{name}"]

    def persistent_load(self, pid: Any) -> np.ndarray:
        plain = type(pid) is tuple and [type(one) for one in pid] == [str, object, str, str, int]
        if not plain or pid[0] != "storage" or pid[1] is not _STORAGE or pid[4] < 0:
            raise InputError("refused: the checkpoint holds something other than float32 tensors")
        return self._load(pid[2], pid[4])

    def load_build(self) -> None:
        # Attributes of a dictionary are ignored: they could shadow its methods.
        self.stack.pop()
        if type(self.stack[-1]) is not _Names:
            raise InputError("refused: the checkpoint sets attributes")

    dispatch = pickle._Unpickler.dispatch | {
        pickle.EMPTY_DICT[0]: lambda self: self.append(_Names()),
        pickle.BUILD[0]: load_build,
    }
    for code in (pickle.DICT, pickle.EMPTY_SET, pickle.FROZENSET):  # with names of any type
        del dispatch[code[0]]
    del code


def _cut(storage: Any, offset: Any, size: Any, stride: Any, *flags: Any) -> np.ndarray:
    """View part of a storage (float32 [n]) as a tensor; an element outside is an InputError."""
    if not isinstance(storage, np.ndarray) or type(size) is not tuple or type(stride) is not tuple:
        raise InputError("refused: the checkpoint builds a tensor from something else")
    numbers = (offset, *size, *stride)
    fits = len(size) == len(stride) and len(size) <= _MAX_AXES
    if not fits or any(type(one) is not int or not 0 <= one < 2**40 for one in numbers):
        raise InputError("the checkpoint holds a tensor of impossible shape")
    steps = [step if count > 1 else 0 for count, step in zip(size, stride, strict=True)]
    last = offset + sum((count - 1) * step for count, step in zip(size, steps, strict=True))
    # A stride of 0 repeats numbers: without the first test a file of one could fill the memory.
    if math.prod(size) > storage.size or (math.prod(size) and last >= storage.size):
        raise InputError("the checkpoint holds a tensor larger than its storage")
    if not math.prod(size):
        return np.zeros(tuple(min(one, 1) for one in size), np.float32)
    steps = [step * storage.itemsize for step in steps]
    return np.lib.stride_tricks.as_strided(storage[offset:], size, steps)


def read_checkpoint(path: str | Path) -> dict[str, np.ndarray]:
    """Read the tensors of a `torch.save` zip (float32, by name); no code of the file is ever run.

    Raises InputError if it is missing, damaged, or asks for anything but float32 tensors.
    """
    path = Path(path)
    if not path.exists():
        raise InputError(f"there is no checkpoint {path}")
    with open_zip(path) as archive, about(str(path)):
        found = _read_description(archive)
    if not isinstance(found, dict):
        raise InputError(f"{path} holds no dictionary of tensors")
    for wrapper in ("model", "state_dict"):
        if isinstance(found.get(wrapper), dict):
            found = found[wrapper]
    return {str(name): value for name, value in found.items() if isinstance(value, np.ndarray)}


def _read_description(archive: zipfile.ZipFile) -> Any:
    """Build what the one description in an archive describes."""
    names, storages = archive.namelist(), {}
    roots = [name.removesuffix(_DESCRIPTION) for name in names if name.endswith(_DESCRIPTION)]
    if len(roots) != 1:
        raise InputError(f"no PyTorch checkpoint: it has no single {_DESCRIPTION}")

    def member(name: str) -> bytes:
        if archive.getinfo(name).file_size > _MAX_MEMBER:
            raise InputError(f"checkpoint member {name} is larger than {_MAX_MEMBER} bytes")
        return archive.read(name)

    def load(key: str, count: int) -> np.ndarray:
        name = f"{roots[0]}data/{key}"
        if name not in names:
            raise InputError(f"storage {key} is missing: file damaged")
        if key not in storages:
            storages[key] = np.frombuffer(member(name), np.uint8)
        size = storages[key].size
        if size != 4 * count:
            raise InputError(f"storage {key} has {size} bytes, not {4 * count}: file damaged")
        return storages[key].view("<f4")

    description = member(f"{roots[0]}{_DESCRIPTION}")
    if len(description) > _MAX_DESCRIPTION:
        raise InputError("refused: the description is far too long")
    try:
        return _Unpickler(description, load).load()
    except InputError:
        raise
    except Exception as error:  # whatever a damaged program does to the machine
        raise InputError(f"the description is damaged: {error}") from error


def from_torch(tensors: dict[str, np.ndarray], source: str = "checkpoint") -> Weights:
    """Rename and transpose the published network's tensors; InputError if it is another one."""
    missing = sorted({*_TENSORS.values(), *_GATE_BIASES} - set(tensors))
    if missing:
        raise InputError(f"{source} is not the maze agent: it lacks {', '.join(missing)}")
    named = {name: tensors[theirs] for name, theirs in _TENSORS.items()}
    kernel = named["kernel"]
    if kernel.ndim != 4:
        raise InputError(f"{source} is not the maze agent: its convolution is {kernel.shape}")
    for name, array in named.items():
        if array.ndim == 2:
            named[name] = array.T
    # PyTorch orders the kernel (filter, channel, x, y); flattening is (filter, x, y) on both sides.
    named["kernel"] = kernel.transpose(2, 3, 1, 0)
    first, second = (tensors[name] for name in _GATE_BIASES)
    if first.shape != second.shape:
        raise InputError(f"{source} is not the maze agent: its two gate biases differ in shape")
    return check_weights(Weights(**named, gates_bias=first + second), source)
