"""Folders of tables that are one drive: a table a topic, as bags and the logs of autopilots are exported."""

import re
from collections.abc import Sequence
from itertools import takewhile
from pathlib import Path
from typing import Final

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from offpiste.core.errors import LogError, NoClock
from offpiste.logs.formats.table import TableLog
from offpiste.logs.log import LOG_FORMATS, Log, Samples, Topic
from offpiste.rig.channels import Clock

_TABLES: Final = (".csv", ".tsv", ".parquet")
_GPS_TIME: Final = re.compile(r"(?<![a-z])((gps|gnss)?i?tow|gps_?(time|tow|seconds?)|seconds?_of_week)", re.IGNORECASE)
"""What stamps in seconds of a GPS week are called."""
_AGAIN: Final = 8
"""Most tables of one drive whose columns are those of another one."""
_BEGINS: Final = 1.0
"""Before this time stamps are counted from a table's own beginning [s]."""
_BAGS: Final = (".bag", ".mcap", ".db3")
"""Beside one of these, tables are but what was exported of it."""


@LOG_FORMATS.register("tables")
class TablesLog(Log):
    """A drive whose topics are the tables of a folder, named after their files but for what all names begin with.

    A folder in which most tables have the same columns as another one is no log: they are drives of their own. Few that
    do are sensors of one kind.

    Args:
        path: folder.
        clock: of each table that has its column; other tables' clocks are guessed.
    """

    description = "a folder of tables of one drive"
    has_clock_unit = True

    def __init__(self, path: Path, *, clock: Clock | None = None) -> None:
        self.path = path
        opened, without = dict[str, Log](), dict[str, NoClock]()
        for file in _tables_in(path):
            try:
                opened[file.stem if file.stem not in opened else file.name] = _opened(file, clock or Clock())
            except NoClock as error:
                without[file.name] = error
        if len(opened) < 2:
            raise next(iter(without.values()))
        start = len(_beginning([*opened]))
        self._tables = {name[start:]: log for name, log in opened.items()}
        _refuse_apart(self._tables, path)
        _refuse_alike(self._tables, path)
        left_out = [f"{name} has no column of stamps: it is left out" for name in without]
        self.warnings = (*dict.fromkeys(note for log in self._tables.values() for note in log.warnings), *left_out)

    @staticmethod
    def recognises(path: Path) -> bool:
        """Whether a folder holds tables of several kinds of columns, few of a kind that another has, and no bag."""
        if not path.is_dir() or any(file.suffix.lower() in _BAGS for file in path.iterdir()):
            return False
        kinds, again = set[str](), 0
        for file in _tables_in(path):
            columns = _columns(file)
            again += columns in kinds
            if not columns or again > _AGAIN:  # at once: a folder may hold a table a scan
                return False
            kinds.add(columns)
        return len(kinds) > again + 1

    @classmethod
    def open(cls, path: Path, clock: Clock) -> Log:
        """A drive whose stamps are those of the clock's column, in each table that has one."""
        return cls(path, clock=clock)

    @property
    def topics(self) -> dict[str, Topic]:
        """One topic a table."""
        tables = {name: log.topics[""] for name, log in self._tables.items()}
        return {
            name: Topic(name, of.type, of.count, of.fields, of.units, unread=of.unread) for name, of in tables.items()
        }

    @property
    def clock(self) -> Clock:
        """The column of stamps and its unit, where all tables have the same."""
        clocks = {log.clock for log in self._tables.values()}
        return clocks.pop() if len(clocks) == 1 else Clock()

    def _read(self, topic: Topic, fields: Sequence[str], stamps: str) -> Samples:
        return self._tables[topic.name].read("", fields)


def _tables_in(folder: Path) -> list[Path]:
    files = (file for file in folder.iterdir() if file.suffix.lower() in _TABLES and not file.name.startswith("."))
    return sorted(file for file in files if file.is_file())


def _opened(file: Path, clock: Clock) -> Log:
    """A table; a clock's column that it lacks is guessed."""
    try:
        return TableLog.open(file, clock)
    except NoClock:
        if not clock.column:
            raise
    return TableLog.open(file, Clock())


def _columns(file: Path) -> str:
    """What names the columns of a table; empty where nothing does."""
    try:
        if file.suffix.lower() == ".parquet":
            return ",".join(pq.read_schema(file).names)
        with file.open(encoding="utf-8", errors="replace") as lines:
            return next((line.strip() for line in lines if any(letter.isalpha() for letter in line)), "")
    except (OSError, pa.ArrowException):
        return ""


def _beginning(names: Sequence[str]) -> str:
    """What all names begin with, up to a mark between words."""
    alike = zip(*names, strict=False)
    shared = names[0][: sum(1 for _ in takewhile(lambda letters: len(set(letters)) == 1, alike))]
    return shared[: max(shared.rfind(mark) for mark in "_-. ") + 1]


def _refuse_apart(tables: dict[str, Log], path: Path) -> None:
    """Raise where a table was recorded before or after that of most rows."""
    stamps = {name: log.stamps("") for name, log in tables.items() if log.topics[""].fields}
    known = {name: time[np.isfinite(time)] for name, time in stamps.items() if np.isfinite(time).any()}
    longest = max(known, key=lambda name: len(known[name]), default="")
    for name, time in known.items():
        if time.max() < known[longest].min() or time.min() > known[longest].max():
            how = "give one of them, or put the stamps of all on one clock"
            if any(map(_GPS_TIME.search, (tables[each].clock.column for each in (name, longest)))):
                how += " (GPS time is 604800 s a week since 1980-01-06, 315964800 s since 1970, and 18 s ahead of UTC)"
            spans = (f"'{each}' ({known[each].min():.1f} to {known[each].max():.1f} s)" for each in (name, longest))
            raise LogError(f"tables {' and '.join(spans)} were not recorded at the same time", where=path, how=how)


def _refuse_alike(tables: dict[str, Log], path: Path) -> None:
    """Raise where two tables with the same fields count their stamps from their own beginnings."""
    seen = dict[tuple[str, ...], str]()
    for name, log in tables.items():
        stamps = log.stamps("")
        if not np.isfinite(stamps).any() or np.nanmin(stamps) > _BEGINS:
            continue
        other = seen.setdefault(log.topics[""].fields, name)
        if other != name:
            how = "give one of them if they are drives of their own, or put the stamps of all on one clock"
            raise LogError(f"tables '{other}' and '{name}' have the same columns, and both begin at 0 s",
                           where=path, how=how)  # fmt: skip
