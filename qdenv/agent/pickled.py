"""The description of tensors in a PyTorch checkpoint, read as data: nothing in it can be called.

A pickle is a program for a stack machine. Here is one that knows the few instructions `torch.save`
writes, three names (ordered dictionary, float storage, tensor builder), and limits.
https://docs.python.org/3/library/pickletools.html lists the instructions.
"""

import math
import pickletools
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from qdenv.types import InputError

MOST_INSTRUCTIONS = 100_000  # the published checkpoint has some 2,000
MOST_AXES = 8
MARK = object()
DICTIONARY, STORAGE, TENSOR = (
    "collections OrderedDict",
    "torch FloatStorage",
    "torch._utils _rebuild_tensor_v2",
)
CONSTANTS = {"NONE": None, "NEWTRUE": True, "NEWFALSE": False}
SAID = {"BININT", "BININT1", "BININT2", "LONG1", "BINFLOAT", "BINUNICODE"}  # push their argument
WIDTHS = {"EMPTY_TUPLE": 0, "TUPLE1": 1, "TUPLE2": 2, "TUPLE3": 3}
STATELESS = {"PROTO", "STOP"}


class Name(NamedTuple):
    """A name that the description refers to; it stands for nothing."""

    text: str


class Machine:
    """A stack machine that can build dictionaries, lists and tuples of arrays and plain values.

    Whatever it is told, it raises `InputError` at worst.
    """

    def __init__(self, load: Callable[[str, int], np.ndarray]) -> None:
        """Begin with nothing.

        Args:
            load: (key, count) -> float32 [count], a storage.
        """
        self._load, self._stack, self._memo = load, list[Any](), dict[int, Any]()

    def run(self, program: bytes) -> Any:
        """Run a pickle.

        Returns:
            what it builds: plain values, and float32 arrays that share their storages.

        Raises:
            InputError: it is damaged, or asks for anything but float32 tensors.
        """
        for count, (code, argument, _) in enumerate(pickletools.genops(program)):
            if count > MOST_INSTRUCTIONS:
                raise InputError("refused: the description is far too long")
            self._step(code.name, argument)
        if len(self._stack) != 1:
            raise InputError("the description ends too early")
        return self._stack.pop()

    def _step(self, code: str, argument: Any) -> None:
        stack = self._stack
        if code in STATELESS:
            return
        if code == "MARK":
            stack.append(MARK)
        elif code in CONSTANTS:
            stack.append(CONSTANTS[code])
        elif code in SAID:
            stack.append(argument)
        elif code in WIDTHS:
            stack.append(tuple(self._pop(WIDTHS[code])))
        elif code == "TUPLE":
            stack.append(tuple(self._pop_to_mark()))
        elif code in ("EMPTY_DICT", "EMPTY_LIST"):
            stack.append({} if code == "EMPTY_DICT" else [])
        elif code in ("BINPUT", "LONG_BINPUT"):
            self._memo[argument] = self._top(object)
        elif code in ("BINGET", "LONG_BINGET"):
            stack.append(self._recall(argument))
        elif code in ("APPEND", "APPENDS"):
            values = self._pop(1) if code == "APPEND" else self._pop_to_mark()
            self._top(list).extend(values)
        elif code in ("SETITEM", "SETITEMS"):
            self._set(self._pop(2) if code == "SETITEM" else self._pop_to_mark())
        elif code == "GLOBAL":
            stack.append(self._name(argument))
        elif code == "BINPERSID":
            stack.append(self._storage(*self._pop(1)))
        elif code == "REDUCE":
            stack.append(self._call(*self._pop(2)))
        elif code == "BUILD":  # attributes of a dictionary, which nobody needs
            self._pop(1)
            self._top(dict)
        else:
            raise InputError(f"refused: the checkpoint holds the instruction {code}")

    def _pop(self, count: int) -> list[Any]:
        values = self._stack[len(self._stack) - count :] if count else []
        if len(values) < count or any(value is MARK for value in values):
            raise InputError("the description takes more than it gave")
        del self._stack[len(self._stack) - count :]
        return values

    def _pop_to_mark(self) -> list[Any]:
        values: list[Any] = []
        while self._stack:
            value = self._stack.pop()
            if value is MARK:
                return values[::-1]
            values.append(value)
        raise InputError("the description takes more than it gave")

    def _top(self, kind: type) -> Any:
        if not self._stack or not isinstance(self._stack[-1], kind) or self._stack[-1] is MARK:
            raise InputError("the description fills what is nothing to fill")
        return self._stack[-1]

    def _recall(self, number: int) -> Any:
        if number not in self._memo:
            raise InputError("the description refers to what it never said")
        return self._memo[number]

    def _set(self, values: list[Any]) -> None:
        target, names = self._top(dict), values[::2]
        # Only such keys are cheap to compare, whatever the file makes of them.
        if len(values) % 2 or any(type(name) not in (str, int) for name in names):
            raise InputError("refused: the checkpoint names things by something other than words")
        target.update(zip(names, values[1::2], strict=True))

    @staticmethod
    def _name(text: str) -> Name:
        if text not in (DICTIONARY, STORAGE, TENSOR):
            raise InputError(f"refused: the checkpoint asks for {text.replace(' ', '.')}")
        return Name(text)

    def _storage(self, pid: Any) -> np.ndarray:
        kinds = (str, Name, str, str, int)
        plain = type(pid) is tuple and tuple(map(type, pid)) == kinds
        if not plain or pid[:2] != ("storage", Name(STORAGE)) or pid[4] < 0:
            raise InputError("refused: the checkpoint holds something other than float32 tensors")
        return self._load(pid[2], pid[4])

    @staticmethod
    def _call(name: Any, given: Any) -> Any:
        if type(name) is Name and type(given) is tuple:
            if name.text == DICTIONARY and not given:
                return {}
            if name.text == TENSOR and len(given) >= 4:
                return cut(*given[:4])
        raise InputError("refused: the checkpoint calls something other than a tensor's builder")


def cut(storage: Any, offset: Any, size: Any, stride: Any) -> np.ndarray:
    """Cut a tensor out of its storage, without copying it.

    Args:
        storage: float32 [n].
        offset: its first element.
        size: of each axis.
        stride: elements from one to the next along each axis.

    Raises:
        InputError: an element lies outside, there are more elements than the storage has, or what
            is given is no tensor at all.
    """
    if not isinstance(storage, np.ndarray) or type(size) is not tuple or type(stride) is not tuple:
        raise InputError("refused: the checkpoint builds a tensor from something else")
    numbers = (offset, *size, *stride)
    if len(size) != len(stride) or len(size) > MOST_AXES:
        raise InputError("the checkpoint holds a tensor of impossible shape")
    if any(type(one) is not int or not 0 <= one < 2**40 for one in numbers):
        raise InputError("the checkpoint holds a tensor of impossible shape")
    steps = [step if count > 1 else 0 for count, step in zip(size, stride, strict=True)]
    last = offset + sum((count - 1) * step for count, step in zip(size, steps, strict=True))
    if math.prod(size) > storage.size or (math.prod(size) and last >= storage.size):
        raise InputError("the checkpoint holds a tensor larger than its storage")
    if not math.prod(size):
        return np.zeros(tuple(min(one, 1) for one in size), np.float32)
    steps = [step * storage.itemsize for step in steps]
    return np.lib.stride_tricks.as_strided(storage[offset:], size, steps)
