"""Training on several processes or GPUs: each computes a share of every batch, and all take the same step."""

import os
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import timedelta

import numpy as np
import torch
import torch.distributed as dist
from torch import Tensor

from offpiste.core.errors import OffpisteError, RunError

TIMEOUT = timedelta(minutes=30)
"""Longest time that processes wait for each other, e.g. while one reads a large file."""


@dataclass(frozen=True)
class Group:
    """Processes of a training: rank of this one, from 0, and number of all."""

    rank: int = 0
    size: int = 1

    @property
    def writes(self) -> bool:
        """Whether this process writes files and prints."""
        return self.rank == 0

    def share(self, count: int) -> slice:
        """Return this process's slice of `count` items."""
        edges = np.linspace(0, count, self.size + 1).round().astype(int)
        return slice(int(edges[self.rank]), int(edges[self.rank + 1]))

    def sum(self, value: Tensor) -> Tensor:
        """Return the sum of a value over all processes."""
        if self.size > 1:
            value = value.detach().clone()
            with _with_the_others():
                dist.all_reduce(value)
        return value

    def sum_gradients(self, parameters: Iterable[Tensor]) -> None:
        """Sum gradients over all processes; missing ones count as zero."""
        if self.size == 1:
            return
        summed = list(parameters)
        flat = self.sum(torch.cat([(torch.zeros_like(p) if p.grad is None else p.grad).flatten() for p in summed]))
        for parameter, part in zip(summed, flat.split([p.numel() for p in summed]), strict=True):
            parameter.grad = part.view_as(parameter).clone()

    def together(self, error: OffpisteError | None) -> None:
        """Wait for all processes, and raise in all of them the error of the first, if any."""
        if self.size > 1:
            message = [error]
            with _with_the_others():
                dist.broadcast_object_list(message, src=0)
            error = message[0]
        if error is not None:
            raise error


ALONE = Group()


@contextmanager
def joined(device: str) -> Iterator[Group]:
    """Join the group of processes of `torchrun`: by gloo on the CPU, by NCCL with the GPU of each local rank.

    Raises:
        RunError: not started by `torchrun`, or another process was lost.
    """
    if not {"RANK", "WORLD_SIZE", "MASTER_ADDR"} <= set(os.environ):
        how = "start it as `torchrun --nproc-per-node 2 -m offpiste train ... --ddp`"
        raise RunError("--ddp needs several processes", how=how)
    on_gpu = device.startswith("cuda")
    if on_gpu:
        torch.cuda.set_device(int(os.environ.get("LOCAL_RANK", "0")))
    with _with_the_others():
        dist.init_process_group("nccl" if on_gpu else "gloo", timeout=TIMEOUT)
    try:
        yield Group(dist.get_rank(), dist.get_world_size())
    finally:
        dist.destroy_process_group()


@contextmanager
def _with_the_others() -> Iterator[None]:
    """Turn the backend's error about a lost process into one line."""
    try:
        yield
    except RuntimeError as error:
        how = "see its messages, then start all processes again with --resume"
        raise RunError("another process of this training was lost, or cannot be reached", how=how) from error
