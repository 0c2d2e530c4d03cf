"""Errors of GPU kernels that cannot be compiled or run, with a stand-in for cuda-core."""

import sys
from types import ModuleType, SimpleNamespace

import pytest
import torch

from offpiste.core.errors import OffpisteError
from offpiste.native.cuda_kernels import CudaKernels, argument_of, machine_code


class CUDAError(Exception):
    """Stand-in for the error of cuda-core."""


class StandIn:
    """cuda-core, whose parts fail where `failing` says so."""

    def __init__(self):
        self.failing = {}
        self.caches = []

    def of(self, name, result=None):
        def called(*arguments, **options):
            if name in self.failing:
                raise self.failing[name]
            return result

        return called

    def program(self, text, language, options):
        def compile(kind, cache=None):
            self.caches.append(cache)
            return self.of("write" if cache else "compile", SimpleNamespace(get_kernel=self.of("kernel")))()

        return SimpleNamespace(compile=compile)


@pytest.fixture
def cuda(monkeypatch):
    stand_in, core, utils = StandIn(), ModuleType("cuda.core"), ModuleType("cuda.core.utils")
    core.Device = lambda index: SimpleNamespace(set_current=stand_in.of("driver"))
    core.Program, core.ProgramOptions = stand_in.program, stand_in.of("options")
    core.LaunchConfig, core.launch = stand_in.of("config"), stand_in.of("launch")
    core.Stream = SimpleNamespace(from_handle=stand_in.of("stream"))
    utils.FileStreamProgramCache = stand_in.of("folder", "cache")
    for name, module in {"cuda": ModuleType("cuda"), "cuda.core": core, "cuda.core.utils": utils}.items():
        monkeypatch.setitem(sys.modules, name, module)
    monkeypatch.setattr(torch.cuda, "get_device_capability", lambda device: (9, 0))
    monkeypatch.setattr(torch.cuda, "current_stream", lambda device: SimpleNamespace(cuda_stream=0))
    return stand_in


@pytest.mark.parametrize("part", ["folder", "write"])
def test_where_machine_code_cannot_be_kept_it_is_compiled_all_the_same(part, cuda, caplog):
    cuda.failing[part] = PermissionError("read-only")
    assert machine_code("", "sm_90") is not None
    assert cuda.caches[-1] is None
    assert "compiled at each start" in caplog.text


@pytest.mark.parametrize(
    "error", [RuntimeError("no libnvrtc.so.13"), CUDAError("5: NVRTC_ERROR_INVALID_OPTION,\n invalid value \0")]
)
def test_without_nvrtc_or_with_one_that_does_not_know_the_gpu_a_line_says_what_to_install(error, cuda):
    cuda.failing |= {"write": error, "compile": error}
    with pytest.raises(
        OffpisteError, match=r"NVRTC does not compile for sm_990: .*; install cuda-core\[cu12\]"
    ) as found:
        machine_code("", "sm_990")
    assert str(found.value).isprintable()
    assert "x00" not in str(found.value)


def test_without_a_driver_and_where_a_kernel_does_not_run_a_line_says_so(cuda):
    device = torch.device("cuda", 0)
    kernels = CudaKernels("", device)
    kernels.launch("offpiste_roll_out", 3, None, 4)
    cuda.failing["launch"] = CUDAError("700: CUDA_ERROR_ILLEGAL_ADDRESS")
    with pytest.raises(OffpisteError, match="offpiste_roll_out does not run on cuda:0: 700: CUDA_ERROR"):
        kernels.launch("offpiste_roll_out", 3)
    cuda.failing["driver"] = RuntimeError('"cuda" is an NVIDIA driver library')
    with pytest.raises(OffpisteError, match=r"no work on cuda:0: .*; check that nvidia-smi lists the GPU"):
        CudaKernels("", device)


def test_arguments_are_pointers_and_32_bit_integers():
    assert argument_of(None) == 0
    assert argument_of(7).dtype == "int32"
    with pytest.raises(ValueError, match="is not contiguous"):
        argument_of(torch.zeros(2, 3).t())
