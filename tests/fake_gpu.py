"""Fake GPU: tensors on the CPU that report another device.

Operations with tensors on both devices fail as on a real GPU.
"""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import torch
from torch import Tensor
from torch.overrides import TorchFunctionMode
from torch.utils._python_dispatch import TorchDispatchMode

from offpiste.dynamics.header.gpu import prepared
from offpiste.dynamics.kernels.autograd import has_kernels

GPU = torch.device("meta")
"""Device of the fake GPU; torch without CUDA refuses the name of a real one."""

FREE = {torch.ops.aten._to_copy.default, torch.ops.aten.copy_.default}
"""Operations that bring numbers from one device to another."""

INDICES = {torch.ops.aten.index.Tensor, torch.ops.aten.index_put_.default}
"""Operations whose indices may lie on the CPU."""


class OnGpu(Tensor):
    """A tensor that says it lies on the GPU."""

    inner: Tensor

    @staticmethod
    def __new__(cls, inner: Tensor) -> "OnGpu":
        made = Tensor._make_wrapper_subclass(
            cls, inner.shape, strides=inner.stride(), storage_offset=inner.storage_offset(), dtype=inner.dtype,
            device=GPU, requires_grad=inner.requires_grad,
        )  # fmt: skip
        made.inner = inner
        return made

    @classmethod
    def __torch_dispatch__(cls, function: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        return run(function, args, kwargs or {})


class Faking(TorchDispatchMode):
    """Makes tensors on the GPU where a call asks for that."""

    def __torch_dispatch__(self, function: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        return run(function, args, kwargs or {})


class FromNumbers(TorchFunctionMode):
    """Brings what is made of numbers to the GPU: torch makes it there without an operation that could be seen."""

    def __torch_function__(self, function: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        kwargs = dict(kwargs or {})
        if function in (torch.tensor, torch.as_tensor) and kwargs.get("device") in (GPU, str(GPU)):
            return function(*args, **kwargs | {"device": "cpu"}).to(GPU)
        if function is Tensor.new_tensor and isinstance(args[0], OnGpu):
            return inside(args[0]).new_tensor(*args[1:], **kwargs).to(GPU)
        if function is Tensor.tolist:
            return inside(args[0]).tolist()
        if function in (Tensor.__getitem__, Tensor.__setitem__) and isinstance(args[0], OnGpu):
            places = args[1] if isinstance(args[1], tuple) else (args[1],)
            places = tuple(
                torch.tensor(place, dtype=torch.long).to(GPU) if isinstance(place, list) else place for place in places
            )
            args = (args[0], places, *args[2:])
        return function(*args, **kwargs)


def run(function: Any, args: Any, kwargs: dict[str, Any]) -> Any:
    """An operation on the CPU, whose result lies where it would."""
    tensors = list(tensors_in((args, kwargs)))
    there = any(isinstance(each, OnGpu) for each in tensors)
    if any(each.device == GPU and not isinstance(each, OnGpu) for each in tensors):
        raise RuntimeError(f"{function}: a tensor was made on the GPU unseen")
    device = torch.device(kwargs["device"]) if kwargs.get("device") is not None else None
    goes = device == GPU if device is not None else there
    if function not in FREE:
        checked = [args[0]] if function in INDICES else tensors
        if there and any(not isinstance(each, OnGpu) and each.dim() for each in checked):
            raise RuntimeError(f"{function}: tensors on the CPU and on the GPU")
    if device is not None:
        kwargs = kwargs | {"device": torch.device("cpu"), "pin_memory": False}
        kwargs = {name: value for name, value in kwargs.items() if name in _known(function)}
    result = function(*mapped(inside, args), **mapped(inside, kwargs))
    if function is torch.ops.aten.copy_.default:
        return args[0]
    given = {id(inside(each)): each for each in tensors}

    def placed(value: Any) -> Any:
        if not isinstance(value, Tensor):
            return value
        return given.get(id(value)) if id(value) in given else (OnGpu(value) if goes else value)

    return mapped(placed, result)


def tensors_in(value: Any) -> Iterator[Tensor]:
    """All tensors of what an operation is given; torch's own trees took a third of the time of a training."""
    if isinstance(value, Tensor):
        yield value
    elif isinstance(value, list | tuple | dict):
        for each in value.values() if isinstance(value, dict) else value:
            yield from tensors_in(each)


def mapped(change: Callable[[Any], Any], value: Any) -> Any:
    """Return arguments or results of an operation with every value changed."""
    if isinstance(value, dict):
        return {name: mapped(change, each) for name, each in value.items()}
    if isinstance(value, list | tuple):
        return type(value)(mapped(change, each) for each in value)
    return change(value)


def _known(function: Any) -> set[str]:
    return {argument.name for argument in function._schema.arguments}


def inside(value: Any) -> Any:
    """The numbers of a tensor."""
    return value.inner if isinstance(value, OnGpu) else value


@contextmanager
def fake_gpu(monkeypatch: Any, kernels: Callable[[str], Any]) -> Iterator[None]:
    """A GPU on which kernels of a text are those that `kernels` makes."""

    class There:
        def __init__(self, text: str) -> None:
            self.made = kernels(text)
            self.lanes = self.made.lanes

        def launch(self, name: str, count: int, *arguments: Any, lanes: int = 1) -> None:
            assert not any(isinstance(each, Tensor) and not isinstance(each, OnGpu) for each in arguments), name
            self.made.launch(name, count, *map(inside, arguments), lanes=lanes)

    monkeypatch.setattr("offpiste.training.train.check_device", torch.device)
    monkeypatch.setattr("offpiste.training.train.free_budget", lambda device: 1 << 30)
    monkeypatch.setattr(
        "offpiste.training.prediction.gpu_kernels",
        lambda dynamics, device, dtype: (
            prepared(dynamics, device, lambda text, device: There(text))
            if device == GPU and has_kernels(dynamics)
            else None
        ),
    )
    with FromNumbers(), Faking():
        yield
