"""Independent jobs as tasks of a Ray cluster, with the contract of `parallel.run_all`.

Jobs write what they make themselves, whole or not at all, so all nodes have to see the same files. A task whose worker
or node is lost is done again by another; one whose job fails is not.
"""

import logging
import os
import socket
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from functools import partial
from typing import Any, Final

from offpiste.core.errors import OffpisteError, extra
from offpiste.core.parallel import POLL, Engine, Job, Work
from offpiste.core.progress import jobs_bar

RETRIES: Final = 4
"""Times that a job is begun again after its worker or its node was lost."""
MEMORY: Final = 2 * 2**30
"""Memory that a node sets aside for a job, as far as it has as much [bytes]: a drive is extracted in less."""
_PORT: Final = 6379
_ANSWERS_WITHIN: Final = 5.0
"""Time in which a cluster has to answer [s]."""
_EVERY: Final = 0.5
"""Least time between two reports of one job [s]."""


def engine_at(address: str) -> Engine | None:
    """The engine of `run_all` that a cluster is; None for no address: processes of this machine."""
    return partial(run_on_cluster, address) if address else None


def run_on_cluster(
    address: str, work: Work[Job], jobs: Sequence[Job], description: str
) -> Iterator[str | OffpisteError]:
    """Do all jobs on the nodes of a cluster; results come in the order in which jobs end.

    Args:
        address: "auto" for the cluster that this machine belongs to, or HOST:PORT of its head.
        work: a function of a module that all nodes can import.

    Raises:
        OffpisteError: the extra `ray` is not installed, or no cluster answers there.
    """
    with _connected(address) as ray, jobs_bar(len(jobs), description) as update:
        # Progress is kept where it is shown: the node may not be lost before this process is.
        here = ray.util.scheduling_strategies.NodeAffinitySchedulingStrategy(
            ray.get_runtime_context().get_node_id(), soft=True
        )
        shares = ray.remote(num_cpus=0)(_Shares).options(scheduling_strategy=here).remote()
        task = ray.remote(num_cpus=1, memory=_memory(ray), max_retries=RETRIES)(_reporting)
        waiting = {task.remote(work, job, number, shares): number for number, job in enumerate(jobs)}
        try:
            while waiting:
                done, _ = ray.wait([*waiting], num_returns=len(waiting), timeout=POLL)
                with suppress(ray.exceptions.RayActorError):  # no reason to stop
                    for number, share in ray.get(shares.taken.remote()).items():
                        update(number, share)
                for result in done:
                    update(waiting.pop(result), 1.0)
                    yield _result(ray, result)
        finally:
            for left in waiting:
                ray.cancel(left, force=True)


class _Shares:
    """Shares of jobs that are done, from all nodes."""

    def __init__(self) -> None:
        self._new: dict[int, float] = {}

    def put(self, number: int, share: float) -> None:
        """Keep the newest share of a job."""
        self._new[number] = share

    def taken(self) -> dict[int, float]:
        """What came since the last call."""
        new, self._new = self._new, {}
        return new


def _reporting(work: Work[Job], job: Job, number: int, shares: Any) -> str | OffpisteError:
    last = 0.0

    def report(share: float) -> None:
        nonlocal last
        if time.monotonic() - last >= _EVERY:
            last = time.monotonic()
            shares.put.remote(number, share)

    try:
        return work(job, report)
    except OffpisteError as error:
        return error


def _result(ray: Any, task: Any) -> str | OffpisteError:
    try:
        return ray.get(task)  # type: ignore[no-any-return]
    except ray.exceptions.RayTaskError:
        raise  # a defect of ours, with its traceback
    except ray.exceptions.RayError as error:
        lost = f"its worker or its node was lost {RETRIES + 1} times ({type(error).__name__})"
        return OffpisteError(lost, how="look at Ray's logs for why, e.g. want of memory; finished drives are kept")


@contextmanager
def _connected(address: str) -> Iterator[Any]:
    """Ray, connected to a cluster; a connection that was there before stays."""
    os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")
    with extra("ray"):
        import ray
        import ray.util.scheduling_strategies
    if ray.is_initialized():
        yield ray
        return
    how = "start one with `ray start --head`, or give HOST:PORT of its head"
    if address != "auto":
        _refuse_silent(address, how)
    try:
        ray.init(address=address, log_to_driver=False, logging_level=logging.ERROR)
    except (ConnectionError, ValueError, RuntimeError) as error:
        raise OffpisteError("no Ray cluster answers", where=f"--cluster {address}", how=how) from error
    try:
        yield ray
    finally:
        ray.shutdown()


def _refuse_silent(address: str, how: str) -> None:
    """Raise if nothing listens at an address: Ray would wait for a minute."""
    host, _, port = address.removeprefix("ray://").rpartition(":")
    try:
        socket.create_connection((host or address, int(port) if host else _PORT), timeout=_ANSWERS_WITHIN).close()
    except (OSError, ValueError) as error:
        raise OffpisteError("no Ray cluster answers", where=f"--cluster {address}", how=how) from error


def _memory(ray: Any) -> int:
    """What a job asks for: no more than the largest node has, or it would wait for ever."""
    largest = max((node["Resources"].get("memory", 0) for node in ray.nodes() if node["Alive"]), default=0)
    return int(min(MEMORY, largest))
