"""What made a result: when, where, by which command and with which versions."""

import os
import platform
import shlex
import sys
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path

import torch

from offpiste.evaluation.results import Provenance


def provenance(command: str, seed: int, device: torch.device | str) -> Provenance:
    """Of this moment and this machine.

    Args:
        command: as typed; empty: this process's own.
        seed: of the resampling.
        device: that models ran on.
    """
    names = ("offpiste", "torch", "numpy", "scipy")
    return Provenance(
        date=datetime.now(UTC).isoformat(timespec="seconds"),
        command=command or shlex.join([Path(sys.argv[0]).name, *sys.argv[1:]]),
        machine=f"{_processor()}, {os.cpu_count()} cores, {platform.system()}; models ran on {_device(device)}",
        versions={"python": platform.python_version(), **{name: version(name) for name in names}},
        seed=seed,
    )


def _device(device: torch.device | str) -> str:
    device = torch.device(device)
    return torch.cuda.get_device_name(device) if device.type == "cuda" else device.type


def _processor() -> str:
    """The processor's name where the system tells it, else its architecture."""
    try:
        lines = Path("/proc/cpuinfo").read_text("utf-8").splitlines()
    except OSError:
        return platform.processor() or platform.machine()
    names = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    return names[0] if names else platform.machine()
