"""Entries of the compiled library on torch's tensors."""

import ctypes
from typing import Any, Final

import numpy as np
import torch
from torch import Tensor

from offpiste.native.library import library
from offpiste.native.threads import spread_kernel

CHUNK: Final = 32
"""Samples whose sums are computed together (`native/cpp/lanes.h`)."""


def new_floats(*shape: int) -> Tensor:
    """Return a tensor for results of the library, whatever torch's default type is."""
    return torch.empty(shape, dtype=torch.float32)


def call(name: str, count: int, *arguments: object, of: ctypes.CDLL | None = None) -> None:
    """Call an entry on parts 0 to `count`, spread over threads.

    Args:
        arguments: contiguous tensors or arrays, structures, integers, or None for no array.
        of: library of the entry, if it is not the one that ships.
    """
    entry = getattr(of or library(), f"offpiste_{name}")
    entry.restype = None
    spread_kernel(count, entry, *map(_argument, arguments))


def _argument(argument: object) -> Any:
    if isinstance(argument, ctypes.Structure):
        return ctypes.byref(argument)
    return argument if isinstance(argument, int) else address(argument)


def address(array: object) -> ctypes.c_void_p:
    """Return the address of a contiguous tensor or array; 0 for None.

    Raises:
        ValueError: it is not contiguous.
    """
    if isinstance(array, Tensor):
        if not array.is_contiguous() or array.device.type != "cpu":
            raise ValueError(f"a tensor {list(array.shape)} is not contiguous on the CPU")
        return ctypes.c_void_p(array.data_ptr())
    if isinstance(array, np.ndarray):
        if not array.flags.c_contiguous:
            raise ValueError(f"an array {array.shape} is not contiguous")
        return ctypes.c_void_p(array.ctypes.data)
    assert array is None
    return ctypes.c_void_p(0)


class Arrays:
    """Arrays whose addresses are in a structure, kept alive with it."""

    def __init__(self) -> None:
        self._kept: list[object] = []

    def floats(self, values: Tensor) -> ctypes.c_void_p:
        """Keep values as contiguous float32 and return their address."""
        return self._address(values.detach().to(torch.float32).contiguous())

    def bytes(self, values: Tensor) -> ctypes.c_void_p:
        """Keep values of any type as they are and return their address."""
        return self._address(values.detach().contiguous())

    def whole(self, values: Tensor | list[int]) -> ctypes.c_void_p:
        """Keep whole numbers as int32 and return their address."""
        return self._address(torch.as_tensor(values, dtype=torch.int32).contiguous())

    def structures(self, array: ctypes.Array[Any]) -> ctypes.c_void_p:
        """Keep structures and return the address of the first."""
        self._kept.append(array)
        return ctypes.c_void_p(ctypes.addressof(array))

    def _address(self, values: Tensor) -> ctypes.c_void_p:
        self._kept.append(values)
        return address(values)
