"""Generated C compiled for this machine and called by ctypes, in place of a GPU."""

import ctypes
import hashlib
import shutil
import subprocess
import tempfile
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest
import torch
from torch import Tensor

from offpiste.native.cuda_kernels import lanes_of

LACKING = [name for name in ("gcc", "g++") if shutil.which(name) is None]
needs_gcc = pytest.mark.skipif(
    bool(LACKING), reason=f"no {' and no '.join(LACKING)} here to compile the printed C with"
)
needs_nvcc = pytest.mark.skipif(shutil.which("nvcc") is None, reason="no nvcc here to compile the printed C with")

FOLDER = Path(tempfile.gettempdir()) / "offpiste-host-kernels"


def compiled(text: str, *flags: str, language: str = "c++") -> ctypes.CDLL:
    """A shared library of a text; kept under a digest of text and flags."""
    name = hashlib.sha256("\0".join((text, language, *flags)).encode()).hexdigest()[:20]
    library = FOLDER / f"{name}.so"
    if not library.exists():
        with tempfile.TemporaryDirectory() as folder:
            made = Path(folder) / "made.so"
            compiler = "g++" if language == "c++" else "gcc"
            standard = "-std=c++17" if language == "c++" else "-std=c99"
            command = [compiler, standard, "-O1", "-Wall", "-Wextra", "-Wno-unused-parameter", "-Werror", *flags]
            command += ["-shared", "-fPIC", "-x", language, "-", "-o", str(made), "-lm"]
            found = subprocess.run(command, input=text, text=True, capture_output=True)
            assert found.returncode == 0, found.stderr[:3000]
            FOLDER.mkdir(exist_ok=True)
            shutil.move(made, library)
    return ctypes.CDLL(str(library))


LANES = """
#include <math.h>
#include <pthread.h>
static __thread int offpiste_lane;
static float offpiste_shown[4];
static pthread_barrier_t offpiste_all;
__attribute__((constructor)) static void offpiste_begin() { pthread_barrier_init(&offpiste_all, nullptr, 4); }
extern "C" void offpiste_be_lane(int lane) { offpiste_lane = lane; }
#define OFFPISTE_LANE offpiste_lane
static inline float offpiste_from_lane(float value, int lane) {
    offpiste_shown[offpiste_lane] = value;
    pthread_barrier_wait(&offpiste_all);
    value = offpiste_shown[lane];
    pthread_barrier_wait(&offpiste_all);
    return value;
}
"""
"""Lanes of a sample as threads that show each other their values."""


class HostKernels:
    """Kernels of a text, launched here; lanes that share an item are threads."""

    def __init__(self, text: str, *flags: str) -> None:
        self.lanes = lanes_of(text)
        self.library = compiled(LANES + text if self.lanes > 1 else text, *flags)

    def launch(self, name: str, count: int, *arguments: Tensor | int | None, lanes: int = 1) -> None:
        """Run a kernel for `count` items; tensors are contiguous."""
        given: list[object] = []
        for argument in arguments:
            if isinstance(argument, Tensor):
                assert argument.is_contiguous()
                assert argument.dtype in (torch.float32, torch.float64, torch.int32)
                given.append(ctypes.c_void_p(argument.data_ptr()))
            else:
                given.append(ctypes.c_void_p(None) if argument is None else ctypes.c_int(argument))
        run = getattr(self.library, name)

        def be(lane: int) -> None:
            if self.lanes > 1:
                self.library.offpiste_be_lane(lane)
            run(*given, ctypes.c_int(count))

        with ThreadPoolExecutor(lanes) as threads:
            list(threads.map(be, range(lanes)))
