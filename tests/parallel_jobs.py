"""Jobs for tests of `offpiste.core.parallel`, which worker processes must be able to import."""

import os
import time
from collections.abc import Callable

from offpiste.core.errors import LogError


def square(job: int, report: Callable[[float], None]) -> str:
    """Says the square; refuses negative numbers, and 13 kills its process."""
    report(0.5)
    if job < 0:
        raise LogError(f"{job} is negative", where="here", how="give another")
    if job == 13:
        os._exit(1)
    time.sleep(0.01)
    return str(job * job)


def wait(job: int, report: Callable[[float], None]) -> str:
    """Prints its process, and goes on for a minute."""
    print(os.getpid(), flush=True)
    time.sleep(60)
    return ""


def variable(job: str, report: Callable[[float], None]) -> str:
    """Says a variable of the environment."""
    return f"{job}={os.environ.get(job)}"
