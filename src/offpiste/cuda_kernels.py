"""Kernels for NVIDIA GPUs: compiled by NVRTC when they are first used, kept on disk, launched on torch's stream.

Needs the extra `cuda` (cuda-core) and a torch that was built for CUDA.
"""

from functools import cache
from typing import Any, Final, Protocol, final, runtime_checkable

import numpy as np
import torch
from torch import Tensor

from offpiste.cache import cache_folder
from offpiste.errors import extra

BLOCK: Final = 64
"""Threads of a block, as OFFPISTE_BLOCK in kernels.h."""

LARGEST_CACHE: Final = 1 << 28
"""Bytes of machine code that are kept."""


@runtime_checkable
class Kernels(Protocol):
    """Compiled kernels, wherever they run."""

    def launch(self, name: str, count: int, *arguments: Tensor | int | None) -> None:
        """Run a kernel for `count` items; tensors are contiguous, and lie where it runs; None is no array."""
        ...


@final
class CudaKernels:
    """Kernels of a text on one GPU.

    Args:
        text: C++ without includes, its kernels `extern "C"`.

    Raises:
        MissingExtra: cuda-core is not installed.
    """

    def __init__(self, text: str, device: torch.device) -> None:
        with extra("cuda"):
            from cuda.core import Device
        major, minor = torch.cuda.get_device_capability(device)
        self._device = device
        Device(torch.cuda.current_device() if device.index is None else device.index).set_current()
        self._code = machine_code(text, f"sm_{major}{minor}")
        self._kernels: dict[str, Any] = {}

    def launch(self, name: str, count: int, *arguments: Tensor | int | None) -> None:
        """Run a kernel for `count` items on torch's current stream."""
        from cuda.core import LaunchConfig, Stream, launch

        if name not in self._kernels:
            self._kernels[name] = self._code.get_kernel(name)
        given = [argument_of(argument) for argument in (*arguments, count)]
        stream = Stream.from_handle(torch.cuda.current_stream(self._device).cuda_stream)
        launch(stream, LaunchConfig(grid=-(-count // BLOCK), block=BLOCK), self._kernels[name], *given)


def argument_of(argument: Tensor | int | None) -> int | np.int32:
    """An argument as cuda-core takes it: Python's integers are pointers.

    Raises:
        ValueError: a tensor that is not contiguous.
    """
    if argument is None:
        return 0
    if isinstance(argument, Tensor):
        if not argument.is_contiguous():
            raise ValueError(f"an array of {list(argument.shape)} is not contiguous")
        return argument.data_ptr()
    return np.int32(argument)


def machine_code(text: str, architecture: str) -> Any:
    """Machine code of a text (`cuda.core.ObjectCode`), kept on disk; compiling needs no GPU.

    Raises:
        MissingExtra: cuda-core is not installed.
    """
    with extra("cuda"):
        from cuda.core import Program, ProgramOptions
        from cuda.core.utils import FileStreamProgramCache
    options = ProgramOptions(arch=architecture, std="c++17", diag_suppress=177)
    kept = FileStreamProgramCache(cache_folder() / "cuda", max_size_bytes=LARGEST_CACHE)
    return Program(text, "c++", options).compile("cubin", cache=kept)


@cache
def cuda_kernels(text: str, device: torch.device) -> CudaKernels:
    """Kernels of a text on a GPU, compiled once a process."""
    return CudaKernels(text, device)
