"""Text tables of any dialect: encodings, headers, separators, units, cells, and .vbo files of Racelogic."""

import codecs
import csv
import io
import re
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Final

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.csv as pa_csv
from jaxtyping import Float

from offpiste.core.errors import LogError
from offpiste.core.limits import packaged_table
from offpiste.logs.log import as_log_error
from offpiste.rig.labels import unit_of, without_comment

_TEXT_BOOLEANS = {"true": 1.0, "false": 0.0}
_MOST_PREAMBLE, _ROWS_BELOW = 64, 8
"""Largest number of lines before the header, and number of rows below it by which it is recognised."""
_MOST_COLUMNS: Final = 10_000
_BEGIN: Final = 4096
"""Number of bytes by which a kind of text is recognised."""
_SAMPLE: Final = 1 << 20
"""Number of bytes in which a text is searched for rows of numbers."""
_NOTHING: Final = [*pa_csv.ConvertOptions().null_values, "-", "--"]
"""Empty cells, including dashes of loggers."""
_SEPARATORS = ",;\t|"
_MOST_GEARS = 16
"""Largest number of distinct gears; a column with more numbers holds measurements, and a letter in it is a mistake."""
_UTF_16: Final = (codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)
"""Byte order marks of UTF-16, as spreadsheets write it."""
_MINUTES: Final = {"lat": 1 / 60, "long": -1 / 60}
"""Degrees per minute of arc; longitudes count to the west."""
_DAY: Final = 86_400.0
_TABLES: Final = packaged_table(__package__, "tables.toml")
_GEARS: Final = {word: letter for letter, words in _TABLES["gears"].items() for word in words}
PATTERNS: Final = {name: re.compile(text, re.IGNORECASE) for name, text in _TABLES["patterns"].items()}
"""Patterns of names and cells (see tables.toml)."""


def number_of(cell: str) -> float | None:
    """Return the number in a cell, 1 and 0 for true and false; None for other text."""
    if "_" in cell:
        return None  # Python reads 1_5 as 15
    try:
        return float(cell)
    except ValueError:
        return _TEXT_BOOLEANS.get(cell.strip().lower())


def gear_of(cell: str) -> float | None:
    """Return the number of a gear, or the character code of its letter, also for a word; None for other words."""
    number = number_of(cell)
    letter = cell if len(cell) == 1 and cell.isalpha() else _GEARS.get(cell.lower())
    return float(ord(letter)) if number is None and letter else number


def are_gears(cells: pa.ChunkedArray) -> bool:
    """Return whether cells are letters or words of gears, possibly with numbers of gears, some repeated."""
    cells = cells.drop_null()
    there = pc.unique(pc.utf8_trim_whitespace(cells)).to_pylist() if len(cells) else []
    letters = {gear_of(cell) for cell in there if number_of(cell) is None}
    numbers = sum(number_of(cell) is not None for cell in there)
    mixed = numbers <= _MOST_GEARS and letters <= set(map(float, b"PRND"))
    return bool(letters) and None not in letters and len(there) < len(cells) and (not numbers or mixed)


def unknown_words(cells: pa.ChunkedArray) -> list[str]:
    """Return the unknown words in a column of gears; none in other columns."""
    there = pc.unique(pc.utf8_trim_whitespace(cells.drop_null())).to_pylist()
    words = [cell for cell in there if cell and number_of(cell) is None] if len(there) <= _MOST_GEARS else []
    is_of_gears = not set(map(float, b"PRND")).isdisjoint(map(gear_of, words))
    return [word for word in words if is_of_gears and gear_of(word) is None]


def read_csv(path: Path, notes: list[str], units: dict[str, str]) -> tuple[pa.Table, int]:
    """Read all columns as text, from which types and invalid cells are determined later.

    Args:
        notes: guesses are added to it.
        units: filled from a row of units below the header.

    Returns:
        the table, and the number of rows between its header and its data (units and descriptions).
    """
    text = _text(path, notes)
    lines = _first_lines(text, path)
    there = [line for line in lines if line.strip()]
    spaces = _are_numbers(there[-1 if len(there) < 3 else -2], " ")
    lines = [" ".join(line.split()) for line in there] if spaces else lines
    lines = [without_comment(line) for line in lines]
    above = _lines_above_header(_cells(lines, " " if spaces else max(_SEPARATORS, key=lines[-1].count), path))
    if above:
        notes.append(f"{above} lines before the header are left out")
    header, *rows = lines[above:]
    delimiter = " " if spaces else _separator(header, rows[0])
    comma = delimiter == ";" and any(re.search(r"(^|;)\s*-?\d+,\d+\s*(;|$)", row) for row in rows)
    if delimiter != ",":
        decimals = ", decimals by ','" if comma else ""
        notes.append(f"columns are separated by '{delimiter}'{decimals}".replace("\t", "tab").replace("' '", "spaces"))
    names = [name.strip() for name in _cells([header], delimiter, path)[0]]
    if 2 * sum(number_of(name) is not None for name in names) > len(names):
        example = _TABLES["examples"].get(str(len(names)), _TABLES["examples"]["5"])
        how = f"write the names of the columns into the first line, such as {delimiter.join(example)}"
        raise LogError(f"no header line above {len(names)} columns of numbers", where=path, how=how)
    if spaces:
        names = _as_many_as_cells(names, header, rows[0], path)
    below = [*_cells(rows[:2], delimiter, path), [], []]
    own = _row_of_units(names, below[0])
    words = below[1] if own and all(number_of(cell) is None for cell in below[1]) else []
    between = bool(own) + any(words)
    if len(set(names)) < len(names):  # descriptions tell columns of one name apart
        pairs = zip(names, [*words, *[""] * len(names)], strict=False)
        names = [f"{name} ({word})" if word and name in names[:k] else name for k, (name, word) in enumerate(pairs)]
    check_columns(path, names)
    units |= {name: unit for name, unit in zip(names, own, strict=False) if unit}
    text = _in_one_space(text) if spaces else text
    as_text = pa_csv.ConvertOptions(
        column_types=dict.fromkeys(names, pa.string()), strings_can_be_null=True, null_values=_NOTHING
    )
    dialect = pa_csv.ParseOptions(delimiter=delimiter, invalid_row_handler=lambda row: _skip_or_error(row, text, notes))
    reading = pa_csv.ReadOptions(use_threads=False, column_names=names, skip_rows=above + 1 + between)
    try:
        table = pa_csv.read_csv(pa.BufferReader(text), reading, dialect, as_text)
    except pa.ArrowException as error:
        raise LogError(str(error), where=path, how="fix that line") from error
    if table.num_rows == 0:
        raise LogError("no row below the header", where=path, how="record or export it again")
    if comma:
        table = pa.table([pc.replace_substring(column, ",", ".") for column in table.columns], names=names)
    return _without_units(table, units), between


def _without_units(table: pa.Table, units: dict[str, str]) -> pa.Table:
    """Remove a common unit behind the numbers of a column, `0.05 sec`, and add it to `units`."""
    for at, name in enumerate(table.column_names):
        cells = table[name].drop_null().slice(0, 100).to_pylist()
        behind = {match[1] if (match := PATTERNS["with_unit"].fullmatch(cell)) else "" for cell in cells}
        if len(behind) == 1 and (unit := unit_of(spelled := behind.pop())):
            numbers = pc.replace_substring_regex(table[name], rf"\s*{re.escape(spelled)}\s*$", "")
            table = table.set_column(at, name, numbers)
            units.setdefault(name, unit)
    return table


def _row_of_units(names: Sequence[str], cells: Sequence[str]) -> list[str]:
    """Return the unit of each column ("" if unknown) if the row below the header holds units; empty for data.

    A row of units has no number but 1 (no unit), and at least half of its non-empty cells are units.
    """
    said = [cell for cell in cells if cell.strip()]
    units = [unit_of(cell) for cell in said]
    is_data = len(cells) != len(names) or any(number_of(cell) is not None and cell.strip() != "1" for cell in said)
    if is_data or not any(units) or 2 * sum(unit is not None for unit in units) < len(said):
        return []
    return [unit_of(cell) or "" for cell in cells]


def _are_numbers(line: str, separators: str) -> bool:
    """Return whether a line has several cells between these separators, most of which are numbers."""
    if any(other in line for other in _SEPARATORS if other not in separators):
        return False
    cells = re.split(f"[{re.escape(separators)}]+", PATTERNS["date_and_time"].sub("0", line.strip()))
    return len(cells) > 1 and 2 * sum(number_of(cell) is not None for cell in cells) > len(cells)


def has_numbers(path: Path) -> bool:
    """Return whether one of the first lines of a text is a row of numbers."""
    try:
        return any(_are_numbers(line, f" {_SEPARATORS}") for line in _first_lines(_text(path, [], _SAMPLE), path))
    except LogError:
        return False


def _separator(header: str, row: str) -> str:
    """Return the separator that is the most frequent in both lines, or else in the header, outside of quotes."""
    unquoted, below = (re.sub('"[^"]*"', "", line) for line in (header, row))
    return max(_SEPARATORS, key=lambda one: (min(unquoted.count(one), below.count(one)), unquoted.count(one)))


def _as_many_as_cells(names: list[str], header: str, row: str, path: Path) -> list[str]:
    """Return the names above columns separated by spaces, which may have another separator.

    Two names above the date and the time of a stamp become one.
    """
    cells, parts = PATTERNS["date_and_time"].sub(r"\1T\2", row).split(), row.split()
    if len(names) == len(parts) == len(cells) + 1:
        at = next(at for at, (cell, part) in enumerate(zip(cells, parts, strict=False)) if cell != part)
        return [*names[:at], " ".join(names[at : at + 2]), *names[at + 2 :]]
    others = [name.strip() for name in re.split(f"[{_SEPARATORS}]", header)]
    if len(others) == len(cells):
        return others
    if len(names) != len(cells):
        what = f"{len(names)} names above {len(cells)} columns separated by spaces"
        raise LogError(what, where=path, how="give each column one name without spaces in it")
    return names


def _cells(lines: Sequence[str], delimiter: str, path: Path) -> list[list[str]]:
    with as_log_error(path, "not a table", "export it again"):
        return list(csv.reader(lines, delimiter=delimiter))


def _lines_above_header(table: Sequence[Sequence[str]]) -> int:
    """Return the number of lines before the header.

    All cells of a header are text, and different unless units follow. All rows below it have as many cells and, except
    for units and descriptions, a number.
    """
    rows = [[cell.strip() for cell in cells] for cells in table]
    for above, names in enumerate(rows):
        below = [cells for cells in rows[above + 1 :] if any(cells)]
        if len(names) < 2 or not all(names) or any(number_of(name) is not None for name in names):
            continue
        numbers = [any(number_of(cell) is not None for cell in cells) for cells in below]
        words = 2 if below and _row_of_units(names, below[0]) else 1
        if words == 1 and len(set(names)) < len(names):
            continue
        if any(numbers) and all(numbers[words:]) and all(len(cells) == len(names) for cells in below[:-1]):
            return above  # the last row may be cut
    return 0


def _skip_or_error(row: pa_csv.InvalidRow, text: bytes, notes: list[str]) -> str:
    """Skip a truncated last row; other rows with too few or too many cells are errors."""
    content = row.text.strip("\r\n").encode()
    end = text[-len(content) - 8 :].strip(b"\r\n")
    if row.actual_columns > row.expected_columns or not end.endswith(b"\n" + content):
        return "error"
    notes.append(f"the last row is cut off after {row.actual_columns} cells, and left out")
    return "skip"


def _text(path: Path, notes: list[str], size: int = -1) -> bytes:
    """Read the first `size` bytes of a table as UTF-8, from UTF-8, UTF-16, cp1252 (with a note) or a .vbo file."""
    try:
        with path.open("rb") as file:
            read = file.read(size)
    except OSError as error:
        raise LogError(f"cannot be opened: {error.strerror}", where=path) from error
    is_racelogic = b"[column names]" in read[:_BEGIN]
    try:
        if read.startswith(_UTF_16):
            text = read.decode("utf-16", "replace")
        else:
            text = codecs.getincrementaldecoder("utf-8-sig")().decode(read)  # without a character cut at the end
    except UnicodeDecodeError:
        if not is_racelogic:
            notes.append("the text is not UTF-8, and read as cp1252; where names look wrong, save it as UTF-8")
        try:
            text = read.decode("cp1252")
        except UnicodeDecodeError as error:
            raise LogError("the text is neither UTF-8 nor cp1252", where=path, how="save it as UTF-8") from error
    return ((_of_racelogic(text) if is_racelogic else None) or text).encode()


def _first_lines(content: bytes, path: Path) -> list[str]:
    """Return the first lines; the last one may be truncated."""
    file = io.BytesIO(content)
    lines = [line for _ in range(_MOST_PREAMBLE + _ROWS_BELOW) if (line := file.readline(1 << 20))] or [b""]
    if not lines[0].strip():
        raise LogError("the file is empty, or begins with an empty line", where=path, how="record or export it again")
    text = [line.decode("utf-8-sig", "replace").rstrip("\r\n") for line in lines]
    if "\0" in text[0]:
        raise LogError("not a text file", where=path, how="save it as UTF-8 text with a header line")
    if len(lines) < 2:
        raise LogError("no row below the header", where=path, how="record or export it again")
    return text


def check_columns(path: Path, names: list[str]) -> None:
    """Refuse a table without columns, with too many, or with two of one name."""
    if len(names) > _MOST_COLUMNS:
        raise LogError(f"{len(names)} columns", where=path, how=f"export at most {_MOST_COLUMNS}")
    repeated = sorted(name for name, count in Counter(names).items() if count > 1)
    if repeated:
        raise LogError(f"column '{repeated[0]}' appears twice", where=path, how="give every column its own name")
    if not names:
        raise LogError("no column of numbers", where=path, how="export the quantities as numbers")


def clock_times(cells: pa.ChunkedArray) -> Float[np.ndarray, " n"] | None:
    """Convert times of day, such as `05/03/2024 1:02:03.4 PM`, to seconds from midnight; None for other cells.

    Each new date is the next day. Without dates, steps of more than half a day cross midnight.
    """
    times = np.full(len(cells), np.nan)
    days: dict[str, int] = {}
    for row, cell in enumerate(cells.to_pylist()):
        if cell is None or not cell.strip():
            continue
        match = PATTERNS["clock"].fullmatch(cell.strip()) or PATTERNS["compact"].fullmatch(cell.strip())
        if match is None:
            return None
        hours, date = int(match["hours"]), match["date"] or ""
        if half := (match["half"] or "").lower():
            hours = hours % 12 + (12 if half == "p" else 0)
        seconds = float(re.sub("[,:]", ".", match["seconds"]))
        times[row] = _DAY * days.setdefault(date, len(days)) + 3600 * hours + 60 * int(match["minutes"]) + seconds
    return _past_midnight(times) if len(days) == 1 else times


def _past_midnight(times: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
    """Unwrap seconds of the day; a step of more than half a day crosses midnight."""
    known, result = np.isfinite(times), times.copy()
    result[known] = np.unwrap(times[known], period=_DAY)
    return result


def without_clock_face(stamps: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
    """Return stamps, those with the digits HHMMSS.sss as seconds from midnight: each minute skips 60 to 99."""
    known = stamps[np.isfinite(stamps)]
    seconds, minutes, hours = known % 100, known // 100 % 100, known // 10_000
    if len(known) < 2 or hours.min() < 0 or hours.max() >= 24 or seconds.max() >= 60 or minutes.max() >= 60:
        return stamps
    steps, turns = np.diff(known), np.diff(known // 100) != 0
    usual = float(np.median(steps))
    if not turns.any() or usual <= 0 or abs(float(np.median(steps[turns] % 100)) - 40 - usual) >= 2 * usual:
        return stamps
    result = np.full(len(stamps), np.nan)
    result[np.isfinite(stamps)] = 3600 * hours + 60 * minutes + seconds
    return _past_midnight(result)


def _in_one_space(text: bytes) -> bytes:
    """Reduce separators to single spaces, and remove spaces within stamps."""
    lines = (" ".join(line.split()) for line in text.decode().split("\n"))
    return "\n".join(PATTERNS["date_and_time"].sub(r"\1T\2", line) for line in lines if line).encode()


def _of_racelogic(text: str) -> str | None:
    """Convert a .vbo file of Racelogic, whose sections hold names, units and rows."""
    parts = PATTERNS["section"].split(text)
    sections = dict(zip(parts[1::2], parts[2::2], strict=True))
    if not {"column names", "data"} <= set(sections):
        return None
    names = sections["column names"].split()
    units = [line.strip() for line in sections.get("channel units", "").splitlines() if line.strip()]
    # Files list the units of all columns, or of the last columns only.
    known = {name: f"{name} ({unit})" for name, unit in zip(reversed(names), reversed(units), strict=False)}
    known = {name: label.removesuffix(" ((null))") for name, label in known.items()}
    lines = [[_TABLES["racelogic"].get(name.lower()) or known.get(name, name) for name in names]]
    factors = {place: _MINUTES[name.lower()] for place, name in enumerate(names) if name.lower() in _MINUTES}
    for line in filter(str.strip, sections["data"].splitlines()):
        cells = line.split()
        for place, factor in factors.items():  # invalid or excess cells are left to the reader of tables
            if place < len(cells) and (minutes := number_of(cells[place])) is not None:
                cells[place] = repr(factor * minutes)
        lines.append(cells)
    return "\n".join(map(",".join, lines)) + "\n"
