"""Contiguous pieces of arrays too large for memory, read from the file of a memory map."""

import os

import numpy as np


class ArrayReader:
    """Reads pieces [d, first:end] of an array [D, M, ...].

    Pieces of a memory-mapped array are read from its file with `preadv`, past the mapping: pages of a mapping that were
    touched would count as resident, and in the end all of them are.
    """

    def __init__(self, array: np.ndarray) -> None:
        self._array = array
        self._row = array.strides[1] if array.ndim > 1 else 0
        self._file = -1
        if isinstance(array, np.memmap) and array.flags.c_contiguous and array.filename is not None:
            self._file = os.open(array.filename, os.O_RDONLY)

    def __del__(self) -> None:
        if getattr(self, "_file", -1) >= 0:
            os.close(self._file)

    def read(self, lead: int, first: int, out: np.ndarray) -> None:
        """Fill `out` [end - first, ...] with rows from `first` on of the part `lead`.

        Raises:
            EOFError: the file is cut short.
        """
        if self._file < 0 or not out.flags.c_contiguous or not out.size:
            out[...] = self._array[lead, first : first + len(out)]
            return
        assert isinstance(self._array, np.memmap)
        view = out.data.cast("B")
        place = self._array.offset + lead * self._array.strides[0] + first * self._row
        while len(view):
            count = os.preadv(self._file, [view], place)
            if not count:
                raise EOFError(f"{self._array.filename} is cut short")
            view, place = view[count:], place + count
