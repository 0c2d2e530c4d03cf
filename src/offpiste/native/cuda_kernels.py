"""Kernels for NVIDIA GPUs: compiled by NVRTC on first use, cached on disk, launched on torch's stream.

They need the extra `cuda` (cuda-core) and a CUDA build of torch.
"""

import logging
import re
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from typing import Any, Final, Protocol, final, runtime_checkable

import numpy as np
import torch
from torch import Tensor

from offpiste.core.cache import cache_folder
from offpiste.core.errors import OffpisteError, extra

logger = logging.getLogger(__name__)

BLOCK: Final = 64
"""Threads per block, equal to OFFPISTE_BLOCK in kernels.h."""

LARGEST_CACHE: Final = 1 << 28
"""Largest cache of machine code [bytes]."""


@runtime_checkable
class Kernels(Protocol):
    """Compiled kernels on any device.

    Attributes:
        lanes: threads per item in kernels that share items.
    """

    lanes: int

    def launch(self, name: str, count: int, *arguments: Tensor | int | None, lanes: int = 1) -> None:
        """Run a kernel for `count` items with so many threads each.

        Args:
            arguments: integers, contiguous tensors on the device, or None for no array.
        """
        ...


def lanes_of(text: str) -> int:
    """Return the threads per item, OFFPISTE_LANES in a source text (`dynamics/header/lanes.h`); 1 if not defined."""
    return max(map(int, re.findall(r"^#define OFFPISTE_LANES (\d+)", text, re.MULTILINE)), default=1)


@final
class CudaKernels:
    """Kernels of a source text on one GPU.

    Args:
        text: C++ without includes and with `extern "C"` kernels.

    Raises:
        MissingExtra: cuda-core is not installed.
        OffpisteError: driver or NVRTC is missing or does not support this GPU.
    """

    def __init__(self, text: str, device: torch.device) -> None:
        with extra("cuda"):
            from cuda.core import Device
        self._device = device
        with _errors_of_cuda(f"no work on {device}", "check that nvidia-smi lists the GPU, or use the CPU"):
            major, minor = torch.cuda.get_device_capability(device)
            Device(torch.cuda.current_device() if device.index is None else device.index).set_current()
        self.lanes, self._code = lanes_of(text), machine_code(text, f"sm_{major}{minor}")
        self._kernels: dict[str, Any] = {}

    def launch(self, name: str, count: int, *arguments: Tensor | int | None, lanes: int = 1) -> None:
        """Run a kernel on torch's current stream (see `Kernels`); raises `OffpisteError` if the driver fails."""
        from cuda.core import LaunchConfig, Stream, launch

        given = [argument_of(argument) for argument in (*arguments, count)]
        with _errors_of_cuda(f"{name} does not run on {self._device}", "report GPU, driver and this line"):
            if name not in self._kernels:
                self._kernels[name] = self._code.get_kernel(name)
            stream = Stream.from_handle(torch.cuda.current_stream(self._device).cuda_stream)
            launch(stream, LaunchConfig(grid=-(-count * lanes // BLOCK), block=BLOCK), self._kernels[name], *given)


def argument_of(argument: Tensor | int | None) -> int | np.int32:
    """Convert an argument for cuda-core, which takes Python integers for pointers."""
    if argument is None:
        return 0
    if isinstance(argument, Tensor):
        if not argument.is_contiguous():
            raise ValueError(f"an array of shape {list(argument.shape)} is not contiguous")
        return argument.data_ptr()
    return np.int32(argument)


def machine_code(text: str, architecture: str) -> Any:
    """Compile a source text (`cuda.core.ObjectCode`) with a cache on disk; this needs no GPU.

    Raises:
        MissingExtra: cuda-core is not installed.
        OffpisteError: NVRTC is missing or does not support the architecture.
    """
    with extra("cuda"):
        from cuda.core import Program, ProgramOptions
        from cuda.core.utils import FileStreamProgramCache
    folder = cache_folder() / "cuda"
    how = "install cuda-core[cu12] or cuda-core[cu13], as torch.version.cuda says; a newer NVRTC knows newer GPUs"
    with _errors_of_cuda(f"NVRTC does not compile for {architecture}", how):
        # Exact quotients and roots branch within a step and make the backward pass spill. Lanes use approximations
        # with an error of two units in the last place.
        rounded = {"prec_div": False, "prec_sqrt": False} if lanes_of(text) > 1 else {}
        options = ProgramOptions(arch=architecture, std="c++17", diag_suppress=177, **rounded)
        try:
            kept = FileStreamProgramCache(folder, max_size_bytes=LARGEST_CACHE)
            return Program(text, "c++", options).compile("cubin", cache=kept)
        except OSError as error:
            logger.warning("GPU kernels are compiled at each start, as %s cannot be used: %s", folder, error)
            return Program(text, "c++", options).compile("cubin")


@contextmanager
def _errors_of_cuda(what: str, how: str) -> Iterator[None]:
    """Turn errors of NVRTC and the driver into one line."""
    try:
        yield
    except Exception as error:  # errors of cuda-core have no public base class
        raise OffpisteError(f"{what}: {str(error).replace(chr(0), '')}", how=how) from error


@cache
def cuda_kernels(text: str, device: torch.device) -> CudaKernels:
    """Return the kernels of a source text on a GPU, compiled once per process."""
    return CudaKernels(text, device)
