"""What the stages of the run time cost by the wall clock; nothing is decided by it."""

import time
from collections import defaultdict
from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np


class Stopwatch:
    """Collects times of named stages."""

    def __init__(self) -> None:
        self._taken: defaultdict[str, list[float]] = defaultdict(list)

    @contextmanager
    def of(self, stage: str) -> Iterator[None]:
        """Measure what is done within."""
        began = time.perf_counter()
        try:
            yield
        finally:
            self._taken[stage].append(time.perf_counter() - began)

    def summary(self) -> dict[str, dict[str, float]]:
        """For each stage: how often, the median and the 95th percentile [ms], and all of it [s]."""
        return {
            stage: {
                "count": float(len(taken)),
                "median_ms": 1e3 * float(np.median(taken)),
                "p95_ms": 1e3 * float(np.percentile(taken, 95)),
                "total_s": float(np.sum(taken)),
            }
            for stage, taken in self._taken.items()
        }
