"""Read the published PyTorch checkpoint into our weights, without PyTorch and without trust.

A .tar of `torch.save` is a zip: ``<name>/data.pkl`` describes tensors whose raw numbers lie in
``<name>/data/<key>``. The description is a pickle, so it is read by an unpickler that knows three
names (ordered dictionary, float storage, tensor builder) and none of them is the real thing.
"""

import io
import pickle
import zipfile
from collections import OrderedDict
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from qdenv.agent.files import save_weights
from qdenv.simulate.maze.policy import (
    FILTERS,
    PATCHES,
    Weights,
    check_weights,
    units_of,
)
from qdenv.types import Array, InputError

LARGEST = 64 * 2**20  # bytes of one member; the published checkpoint has 2 MB in all
TENSORS = {
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
GATE_BIASES = ("rnn.rnn.bias_ih_l0", "rnn.rnn.bias_hh_l0")


class _FloatStorage:
    """A name only: tells that a storage holds float32."""


def _member(archive: zipfile.ZipFile, name: str) -> bytes:
    if archive.getinfo(name).file_size > LARGEST:
        raise InputError(f"checkpoint member {name} is larger than {LARGEST} bytes")
    return archive.read(name)


def _view(storage: np.ndarray, offset: int, size: tuple, stride: tuple) -> np.ndarray:
    """Cut a tensor out of its storage, refusing any element outside of it."""
    numbers = (offset, *size, *stride)
    if len(size) != len(stride) or any(type(n) is not int or n < 0 for n in numbers):
        raise InputError("the checkpoint holds a tensor of impossible shape")
    if min(size, default=1) > 0:
        last = offset + sum((n - 1) * step for n, step in zip(size, stride, strict=True))
        if last >= storage.size:
            raise InputError("the checkpoint holds a tensor larger than its storage")
    steps = [step * storage.itemsize for step in stride]
    return np.lib.stride_tricks.as_strided(storage[offset:], size, steps).copy()


class _Reader(pickle.Unpickler):
    """An unpickler that can build ordered dictionaries of float32 arrays and nothing else."""

    def __init__(self, archive: zipfile.ZipFile, root: str) -> None:
        super().__init__(io.BytesIO(_member(archive, f"{root}data.pkl")))
        self._archive, self._root = archive, root

    def find_class(self, module: str, name: str) -> Any:
        known = {
            ("collections", "OrderedDict"): OrderedDict,
            ("torch", "FloatStorage"): _FloatStorage,
            ("torch._utils", "_rebuild_tensor_v2"): self._tensor,
        }
        if (module, name) not in known:
            raise InputError(f"refused: the checkpoint asks for {module}.{name}")
        return known[module, name]

    def persistent_load(self, pid: Any) -> np.ndarray:
        if not isinstance(pid, tuple) or len(pid) != 5 or pid[:2] != ("storage", _FloatStorage):
            raise InputError("refused: the checkpoint holds something other than float32 tensors")
        key, count = pid[2], pid[4]
        raw = _member(self._archive, f"{self._root}data/{key}")
        if len(raw) != 4 * count:
            raise InputError(f"storage {key} has {len(raw)} bytes, not {4 * count}: file damaged")
        return np.frombuffer(raw, "<f4")

    @staticmethod
    def _tensor(storage: Any, offset: Any, size: Any, stride: Any, *_: Any) -> np.ndarray:
        if not isinstance(storage, np.ndarray):
            raise InputError("refused: the checkpoint builds a tensor from something else")
        return _view(storage, offset, tuple(size), tuple(stride))


def read_checkpoint(path: str | Path) -> dict[str, np.ndarray]:
    """Read the tensors of a `torch.save` zip; no code of the file is ever run.

    Returns:
        float32 arrays by name (a "model" or "state_dict" wrapper is opened).

    Raises:
        InputError: missing, damaged, or asking for anything but float32 tensors.
    """
    path = Path(path)
    try:
        with zipfile.ZipFile(path) as archive:
            roots = [name[:-8] for name in archive.namelist() if name.endswith("data.pkl")]
            if len(roots) != 1:
                raise InputError(f"{path} is no PyTorch checkpoint: it has no single data.pkl")
            found = _Reader(archive, roots[0]).load()
    except InputError:
        raise
    except FileNotFoundError:
        raise InputError(f"there is no checkpoint {path}") from None
    except zipfile.BadZipFile:
        raise InputError(f"{path} is damaged or no zip: PyTorch 1.6 or later writes one") from None
    except Exception as error:  # a hostile pickle can raise whatever it likes
        raise InputError(f"{path} is damaged: {type(error).__name__}: {error}") from None
    if not isinstance(found, dict):
        raise InputError(f"{path} holds no dictionary of tensors")
    for wrapper in ("model", "state_dict"):
        if isinstance(found.get(wrapper), dict):
            found = found[wrapper]
    return {
        str(name): value
        for name, value in found.items()
        if isinstance(value, np.ndarray) and value.dtype == np.float32
    }


def from_torch(tensors: dict[str, np.ndarray], source: str = "checkpoint") -> Weights:
    """Rename and transpose the published network's tensors.

    Raises:
        InputError: a tensor is missing or has the wrong shape.
    """
    missing = sorted({*TENSORS.values(), *GATE_BIASES} - set(tensors))
    if missing:
        raise InputError(f"{source} is not the maze agent: it lacks {', '.join(missing)}")
    named = {name: tensors[theirs] for name, theirs in TENSORS.items()}
    kernel = named["kernel"]
    if kernel.ndim != 4:
        raise InputError(f"{source} is not the maze agent: its convolution is {kernel.shape}")
    for name, array in named.items():
        if array.ndim == 2:
            named[name] = array.T
    # PyTorch orders the kernel (filter, channel, x, y); flattening is (filter, x, y) on both sides.
    named["kernel"] = kernel.transpose(2, 3, 1, 0)
    first, second = (tensors[name] for name in GATE_BIASES)
    if first.shape != second.shape:
        raise InputError(f"{source} is not the maze agent: its two gate biases differ in shape")
    return check_weights(Weights(**named, gates_bias=first + second), source)


def convert_agent(checkpoint: Path, out: Path) -> str:
    """Convert the published agent's checkpoint (`model_20000.tar`) into an .npz agent.

    Args:
        checkpoint: file written by `torch.save`.
        out: the .npz to write.

    Returns:
        One line that says what was written.

    Raises:
        InputError: the file is missing, damaged, hostile, or another network.
    """
    weights = from_torch(read_checkpoint(checkpoint), str(checkpoint))
    save_weights(weights, out)
    units, actions = weights.gates_back.shape[0], weights.logits.shape[1]
    return f"wrote {out}: {units} LSTM units, {actions} actions, {FILTERS * PATCHES**2} features"


def pad_units(weights: Weights, units: int) -> Weights:
    """Add LSTM units that stay at zero, so that the agent decides as before.

    A trained agent of any size without training: what a benchmark of the cost needs.

    Raises:
        InputError: the agent has more units already.
    """
    own = units_of(weights)
    if units < own:
        raise InputError(f"the agent has {own} units: ask for as many or more")
    more = ((0, 0), (0, units - own))

    def gates(matrix: Array) -> jax.Array:
        """Pad each of the four gates (float32 [n, 4 L])."""
        parts = [jnp.pad(part, more) for part in jnp.split(matrix, 4, axis=1)]
        return jnp.concatenate(parts, axis=1)

    rows = ((0, units - own), (0, 0))
    return weights._replace(
        gates_in=gates(weights.gates_in),
        gates_back=jnp.pad(gates(weights.gates_back), rows),
        gates_bias=gates(weights.gates_bias[None])[0],
        actor=jnp.pad(weights.actor, rows),
        critic=jnp.pad(weights.critic, rows),
    )
