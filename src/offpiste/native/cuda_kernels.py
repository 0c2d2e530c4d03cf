"""Kernels for NVIDIA GPUs: compiled by NVRTC when they are first used, kept on disk, launched on torch's stream.

Needs the extra `cuda` (cuda-core) and a torch that was built for CUDA.
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
"""Threads of a block, as OFFPISTE_BLOCK in kernels.h."""

LARGEST_CACHE: Final = 1 << 28
"""Bytes of machine code that are kept."""


@runtime_checkable
class Kernels(Protocol):
    """Compiled kernels, wherever they run.

    Attributes:
        lanes: threads that share an item, of kernels that have it shared.
    """

    lanes: int

    def launch(self, name: str, count: int, *arguments: Tensor | int | None, lanes: int = 1) -> None:
        """Run a kernel for `count` items; tensors are contiguous, and lie where it runs; None is no array.

        Args:
            lanes: threads for each item.
        """
        ...


def lanes_of(text: str) -> int:
    """OFFPISTE_LANES of a text (`dynamics/header/lanes.h`)."""
    return max(map(int, re.findall(r"^#define OFFPISTE_LANES (\d+)", text, re.MULTILINE)), default=1)


@final
class CudaKernels:
    """Kernels of a text on one GPU.

    Args:
        text: C++ without includes, its kernels `extern "C"`.

    Raises:
        MissingExtra: cuda-core is not installed.
        OffpisteError: no driver, no NVRTC, or one that does not know this GPU.
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
        """Run a kernel for `count` items, each by so many threads, on torch's current stream.

        Raises:
            OffpisteError: the driver does not run it.
        """
        from cuda.core import LaunchConfig, Stream, launch

        given = [argument_of(argument) for argument in (*arguments, count)]
        with _errors_of_cuda(f"{name} does not run on {self._device}", "report GPU, driver and this line"):
            if name not in self._kernels:
                self._kernels[name] = self._code.get_kernel(name)
            stream = Stream.from_handle(torch.cuda.current_stream(self._device).cuda_stream)
            launch(stream, LaunchConfig(grid=-(-count * lanes // BLOCK), block=BLOCK), self._kernels[name], *given)


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
    """Machine code of a text (`cuda.core.ObjectCode`), kept on disk where that can be; compiling needs no GPU.

    Raises:
        MissingExtra: cuda-core is not installed.
        OffpisteError: no NVRTC, or one that does not know the architecture.
    """
    with extra("cuda"):
        from cuda.core import Program, ProgramOptions
        from cuda.core.utils import FileStreamProgramCache
    folder = cache_folder() / "cuda"
    how = "install cuda-core[cu12] or cuda-core[cu13], as torch.version.cuda says; a newer NVRTC knows newer GPUs"
    with _errors_of_cuda(f"NVRTC does not compile for {architecture}", how):
        # Exact quotients and roots are branches amid a step. Lanes do without, to two units in the last place; going
        # back, a thread would spill more.
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
    """Turn errors of NVRTC, the driver and the loader of their libraries into one line."""
    try:
        yield
    except Exception as error:  # those of cuda-core have no base in its public names
        raise OffpisteError(f"{what}: {str(error).replace(chr(0), '')}", how=how) from error


@cache
def cuda_kernels(text: str, device: torch.device) -> CudaKernels:
    """Kernels of a text on a GPU, compiled once a process."""
    return CudaKernels(text, device)
