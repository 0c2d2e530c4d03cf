"""Cores and memory available to this process."""

import logging
import os
import re
import sys
from contextlib import suppress
from pathlib import Path, PurePosixPath
from typing import Final

logger = logging.getLogger(__name__)

_SPARE: Final = 5e8
"""Memory to leave free [bytes]."""
_CGROUPS: Final = (
    (r"^0::(.*)$", "sys/fs/cgroup", "memory.max", "memory.current", "inactive_file"),
    (
        r"^\d+:(?:[\w,]+,)?memory(?:,[\w,]+)?:(.*)$", "sys/fs/cgroup/memory", "memory.limit_in_bytes",
        "memory.usage_in_bytes", "total_inactive_file",
    ),
)  # fmt: skip
"""Line, folder, limit, use and cached files of control groups of version 2 and of version 1."""


def usable_cores() -> int:
    """Return the number of cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def within_memory(processes: int, each: float) -> int:
    """Return how many of `processes`, of `each` [bytes], fit into free memory, at least 1; warn if not all do."""
    free = free_memory()
    fitting = max(1, int((free - _SPARE) / max(each, 1.0)))
    if fitting < processes:
        room = f"{free / 1e9:.1f} GB of memory are free, and each takes {each / 1e9:.1f} GB"
        logger.warning(f"{fitting} of {processes} processes at a time: {room}")
    return min(processes, fitting)


def free_memory(root: Path = Path("/")) -> int:
    """Return the memory still available from the machine and its container, file cache included [bytes].

    Args:
        root: parent of /proc and /sys.
    """
    free = os.sysconf("SC_AVPHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    with suppress(OSError):
        free = _number(root / "proc/meminfo", "MemAvailable:", free // 1024) * 1024
    with suppress(OSError):
        groups = root.joinpath("proc/self/cgroup").read_text("utf-8")
        for line, folder, limit, use, cached in _CGROUPS:
            found = re.search(line, groups, re.MULTILINE)
            for part in (PurePosixPath(found[1]), *PurePosixPath(found[1]).parents) if found else ():
                group = root / folder / str(part).lstrip("/")
                with suppress(OSError):
                    used = _number(group / use) - _number(group / "memory.stat", cached)
                    free = min(free, max(0, _number(group / limit) - used))
    return free


def _number(file: Path, name: str = "", otherwise: int = sys.maxsize) -> int:
    """Return the number after a name in a system file; `otherwise` if there is none, e.g. for the limit "max"."""
    found = re.search(rf"^{name}\s*(\d+)", file.read_text("ascii"), re.MULTILINE)
    return int(found[1]) if found else otherwise
