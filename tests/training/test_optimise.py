"""A training asks the system for memory once, not at every step."""

import ctypes
import subprocess
import sys

import pytest

FAULTS = """
import resource, sys
import torch
from offpiste.training.optimise import keep_freed_memory

if sys.argv[1] == "kept":
    keep_freed_memory()
for _ in range(3):
    torch.zeros(16 << 20).fill_(1)
before = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
for _ in range(5):
    torch.zeros(16 << 20).fill_(1)
print(resource.getrusage(resource.RUSAGE_SELF).ru_minflt - before)
"""


def page_faults(memory: str) -> int:
    """Of five blocks of 64 MiB, one after the other, in a process of its own."""
    command = [sys.executable, "-c", FAULTS, memory]
    return int(subprocess.run(command, capture_output=True, check=True, text=True).stdout)


@pytest.mark.skipif(not hasattr(ctypes.CDLL(None), "mallopt"), reason="the allocator is not glibc's")
def test_pages_of_freed_blocks_are_cleared_once() -> None:
    assert page_faults("kept") < page_faults("usual") / 4
