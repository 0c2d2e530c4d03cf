"""Two hosts on one machine: network namespaces that a virtual cable joins, each with addresses of its own.

Needs the rights to make them (root, or CAP_NET_ADMIN); `available()` says whether they are there.
"""

import os
import shutil
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

PORT = 29517


def available() -> bool:
    """Whether network namespaces can be made here."""
    if shutil.which("ip") is None:
        return False
    name = f"offpiste-{os.getpid()}"
    made = subprocess.run(["ip", "netns", "add", name], capture_output=True, check=False).returncode == 0
    subprocess.run(["ip", "netns", "del", name], capture_output=True, check=False)
    return made


@contextmanager
def hosts() -> Iterator[tuple[str, str]]:
    """Names of two namespaces; the first has the address 10.77.0.1, the second 10.77.0.2."""
    names = (f"offpiste-{os.getpid()}-a", f"offpiste-{os.getpid()}-b")
    try:
        for name in names:
            _ip("netns", "add", name)
        _ip("link", "add", "cable-a", "netns", names[0], "type", "veth", "peer", "name", "cable-b", "netns", names[1])
        for number, (name, end) in enumerate(zip(names, "ab", strict=True), 1):
            _ip("-n", name, "addr", "add", f"10.77.0.{number}/24", "dev", f"cable-{end}")
            _ip("-n", name, "link", "set", f"cable-{end}", "up")
            _ip("-n", name, "link", "set", "lo", "up")
        yield names
    finally:
        for name in names:
            subprocess.run(["ip", "netns", "del", name], capture_output=True, check=False)


def start(names: tuple[str, str], arguments: list[str], log: Path) -> list["subprocess.Popen[str]"]:
    """`torchrun` of a command of offpiste on both hosts; what they print goes to LOG.0 and LOG.1."""
    processes = []
    for rank, (name, end) in enumerate(zip(names, "ab", strict=True)):
        run = ["--nnodes", "2", "--nproc-per-node", "1", "--node-rank", str(rank)]
        run += ["--master-addr", "10.77.0.1", "--master-port", str(PORT)]
        command = ["ip", "netns", "exec", name, sys.executable, "-m", "torch.distributed.run", *run, "-m", "offpiste"]
        environment = {**os.environ, "GLOO_SOCKET_IFNAME": f"cable-{end}", "OMP_NUM_THREADS": "1"}
        with Path(f"{log}.{rank}").open("w") as file:
            processes.append(
                subprocess.Popen([*command, *arguments], stdout=file, stderr=file, text=True, env=environment)
            )
    return processes


def trains_on(name: str) -> int:
    """Number of the process on a host that trains."""
    there = subprocess.run(["ip", "netns", "pids", name], capture_output=True, text=True, check=True).stdout.split()
    started = [(int(p), Path(f"/proc/{p}/cmdline").read_bytes().split(b"\0")) for p in there]
    return next(number for number, words in started if b"torch.distributed.run" not in words)


def _ip(*arguments: str) -> None:
    subprocess.run(["ip", *arguments], check=True, capture_output=True)
