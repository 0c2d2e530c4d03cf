"""Extraction on a Ray cluster of three nodes, whose workers and nodes can be killed."""

import os
import random
import shutil
import signal
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any
from unittest import mock

from offpiste.core.errors import DatasetError
from offpiste.dataset.store import drive_names
from offpiste.inspection.extract import extract
from offpiste.rig.rig import load_rig
from shared_drives import blind_drives

BROKEN, NODES = ("drive-03", "drive-07"), 3
STORE = 80 * 2**20
"""Memory of a node's objects [bytes]."""


def write_logs(folder: Path, drives: int) -> list[Path]:
    """Write the logs of drives, two of which are broken."""
    logs, made = [folder / f"drive-{number:02}.mcap" for number in range(drives)], blind_drives(folder)
    for number, log in enumerate(logs):
        shutil.copyfile(made[number % 3], log)
        if log.stem in BROKEN:
            log.write_bytes(b"no log" * 100)
    return logs


def extracted(logs: list[Path], out: Path, cluster: str = "") -> str:
    """Extract the logs, and return the error about failed ones."""
    try:
        extract(logs, load_rig("proving_ground"), out, processes=1, cluster=cluster, force=True)
    except DatasetError as error:
        return str(error)
    return ""


def content(path: Path) -> dict[str, bytes]:
    """Content of all files of a folder."""
    return {str(file.relative_to(path)): file.read_bytes() for file in sorted(path.rglob("*")) if file.is_file()}


@contextmanager
def nodes() -> Iterator[Any]:
    """Three nodes on this machine that can import the modules of the tests."""
    found = [str(Path(__file__).parent), *filter(None, [os.environ.get("PYTHONPATH")])]
    with mock.patch.dict(os.environ, {"RAY_USAGE_STATS_ENABLED": "0", "PYTHONPATH": os.pathsep.join(found)}):
        from ray.cluster_utils import Cluster

        settings = {"num_cpus": 1, "object_store_memory": STORE, "memory": 2**30}
        cluster = Cluster(initialize_head=True, head_node_args={**settings, "include_dashboard": False})
        try:
            for _ in range(NODES - 1):
                cluster.add_node(**settings)
            yield cluster
        finally:
            cluster.shutdown()


def kill_worker(cluster: Any, generator: random.Random) -> None:
    """Kill a worker process."""
    while not (workers := _workers()):
        time.sleep(0.1)
    with suppress(ProcessLookupError):
        os.kill(generator.choice(workers), signal.SIGKILL)


def kill_node(cluster: Any, generator: random.Random) -> None:
    """Kill a node other than the head and that of this process."""
    import ray

    mine = ray.get_runtime_context().get_node_id()
    others = [node for node in cluster.worker_nodes if node.node_id != mine]
    cluster.remove_node(generator.choice(others), allow_graceful=False)


def _workers() -> list[int]:
    found = []
    for process in Path("/proc").iterdir():
        with suppress(OSError):
            if process.name.isdigit() and b"ray::_attempt" in (process / "cmdline").read_bytes():
                found.append(int(process.name))
    return found


@contextmanager
def killing(
    kills: list[Callable[[Any, random.Random], None]], cluster: Any, out: Path, seed: int, drives: int
) -> Iterator[list[str]]:
    """Kill workers and nodes at random times of an extraction; yields the names of what was killed."""
    generator, over, done = random.Random(seed), threading.Event(), []

    def work() -> None:
        for number, kill in enumerate(kills):
            at = (number + generator.random()) * (drives - len(BROKEN) - 2) / len(kills)
            while not over.wait(0.1) and (not out.exists() or len(drive_names(out)) < at):
                pass
            if over.is_set():
                return
            kill(cluster, generator)
            done.append(kill.__name__)

    thread = threading.Thread(target=work)
    thread.start()
    try:
        yield done
    finally:
        over.set()
        thread.join()
