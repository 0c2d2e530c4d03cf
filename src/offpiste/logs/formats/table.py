"""Tables with a row per sample and a column per quantity, and folders of tables of one drive."""

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace
from itertools import takewhile
from pathlib import Path
from typing import Final

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq
from jaxtyping import Float

from offpiste.core.errors import LogError, NoClock
from offpiste.core.limits import LARGEST_TABLE, refuse_larger
from offpiste.logs.formats.csv_text import (
    PATTERNS,
    are_gears,
    check_columns,
    clock_times,
    gear_of,
    has_numbers,
    number_of,
    read_csv,
    unknown_words,
    without_clock_face,
)
from offpiste.logs.log import LOG_FORMATS, Log, Samples, Topic, as_log_error
from offpiste.rig.channels import SECONDS_PER_UNIT, Clock
from offpiste.rig.labels import parse_label, unit_by_rate, without_comment

_SPLIT: Final = "export fewer columns, or the drive in parts"
_NO_TIME = 1e20
"""Limit of stamps in any unit: nanoseconds since 1970 are below 1e19."""
_EVENLY = 0.2
"""Largest relative spread (5 to 95 %) of the steps of an unnamed clock."""

_TABLES: Final = (".csv", ".tsv", ".parquet")
_AGAIN: Final = 8
"""Largest number of tables in a drive with the columns of another one."""
_BAGS: Final = (".bag", ".mcap", ".db3")
"""Extensions of bags, beside which tables are exports."""


@LOG_FORMATS.register("table")
class TableLog(Log):
    """Table with one topic, named "", whose fields are columns of numbers, booleans and, in Parquet, dates [s].

    Separators of text are guessed (comma, semicolon, tab, bar, spaces). A header may be a comment (`#`, `%`, `//`) with
    a row of units below. Empty cells are NaN; other cells without a number are errors once their column is read. Text
    columns are not fields, but dates and times can be stamps, and letters or words of gears are character codes.

    Args:
        path: text, or `.parquet`.
        clock: column of stamps, guessed if "" from the names and how steadily they increase; and their unit, if "" (or
            by default) the header's, or else guessed from the rate.
    """

    description = "a table (.csv, .tsv, .txt, .vbo, .parquet)"
    has_clock_unit = True

    def __init__(self, path: Path, *, clock: Clock | None = None) -> None:
        self.path, given = path, clock or Clock()
        self._is_csv = path.suffix.lower() != ".parquet"
        notes: list[str] = []
        self._units: dict[str, str] = {}
        self._dates: dict[str, Float[np.ndarray, " n"] | None] = {}
        read = read_csv(path, notes, self._units) if self._is_csv else (_read_parquet(path), 0)
        self._table, self._rows_of_units = read
        names = self._table.column_names
        self._columns = tuple(name for name in names if self._is_numeric(name))
        if not self._is_csv:
            check_columns(path, list(self._columns))
        self._units |= {name: unit for name in names if (unit := parse_label(name).unit)}
        self._unit: str = "" if not given.column and given.unit == Clock().unit else given.unit
        column = given.column if given.column in names else without_comment(given.column)  # as a rig may name it
        self._clock, listed = column or self._guess_clock(notes), ", ".join(names[:40])
        if not self._clock:
            how = f"name it: `inspect --time COLUMN`, or clock.column in a rig; available: {listed}"
            raise NoClock("no column looks like time", where=path, how=how)
        if self._clock not in names:
            raise NoClock(f"no column '{given.column}' for the clock", where=path, how=f"available: {listed}")
        is_guessed, self._unit = not self._unit, self._unit_of_stamps(self._clock) or self._unit_by_rate()
        if is_guessed and self.clock.unit != "s":
            notes.append(f"'{self._clock}' is read in {self.clock.unit}; clock.unit in the rig can say otherwise")
        self._unread = {name: self._why_unread(name) for name in names if name not in self._columns}
        notes.extend(f"{why}: it is left out" for name, why in self._unread.items() if unknown_words(self._table[name]))
        self.warnings = tuple(notes)

    @staticmethod
    def recognises(path: Path) -> bool:
        """Return whether a file has a table's extension; `.txt` files also need rows of numbers."""
        ending = path.suffix.lower() if path.is_file() else ""
        return ending in (".csv", ".tsv", ".vbo", ".parquet") or (ending == ".txt" and has_numbers(path))

    @property
    def topics(self) -> dict[str, Topic]:
        """The table as a single topic."""
        kind = "CSV table" if self._is_csv else "Parquet table"
        return {"": Topic("", kind, self._table.num_rows, self._columns, self._units, unread=self._unread)}

    @property
    def clock(self) -> Clock:
        """Column of stamps and its unit."""
        return Clock(column=self._clock, unit=self._unit_of_stamps(self._clock))  # type: ignore[arg-type]

    def _read(self, topic: Topic, fields: Sequence[str], stamps: str) -> Samples:
        values = np.empty((topic.count, len(fields)))
        for column, field in enumerate(fields):
            values[:, column] = self._numbers(field)
        return Samples(self._stamps(self._clock), values)

    def _is_numeric(self, name: str) -> bool:
        """Return whether most of the first cells are numbers; single bad cells do not make a column of text."""
        if not pa.types.is_string(self._table[name].type):
            return True  # others were not read
        cells = self._first_cells(name)
        return 2 * sum(number_of(cell) is not None for cell in cells) >= len(cells) or are_gears(self._table[name])

    def _why_unread(self, name: str) -> str:
        """Return the reason why a column of text is not a field."""
        if words := unknown_words(self._table[name]):
            return f"column '{name}' holds words of gears, among which '{words[0][:40]}' is not known"
        text = next((cell for cell in self._first_cells(name) if number_of(cell) is None), "")
        return f"column '{name}' holds text, such as '{text[:40]}', and no numbers"

    def _first_cells(self, name: str) -> list[str]:
        cells: list[str] = self._table[name].drop_null().slice(0, 100).to_pylist()
        return cells

    def _guess_clock(self, notes: list[str]) -> str:
        columns, named = self._table.column_names, PATTERNS["time_name"].search
        names = [name for name in columns if named(name) or named(parse_label(name).name)]
        names = names or [name for name in columns if _has_time_unit(self._table[name].type)]
        if seconds := [name for name in names if self._beside(name)]:
            names = seconds[:1]
        if not names and (even := [name for name in self._columns if self._rises_evenly(name)]):
            notes.append(f"'{even[0]}' is taken for time, by its even steps")
            return even[0]
        if len(names) < 2:
            return "".join(names)
        dated = {name for name in names if name in self._columns or _dates(self._table[name]) is not None}
        guess: str = max(names, key=lambda name: (self._share_rising(name), name in dated))
        notes.append(f"'{guess}' is taken for time, of {', '.join(names)}; clock.column in the rig can say otherwise")
        return guess

    def _beside(self, clock: str) -> str:
        """Return the column of nanoseconds beside one of whole seconds; "" for none."""
        whole = PATTERNS["whole_seconds"].match(clock)
        names = [] if whole is None else [whole[1] + after for after in ("nsec", "nsecs", "nanosec", "nanosecs")]
        return next((name for name in names if name in self._columns), "")

    def _rises_evenly(self, name: str) -> bool:
        """Return whether numbers increase like a clock, and not like a count of rows."""
        if self._table.num_rows < 10 or self._share_rising(name) < 0.99:
            return False
        steps = np.diff(self._numbers(name))
        low, middle, high = np.percentile(steps, (5, 50, 95))
        return bool(high - low < _EVENLY * middle and not (steps == 1).all())

    def _unit_of_stamps(self, name: str) -> str:
        """Return the given unit, or else the header's; "" if there is none."""
        unit = self._units.get(name, "")
        return self._unit or (unit if unit in SECONDS_PER_UNIT else "")

    def _unit_by_rate(self) -> str:
        stamps = self._stamps(self._clock)
        steps = np.diff(stamps)
        rate = 1 / float(np.median(steps[steps > 0])) if (steps > 0).any() else np.nan
        return unit_by_rate(rate, "s", float(np.nanmedian(stamps))) if np.isfinite(stamps).any() else "s"

    def _share_rising(self, name: str) -> float:
        try:
            return float(np.mean(np.diff(self._stamps(name)) > 0)) if self._table.num_rows > 1 else 0.0
        except LogError:
            return -1.0

    def _stamps(self, name: str) -> Float[np.ndarray, " n"]:
        """Return a column of stamps [s]; NaN for numbers too large to be a time."""
        column = self._table[name]
        if pa.types.is_string(column.type):
            if name not in self._dates:
                dates = _dates(column)
                self._dates[name] = clock_times(column) if dates is None else dates
            if (dates := self._dates[name]) is not None:
                return dates
            if not self._is_numeric(name):
                cells = enumerate(column.to_pylist(), 1 + self._rows_of_units)
                row, cell = next((r, c) for r, c in cells if c and clock_times(pa.chunked_array([[c]])) is None)
                what = f"row {row} below the header, column '{name}': '{cell[:40]}' is not a time"
                raise LogError(what, where=self.path, how="write seconds, or 2024-05-03T10:11:12.345")
        numbers = self._numbers(name)
        if nanoseconds := self._beside(name):
            return numbers + self._numbers(nanoseconds) / 1e9
        unit = "s" if _has_time_unit(column.type) else self._unit_of_stamps(name) or "s"
        return without_clock_face(np.where(np.abs(numbers) < _NO_TIME, numbers, np.nan) * SECONDS_PER_UNIT[unit])

    def _numbers(self, name: str) -> Float[np.ndarray, " n"]:
        column = self._table[name]
        if pa.types.is_string(column.type):
            return self._parsed(name)
        if _has_time_unit(column.type):
            return _floats(column.cast(pa.int64())) * SECONDS_PER_UNIT[column.type.unit]
        return _floats(column)

    def _parsed(self, name: str) -> Float[np.ndarray, " n"]:
        """Parse the cells of a text column as numbers."""
        column = pc.utf8_trim_whitespace(self._table[name])
        with suppress(pa.ArrowInvalid):
            return _floats(column)
        number = gear_of if are_gears(self._table[name]) else number_of
        values = [np.nan if cell is None else number(cell) for cell in column.to_pylist()]
        if None in values:
            row = values.index(None)
            where = f"row {row + 1 + self._rows_of_units} below the header, column '{name}'"
            what = f"{where}: '{column[row].as_py()[:40]}' is not a number"
            raise LogError(what, where=self.path, how="fix or empty that cell")
        return np.array(values, np.float64)


def _floats(column: pa.ChunkedArray) -> Float[np.ndarray, " n"]:
    values: np.ndarray = column.cast(pa.float64(), safe=False).to_numpy()
    return values


def _dates(column: pa.ChunkedArray) -> Float[np.ndarray, " n"] | None:
    """Convert ISO 8601 dates, by default in UTC, to seconds since 1970; None for other cells."""
    for kind in (pa.timestamp("ns"), pa.timestamp("ns", "UTC")):
        with suppress(pa.ArrowInvalid):
            return _floats(column.cast(kind).cast(pa.int64())) / 1e9
    return None


def _has_time_unit(kind: pa.DataType) -> bool:
    return bool(pa.types.is_timestamp(kind) or pa.types.is_duration(kind))


def _is_readable(kind: pa.DataType) -> bool:
    types = pa.types
    kinds = (types.is_integer, types.is_floating, types.is_boolean, types.is_decimal, _has_time_unit, _is_text)
    return any(is_kind(kind) for is_kind in kinds)


def _is_text(kind: pa.DataType) -> bool:
    words = kind.value_type if pa.types.is_dictionary(kind) else kind
    return bool(pa.types.is_string(words) or pa.types.is_large_string(words))


def _read_bounded(file: pq.ParquetFile, path: Path) -> pa.Table:
    """Read the usable columns group by group, within the memory limit."""
    names = [field.name for field in file.schema_arrow if _is_readable(field.type) or pa.types.is_struct(field.type)]
    groups = [file.metadata.row_group(number) for number in range(file.metadata.num_row_groups)]
    columns = [[group.column(number) for number in range(group.num_columns)] for group in groups]
    pages = sum(column.total_uncompressed_size for group in columns for column in group)
    widths = sum(any(f"{c.path_in_schema}.".startswith(f"{name}.") for name in names) for c in (columns or [[]])[0])
    size = max(pages, 8 * file.metadata.num_rows * widths)
    refuse_larger(size, "its columns", LARGEST_TABLE, where=path, how=_SPLIT)
    parts, size = [], 0
    for number in range(len(groups)):
        parts.append(file.read_row_group(number, columns=names))
        size += parts[-1].nbytes
        refuse_larger(size, "its columns", LARGEST_TABLE, where=path, how=_SPLIT)
    return pa.concat_tables(parts) if parts else file.read(columns=names)


def _read_parquet(path: Path) -> pa.Table:
    with as_log_error(path, "not a readable Parquet file", "export it again"):
        texts = [field.name for field in pq.read_schema(path) if _is_text(field.type)]
        with pq.ParquetFile(path, read_dictionary=texts) as file:
            table = _read_bounded(file, path)
            while any(pa.types.is_struct(field.type) for field in table.schema):
                table = table.flatten()  # pose: {x, y} becomes pose.x and pose.y
            kept = [number for number, field in enumerate(table.schema) if _is_readable(field.type)]
            table = table.select(kept)
            columns = table.column_names
    check_columns(path, columns)
    if not table.num_rows:
        raise LogError("the table has no rows", where=path, how="record or export it again")
    result = {}
    for name, column in zip(columns, table.columns, strict=True):
        if pa.types.is_dictionary(column.type):  # words are repeated when cast to text
            lengths = (pc.max(pc.binary_length(chunk.dictionary)).as_py() for chunk in column.chunks)
            longest = max(filter(None, lengths), default=0)
            refuse_larger(len(column) * longest, f"its column '{name}'", LARGEST_TABLE, where=path, how=_SPLIT)
        result[name] = column.cast(pa.string()) if _is_text(column.type) else column
    return pa.table(result)


@LOG_FORMATS.register("tables")
class TablesLog(Log):
    """Drive whose topics are the tables of a folder, as exported from bags and autopilots.

    Topics are the file names without their common beginning. A folder whose tables mostly have equal columns is not a
    drive but a collection of drives; a few tables with equal columns are sensors of one kind.

    Args:
        clock: clock of tables that have its column; others are guessed.
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
        left_out = [f"{name} has no column of stamps: it is left out" for name in without]
        self.warnings = (*dict.fromkeys(note for log in self._tables.values() for note in log.warnings), *left_out)

    @staticmethod
    def recognises(path: Path) -> bool:
        """Return whether a folder holds tables that mostly differ in their columns, and no bag."""
        if not path.is_dir() or any(file.suffix.lower() in _BAGS for file in path.iterdir()):
            return False
        kinds, again = set[str](), 0
        for file in _tables_in(path):
            columns = _columns(file)
            again += columns in kinds
            if not columns or again > _AGAIN:  # stop early: a folder may hold a table per scan
                return False
            kinds.add(columns)
        return len(kinds) > again + 1

    @property
    def topics(self) -> dict[str, Topic]:
        """Topics by name, one per table."""
        return {name: replace(log.topics[""], name=name) for name, log in self._tables.items()}

    @property
    def clock(self) -> Clock:
        """Column of stamps and its unit, if common to all tables."""
        clocks = {log.clock for log in self._tables.values()}
        return clocks.pop() if len(clocks) == 1 else Clock()

    def _read(self, topic: Topic, fields: Sequence[str], stamps: str) -> Samples:
        return self._tables[topic.name].read("", fields)


def _tables_in(folder: Path) -> list[Path]:
    files = (file for file in folder.iterdir() if file.suffix.lower() in _TABLES and not file.name.startswith("."))
    return sorted(file for file in files if file.is_file())


def _opened(file: Path, clock: Clock) -> Log:
    """Open a table; guess its clock if it lacks the given column."""
    with suppress(NoClock):
        return TableLog(file, clock=clock)
    return TableLog(file)


def _columns(file: Path) -> str:
    """Return the header of a table; "" if there is none."""
    try:
        if file.suffix.lower() == ".parquet":
            return ",".join(pq.read_schema(file).names)
        with file.open(encoding="utf-8", errors="replace") as lines:
            return next((line.strip() for line in lines if any(letter.isalpha() for letter in line)), "")
    except (OSError, pa.ArrowException):
        return ""


def _beginning(names: Sequence[str]) -> str:
    """Return the common beginning of names, up to a separator of words."""
    alike = zip(*names, strict=False)
    shared = names[0][: sum(1 for _ in takewhile(lambda letters: len(set(letters)) == 1, alike))]
    return shared[: max(shared.rfind(mark) for mark in "_-. ") + 1]


def _refuse_apart(tables: dict[str, Log], path: Path) -> None:
    """Refuse a table recorded before or after the one with most rows."""
    stamps = {name: log.stamps("") for name, log in tables.items() if log.topics[""].fields}
    known = {name: time[np.isfinite(time)] for name, time in stamps.items() if np.isfinite(time).any()}
    longest = max(known, key=lambda name: len(known[name]), default="")
    for name, time in known.items():
        if time.max() < known[longest].min() or time.min() > known[longest].max():
            how = "give one of them, or put the stamps of all on one clock"
            if any(map(PATTERNS["gps_time"].search, (tables[each].clock.column for each in (name, longest)))):
                how += " (GPS time is 604800 s a week since 1980-01-06, 315964800 s since 1970, and 18 s ahead of UTC)"
            spans = (f"'{each}' ({known[each].min():.1f} to {known[each].max():.1f} s)" for each in (name, longest))
            raise LogError(f"tables {' and '.join(spans)} were not recorded at the same time", where=path, how=how)
