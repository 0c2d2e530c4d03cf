"""A table of how the processes of a drive are, twice a second: for plots and for reports."""

import csv
import logging
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from offpiste.core.errors import LiveError

logger = logging.getLogger(__name__)


class StatusTable:
    """Writes a row for each process: time, name, level, state and numbers.

    Raises:
        LiveError: the file cannot be written.
    """

    COLUMNS = (
        "cpu_s", "rss_mb", "tick_p50_ms", "tick_p99_ms", "map_age_p99_ms", "plan_age_p99_ms", "plan_ms", "map_ms",
        "extract_ms", "speed_mps", "progress_m", "restarts", "dropped",
    )  # fmt: skip

    def __init__(self, path: Path | None) -> None:
        try:
            self._file = None if path is None else path.open("w", newline="", encoding="utf-8")
        except OSError as error:
            how = "give another name"
            raise LiveError(f"cannot be written: {error.strerror}", where=str(path), how=how) from error
        if self._file is not None:
            csv.writer(self._file).writerow(("time", "part", "level", "state", *self.COLUMNS))

    def __enter__(self) -> "StatusTable":
        return self

    def __exit__(self, *_: object) -> None:
        if self._file is not None:
            self._file.close()

    def add(self, time: float, parts: Mapping[str, tuple[int, str, Mapping[str, Any]]]) -> None:
        """Add a row for each process."""
        if self._file is None:
            return
        try:
            self._add(time, parts)
        except OSError as error:  # a full disk ends the table, not the drive
            logger.warning(f"{self._file.name} is not written any more: {error.strerror}")
            self._file = None

    def _add(self, time: float, parts: Mapping[str, tuple[int, str, Mapping[str, Any]]]) -> None:
        assert self._file is not None
        for name, (level, state, numbers) in parts.items():
            given = dict(numbers) | {"dropped": sum(dict(numbers.get("dropped", {})).values())}
            cells = [given.get(column, "") for column in self.COLUMNS]
            rounded = [f"{cell:.3f}" if isinstance(cell, float) else cell for cell in cells]
            csv.writer(self._file).writerow((f"{time:.2f}", name, level, state, *rounded))
        self._file.flush()
