"""Independent jobs in local processes or on a Ray cluster, with one progress bar.

Jobs write their own results, so all nodes of a cluster must share a file system.
"""

import logging
import multiprocessing
import os
import re
import signal
import socket
import threading
from collections.abc import Callable, Generator, Iterator, MutableSequence, Sequence
from concurrent.futures import FIRST_COMPLETED, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import closing, contextmanager
from functools import partial
from typing import Any, Final, Generic, NamedTuple, TypeVar

from offpiste.core.errors import OffpisteError, extra
from offpiste.core.machine import usable_cores
from offpiste.core.progress import jobs_bar

logger = logging.getLogger(__name__)

Job = TypeVar("Job")
Result = TypeVar("Result")
Report = Callable[[float], None]
"""Receives the completed share of a job, from 0 to 1."""

Work = Callable[[Job, Report], Result]
"""Runs a job, reports its completed share, and returns its result."""

Ended = Generator[tuple[int, Result | OffpisteError], None, None]
"""Number and result or error of each job, in order of completion."""

POLL: Final = 0.3
"""Update interval of the progress bar [s]."""
RETRIES: Final = 4
"""Largest number of restarts of a job on a cluster whose worker or node was lost."""
MEMORY: Final = 2 * 2**30
"""Memory that a cluster node reserves for a job [bytes]; extracting a drive needs less."""


class Outcome(NamedTuple, Generic[Result]):
    """Results and errors of jobs, in the order of the jobs."""

    results: list[Result]
    failed: list[OffpisteError]

    def checked(self) -> list[Result]:
        """Return the results, or raise the first error."""
        if self.failed:
            raise self.failed[0]
        return self.results


def run_all(
    work: Work[Job, Result],
    jobs: Sequence[Job],
    processes: int,
    description: str,
    *,
    cluster: str = "",
    finished: Callable[[Result], None] = logger.info,
) -> Outcome[Result]:
    """Run all jobs, even if some of them fail.

    Args:
        work: function of a module that workers can import.
        processes: largest number of jobs at a time; 1 runs them in this process.
        cluster: Ray cluster to run on instead: "auto", or HOST:PORT of its head.
        finished: called with the result of each job.

    Raises:
        OffpisteError: the extra `ray` is not installed, or no cluster answers there.
    """
    ended: dict[int, Result | OffpisteError] = {}
    processes = min(processes, len(jobs))
    with jobs_bar(len(jobs), description) as update:
        outcomes: Ended[Result]
        if cluster:
            outcomes = _on_cluster(cluster, work, jobs)
        elif processes > 1:
            outcomes = _side_by_side(processes, work, jobs, update)
        else:
            outcomes = ((number, _attempt(work, job, partial(update, number))) for number, job in enumerate(jobs))
        with closing(outcomes):
            for number, result in outcomes:
                update(number, 1.0)
                ended[number] = result
                if not isinstance(result, OffpisteError):
                    finished(result)
                elif len(jobs) > 1:
                    logger.warning(f"failed: {result}")
    ordered = [ended[number] for number in range(len(jobs))]
    return Outcome(
        [result for result in ordered if not isinstance(result, OffpisteError)],
        [result for result in ordered if isinstance(result, OffpisteError)],
    )


def _attempt(work: Work[Job, Result], job: Job, report: Report) -> Result | OffpisteError:
    try:
        return work(job, report)
    except OffpisteError as error:
        return error


def _side_by_side(
    processes: int, work: Work[Job, Result], jobs: Sequence[Job], update: Callable[[int, float], None]
) -> Ended[Result]:
    can_fork = "forkserver" in multiprocessing.get_all_start_methods()
    context = multiprocessing.get_context("forkserver" if can_fork else "spawn")
    if can_fork:
        context.set_forkserver_preload([getattr(work, "func", work).__module__])
    shares = context.RawArray("d", len(jobs))
    started = (usable_cores() // processes, dict(os.environ), shares)
    pool = ProcessPoolExecutor(processes, context, _start_worker, started)
    try:
        numbers = {pool.submit(_attempt, work, job, partial(_share, number)): number for number, job in enumerate(jobs)}
        waiting = {*numbers}
        while waiting:
            done, waiting = wait(waiting, POLL, FIRST_COMPLETED)
            for future in waiting:
                update(numbers[future], shares[numbers[future]])
            for future in done:
                try:
                    yield numbers[future], future.result()
                except BrokenProcessPool:
                    what = "a process was killed, perhaps because of too little memory"
                    yield numbers[future], OffpisteError(what, how="use fewer --processes; finished drives are kept")
    except BaseException:
        pool.shutdown(wait=False, cancel_futures=True)
        for child in multiprocessing.active_children():
            child.terminate()
        raise
    pool.shutdown()


_shares: MutableSequence[float] = []
"""Completed share of each job, in memory that a worker shares with the parent."""


def _share(number: int, share: float) -> None:
    _shares[number] = share


def _start_worker(threads: int, environment: dict[str, str], shares: MutableSequence[float]) -> None:
    """Prepare a worker process: share memory with the parent, take its environment, end with it, ignore Ctrl-C."""
    global _shares
    import torch

    _shares = shares
    os.environ.update(environment)  # the fork server has that of its own start
    threading.Thread(target=_end_with_parent, daemon=True).start()
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    torch.set_num_threads(max(1, threads))


def _end_with_parent() -> None:
    parent = multiprocessing.parent_process()
    assert parent is not None
    parent.join()
    os._exit(1)


def _on_cluster(address: str, work: Work[Job, Result], jobs: Sequence[Job]) -> Ended[Result]:
    with _connected(address) as ray:
        largest = max((node["Resources"].get("memory", 0) for node in ray.nodes() if node["Alive"]), default=0)
        task = ray.remote(num_cpus=1, memory=int(min(MEMORY, largest)), max_retries=RETRIES)(_attempt)
        waiting = {task.remote(work, job, _unreported): number for number, job in enumerate(jobs)}
        try:
            while waiting:
                for reference in ray.wait([*waiting])[0]:
                    yield waiting.pop(reference), _result_of(ray, reference)
        finally:
            for reference in waiting:
                ray.cancel(reference, force=True)


def _unreported(share: float) -> None:
    """Do not report the share of a job on a cluster, where only finished jobs are counted."""


def _result_of(ray: Any, reference: Any) -> Any:
    try:
        return ray.get(reference)
    except ray.exceptions.RayTaskError:
        raise  # a bug in offpiste
    except ray.exceptions.RayError as error:
        lost = f"its worker or its node was lost {RETRIES + 1} times ({type(error).__name__})"
        how = "see Ray's logs for the reason, e.g. too little memory; finished drives are kept"
        return OffpisteError(lost, how=how)


@contextmanager
def _connected(address: str) -> Iterator[Any]:
    """Give Ray, connected to a cluster; an existing connection is reused and kept."""
    os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")
    with extra("ray"):
        import ray
    if ray.is_initialized():
        yield ray
        return
    host, _, port = address.removeprefix("ray://").rpartition(":")
    try:
        if host:  # Ray would wait a minute for it
            socket.create_connection((host, int(port)), timeout=5.0).close()
        connection = ray.init(address=address, log_to_driver=False, logging_level=logging.ERROR)
    except (OSError, ValueError, RuntimeError) as error:
        how = "start one with `ray start --head`, or give HOST:PORT of its head"
        raise OffpisteError("no Ray cluster answers", where=f"--cluster {address}", how=how) from error
    with connection:
        yield ray


def at_a_time(processes: int, device: str = "cpu") -> int:
    """Return the number of processes: for 0, one per core on the CPU and one on a GPU; `OffpisteError` if negative."""
    if processes < 0:
        raise OffpisteError(f"invalid --processes {processes}", how="give 1 or more, or 0 for one per core")
    return processes or (usable_cores() if device == "cpu" else 1)


def parse_shard(text: str) -> tuple[int, int]:
    """Parse "K/N" with K from 1 to N; raises `OffpisteError` for another form."""
    found = re.fullmatch(r"([0-9]+)/([0-9]+)", text)
    if not found or not 1 <= int(found[1]) <= int(found[2]):
        raise OffpisteError(f"'{text}' is not a shard", where="--shard", how="give K/N with K from 1 to N, e.g. 2/4")
    return int(found[1]), int(found[2])
