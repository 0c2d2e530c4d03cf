"""Independent jobs in processes of their own, with one progress bar over all of them."""

import logging
import multiprocessing
import os
import signal
import sys
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager, suppress
from functools import partial
from multiprocessing.context import BaseContext
from pathlib import Path, PurePosixPath
from queue import Empty
from typing import Any, Final, TypeVar

from offpiste.core.errors import OffpisteError
from offpiste.core.progress import jobs_bar

logger = logging.getLogger(__name__)

Job = TypeVar("Job")
Report = Callable[[float], None]
"""Takes the share of a job that is done, from 0 to 1."""

Work = Callable[[Job, Report], str]
"""Does a job, reports the share that is done, and returns its result in one line."""

Engine = Callable[[Work[Any], Sequence[Any], str], Iterator[str | OffpisteError]]
"""Does all jobs under a description, and gives the result or the error of each as it ends."""

_CGROUP_2: Final = ("sys/fs/cgroup", "memory.max", "memory.current", "inactive_file")
_CGROUP_1: Final = ("sys/fs/cgroup/memory", "memory.limit_in_bytes", "memory.usage_in_bytes", "total_inactive_file")
"""Where Linux keeps the limits of a group of processes, and the files of a group: limit, use, and caches in it."""
_SPARE: Final = 5e8
"""Memory that is left to others [bytes]."""
POLL = 0.3
"""Interval at which the bar is updated [s]."""


def usable_cores() -> int:
    """Number of cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def free_memory(root: Path = Path("/")) -> int:
    """Memory that this process and its children can still have [bytes]: what the machine has, and its container.

    Memory that holds files for now counts as free, where the system says how much that is.

    Args:
        root: of /proc and /sys.
    """
    free = os.sysconf("SC_AVPHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    with suppress(OSError):
        for line in root.joinpath("proc/meminfo").read_text("ascii").splitlines():
            if line.startswith("MemAvailable:"):
                free = 1024 * int(line.split()[1])
    with suppress(OSError):
        for line in root.joinpath("proc/self/cgroup").read_text("utf-8").splitlines():
            number, controllers, group = line.split(":", 2)
            place, *names = _CGROUP_2 if number == "0" else _CGROUP_1
            if number == "0" or "memory" in controllers.split(","):
                groups = [root / place / part.lstrip("/") for part in (group, *map(str, PurePosixPath(group).parents))]
                free = min(free, *(_left_in(folder, *names) for folder in groups))
    return free


def _left_in(folder: Path, limit: str, used: str, cached: str) -> int:
    """Memory left in a group of processes [bytes]; endless where it has no limit."""
    try:
        most = int((folder / limit).read_text("ascii"))
        held = int((folder / used).read_text("ascii"))
        lines = (line.split() for line in (folder / "memory.stat").read_text("ascii").splitlines())
        return max(0, most - held + sum(int(size) for name, size in lines if name == cached))
    except (OSError, ValueError):  # none there, or "max"
        return sys.maxsize


def within_memory(processes: int, each: float) -> int:
    """As many processes as are wanted, or as have room in memory, at least one; says so if these are fewer.

    Args:
        each: memory that one takes [bytes].
    """
    free = free_memory()
    fitting = max(1, int((free - _SPARE) / max(each, 1.0)))
    if fitting < processes:
        room = f"{free / 1e9:.1f} GB of memory are free, and each takes {each / 1e9:.1f} GB"
        logger.warning(f"{fitting} of {processes} processes at a time: {room}")
    return min(processes, fitting)


def at_a_time(processes: int, device: str = "cpu") -> int:
    """Number of processes to start: as many as asked for; 0: one a core, or one where they would share an accelerator.

    Args:
        device: that each computes on.

    Raises:
        OffpisteError: a number below 0.
    """
    if processes < 0:
        raise OffpisteError(f"--processes is {processes}", how="give 1 or more, or 0 for one a core")
    return processes or (usable_cores() if device == "cpu" else 1)


def parse_shard(text: str) -> tuple[int, int]:
    """K and N of "K/N".

    Raises:
        OffpisteError: not two whole numbers, K from 1 to N.
    """
    number, _, count = text.partition("/")
    if not (number.isascii() and number.isdecimal() and count.isascii() and count.isdecimal()) or not (
        1 <= int(number) <= int(count)
    ):
        raise OffpisteError(f"'{text}' is no shard", where="--shard", how="give K/N with K from 1 to N, as 2/4")
    return int(number), int(count)


def run_all(
    work: Work[Job],
    jobs: Sequence[Job],
    processes: int,
    description: str,
    *,
    engine: Engine | None = None,
    finished: Callable[[str], None] = logger.info,
) -> list[OffpisteError]:
    """Do all jobs; those that remain even if one fails.

    Args:
        work: a function of a module, so that processes can import it.
        processes: jobs at a time, at most; 1 works in this process.
        engine: does the jobs elsewhere (`cluster.engine_at`); None: processes of this machine do.
        finished: called with the result of each job.

    Returns:
        The errors of jobs that failed.

    Raises:
        ValueError: processes could not import the work: it stands in the `__main__.py` of a package.
    """
    if _module_of(work) == "__main__" and _main_cannot_be_imported():
        name = _function_of(work).__name__
        raise ValueError(f"put {name} in a module of its own: processes do not import __main__.py")
    failed = []
    for result in (engine or partial(_on_this_machine, processes))(work, jobs, description):
        if isinstance(result, str):
            finished(result)
            continue
        failed.append(result)
        if len(jobs) > 1:
            logger.warning(f"failed: {result}")
    return failed


def _on_this_machine(
    processes: int, work: Work[Job], jobs: Sequence[Job], description: str
) -> Iterator[str | OffpisteError]:
    count = min(processes, len(jobs))
    return _one_by_one(work, jobs, description) if count <= 1 else _side_by_side(work, jobs, count, description)


def _one_by_one(work: Work[Job], jobs: Sequence[Job], description: str) -> Iterator[str | OffpisteError]:
    with jobs_bar(len(jobs), description) as update:
        for number, job in enumerate(jobs):
            try:
                result: str | OffpisteError = work(job, partial(update, number))
            except OffpisteError as error:
                result = error
            update(number, 1.0)
            yield result


def _side_by_side(
    work: Work[Job], jobs: Sequence[Job], processes: int, description: str
) -> Iterator[str | OffpisteError]:
    with _pool(processes, work) as (pool, queue), jobs_bar(len(jobs), description) as update:
        numbers = {pool.submit(_reporting, work, job, number, queue): number for number, job in enumerate(jobs)}
        waiting: set[Future[str | OffpisteError]] = set(numbers)
        while waiting:
            done, waiting = wait(waiting, timeout=POLL, return_when=FIRST_COMPLETED)
            for number, share in _drained(queue):
                update(number, share)
            for future in done:
                update(numbers[future], 1.0)
                yield _result(future)


@contextmanager
def _pool(processes: int, work: Work[Job]) -> Iterator[tuple[ProcessPoolExecutor, Any]]:
    context = _context(work)
    with context.Manager() as manager:
        started = (processes, dict(os.environ))
        pool = ProcessPoolExecutor(processes, mp_context=context, initializer=_start_worker, initargs=started)
        try:
            yield pool, manager.Queue()
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            for child in multiprocessing.active_children():
                child.terminate()
            raise
        pool.shutdown()


def _context(work: Work[Job]) -> BaseContext:
    """Workers that begin with the modules of their work, imported once for all of them where the system can fork."""
    if "forkserver" not in multiprocessing.get_all_start_methods():
        return multiprocessing.get_context("spawn")
    context = multiprocessing.get_context("forkserver")
    module = _module_of(work)
    if module != "__main__":  # a script under `python -m` has another name in the workers
        context.set_forkserver_preload([module])  # of no effect once the server runs
    return context


def _function_of(work: Work[Job]) -> Work[Job]:
    while isinstance(work, partial):
        work = work.func
    return work


def _module_of(work: Work[Job]) -> str:
    return _function_of(work).__module__


def _main_cannot_be_imported() -> bool:
    """Whether this program is the `__main__.py` of a package, which `multiprocessing` leaves out."""
    spec = sys.modules["__main__"].__spec__
    return spec is not None and (spec.name == "__main__" or spec.name.endswith(".__main__"))


def _start_worker(processes: int, environment: dict[str, str]) -> None:
    """Leave Ctrl-C to the parent process, and the other cores to the other workers.

    Args:
        environment: the parent's, which a server that forks workers knows only as it was when it started.
    """
    import torch

    os.environ.update(environment)
    threading.Thread(target=_end_with_parent, daemon=True).start()
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    torch.set_num_threads(max(1, usable_cores() // processes))


def _end_with_parent() -> None:
    """Exit once the parent is gone: a parent that is killed cannot end its workers."""
    parent = multiprocessing.parent_process()
    assert parent is not None
    parent.join()
    os._exit(1)


def _reporting(work: Work[Job], job: Job, number: int, queue: Any) -> str | OffpisteError:
    try:
        return work(job, lambda share: queue.put((number, share)))
    except OffpisteError as error:
        return error


def _result(future: "Future[str | OffpisteError]") -> str | OffpisteError:
    try:
        return future.result()
    except BrokenProcessPool:
        return OffpisteError(
            "a process was killed, perhaps for want of memory", how="use fewer --processes; finished drives are kept"
        )


def _drained(queue: Any) -> Iterator[tuple[int, float]]:
    while True:
        try:
            yield queue.get_nowait()
        except Empty:
            return
