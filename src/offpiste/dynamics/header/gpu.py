"""Rollouts over recorded terrain on an NVIDIA GPU (extra `cuda`): which models, and a check before the first one."""

import logging
from collections.abc import Callable
from functools import cache, partial
from weakref import WeakKeyDictionary

import torch

from offpiste.core.errors import OffpisteError, installation_of, is_installed
from offpiste.dynamics.base import Dynamics
from offpiste.dynamics.header.recorded import recorded_text, rollout_by_kernels
from offpiste.dynamics.kernels.autograd import has_kernels
from offpiste.dynamics.kernels.parity import APART, largest_difference
from offpiste.native.cuda_kernels import Kernels, cuda_kernels

logger = logging.getLogger(__name__)

_prepared: WeakKeyDictionary[Dynamics, dict[torch.device, Kernels]] = WeakKeyDictionary()
"""Kernels that were compiled for a model and checked with it: a training asks for them at each batch."""


def gpu_kernels(dynamics: Dynamics, device: torch.device, dtype: torch.dtype) -> Kernels | None:
    """Kernels for `rollout_by_kernels` of a model; None where it is not on a GPU, or not for kernels.

    Raises:
        OffpisteError: the GPU computes something else than the eager model.
    """
    if device.type != "cuda" or dtype != torch.float32 or not has_kernels(dynamics):
        return None
    if not (is_installed("cuda") and is_installed("cuda.core")):
        _say_that_kernels_are_missing()
        return None
    return prepared(dynamics, device, cuda_kernels)


def prepared(dynamics: Dynamics, device: torch.device, compiled: Callable[[str, torch.device], Kernels]) -> Kernels:
    """Kernels of a model on a device; text, code and check are made once for each.

    Args:
        compiled: makes kernels of a text.

    Raises:
        OffpisteError: they compute something else than the eager model.
    """
    by_device = _prepared.setdefault(dynamics, {})
    if device not in by_device:
        kernels = compiled(recorded_text(dynamics), device)
        check_kernels(kernels, dynamics, device)
        by_device[device] = kernels
    return by_device[device]


@cache
def _say_that_kernels_are_missing() -> None:
    logger.warning(f"without the extra `cuda` the GPU steps models eagerly, which is slow; {installation_of('cuda')}")


def check_kernels(kernels: Kernels, dynamics: Dynamics, device: torch.device) -> None:
    """Compare states, and their gradients by start, codes and what learns, with the eager model's, on random input.

    The kernels' text has no weights in it, so that they are compared with weights of their own.

    Raises:
        OffpisteError: they differ.
    """
    apart = largest_difference(dynamics, partial(rollout_by_kernels, kernels), device, gradients=True)
    if not apart < APART:
        what = f"rollouts on {device} differ from the eager model's, by {apart:.1e}"
        raise OffpisteError(what, how="use --device cpu, and report GPU, driver and this line")
