"""Kernels and times for gpu.py, whose stages are gpu_planning.py and gpu_training.py."""

import statistics
import time
from collections.abc import Callable
from typing import Any

import torch

from offpiste.native.cuda_kernels import Kernels, cuda_kernels

Row = dict[str, Any]


def open_kernels(text: str, device: torch.device) -> Kernels:
    """Compile kernels for a GPU."""
    if device.type != "cuda":
        raise SystemExit("this stage needs an NVIDIA GPU")
    return cuda_kernels(text, device)


def timed(what: str, run: Callable[[], Any], device: torch.device, turns: int) -> Row:
    """Median and best time of a function [ms], the device's work included."""
    taken = []
    for turn in range(turns + 2):
        before = time.perf_counter()
        run()
        if device.type == "cuda":
            torch.cuda.synchronize(device)
        if turn >= 2:
            taken.append(1e3 * (time.perf_counter() - before))
    return {"what": what, "median": statistics.median(taken), "best": min(taken)}


def by_events(what: str, run: Callable[[], Any], turns: int) -> Row:
    """Median and best time of a function between two events on the GPU [ms], without the way there and back."""
    taken = []
    for _ in range(turns + 2):
        began, ended = (torch.cuda.Event(enable_timing=True) for _ in range(2))
        began.record()
        run()
        ended.record()
        torch.cuda.synchronize()
        taken.append(began.elapsed_time(ended))
    return {"what": what, "median": statistics.median(taken[2:]), "best": min(taken[2:])}
