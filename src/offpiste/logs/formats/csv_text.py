"""The text of CSV files: their header, separator, units and cells."""

import csv
import io
import re
from collections import Counter
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Final

import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.csv as pa_csv

from offpiste.core.errors import LogError
from offpiste.logs.formats.loggers import DATE_AND_TIME, MARKS, UTF_16, in_one_space, is_utf_8, with_one_header
from offpiste.rig.labels import unit_of, without_comment

_TEXT_BOOLEANS = {"true": 1.0, "false": 0.0}
_MOST_PREAMBLE, _ROWS_BELOW = 64, 8
"""Lines before the header, at most; and rows below it by which it is known."""
_MOST_COLUMNS: Final = 10_000
_BEGIN: Final = 4096
"""Bytes that show what a text is."""
_NOTHING: Final = [*pa_csv.ConvertOptions().null_values, "-", "--"]
"""Cells that are empty: loggers write a dash as well."""
_SEPARATORS = ",;\t|"
_WITH_UNIT: Final = re.compile(r"\s*[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?\s*([^\d\s.+-].*?)\s*")
"""A number with its unit in one cell."""
_EXAMPLES = {5: ("t", "x", "y", "yaw", "steer"), 8: ("timestamp", "tx", "ty", "tz", "qx", "qy", "qz", "qw")}
"""Names for a table without any, by the number of its columns; eight are those of a trajectory in TUM's format."""
_MOST_GEARS = 16
"""Numbers among letters that are gears; more are measurements, and a letter among them is a mistake."""
_GEARS: Final = {
    word: letter
    for letter, words in (
        ("P", "park parking parked"),
        ("R", "reverse reversing backward backwards"),
        ("N", "neutral stop stopped standstill halt halted"),
        ("D", "drive forward forwards"),
    )
    for word in words.split()
}
"""Letters of gears, by what logs call these."""


def number_of(cell: str) -> float | None:
    """The number that a cell holds, 1 and 0 for true and false; None for other text."""
    if "_" in cell:
        return None  # Python reads 1_5 as 15
    try:
        return float(cell)
    except ValueError:
        return _TEXT_BOOLEANS.get(cell.strip().lower())


def gear_letter(word: str) -> str:
    """The letter of the gear that a word names, P, R, N or D; single letters as they are, and "" for other words."""
    return word if len(word) == 1 and word.isalpha() else _GEARS.get(word.lower(), "")


def gear_of(cell: str) -> float:
    """The number of a gear, or the character code of its letter (`gear_letter`)."""
    number = number_of(cell)
    return float(ord(gear_letter(cell))) if number is None else number


def are_gears(cells: pa.ChunkedArray) -> bool:
    """Whether cells are letters or words of gears, among which may be a gear's numbers, and some repeat."""
    cells = cells.drop_null()
    there = pc.unique(pc.utf8_trim_whitespace(cells)).to_pylist() if len(cells) else []
    letters = [gear_letter(cell) for cell in there if number_of(cell) is None]
    numbers = len(there) - len(letters)
    gears = not numbers or (numbers <= _MOST_GEARS and set(letters) <= set("PRND"))
    return len(letters) > 0 and len(there) < len(cells) and all(letters) and gears


def unknown_words(cells: pa.ChunkedArray) -> list[str]:
    """Words that are no gears in a column of few words, of which others are; none in one of any other text."""
    there = pc.unique(pc.utf8_trim_whitespace(cells.drop_null())).to_pylist()
    words = [cell for cell in there if cell and number_of(cell) is None] if len(there) <= _MOST_GEARS else []
    gears = {gear_letter(word) for word in words} & set("PRND")
    return [word for word in words if not gear_letter(word)] if gears else []


def read_csv(path: Path, notes: list[str], units: dict[str, str]) -> tuple[pa.Table, int]:
    """Read all columns as text; column types and invalid cells are determined from it later.

    Args:
        notes, units: filled with what was guessed, and with a row of units below the header.

    Returns:
        the table, and how many rows stand between its header and its data: units, and then words on each column.
    """
    lines = _first_lines(path)
    there = [line for line in lines if line.strip()]
    spaces = _are_numbers(there[-1 if len(there) < 3 else -2], " ")
    lines = [" ".join(line.split()) for line in there] if spaces else lines
    lines = [without_comment(line) for line in lines]
    above = _lines_above_header(_cells(lines, " " if spaces else max(_SEPARATORS, key=lines[-1].count), path))
    if above:
        notes.append(f"{above} lines before the header are left out")
    header, *rows = lines[above:]
    delimiter = " " if spaces else max(_SEPARATORS, key=re.sub('"[^"]*"', "", header).count)
    comma = delimiter == ";" and any(re.search(r"(^|;)\s*-?\d+,\d+\s*(;|$)", row) for row in rows)
    if delimiter != ",":
        decimals = ", decimals by ','" if comma else ""
        notes.append(f"columns are separated by '{delimiter}'{decimals}".replace("\t", "tab").replace("' '", "spaces"))
    names = [name.strip() for name in _cells([header], delimiter, path)[0]]
    if 2 * sum(number_of(name) is not None for name in names) > len(names):
        example = _EXAMPLES.get(len(names), _EXAMPLES[5])
        how = f"write the names of the columns into the first line, such as {delimiter.join(example)}"
        raise LogError(f"no header line above {len(names)} columns of numbers", where=path, how=how)
    if spaces:
        names = _as_many_as_cells(names, header, rows[0], path)
    check_columns(path, names)
    units |= _row_of_units(names, (_cells(rows[:1], delimiter, path) or [[]])[0])
    words = (_cells(rows[1:2], delimiter, path) or [[]])[0] if units else []
    between = bool(units) + (any(words) and all(number_of(cell) is None for cell in words))
    as_text = pa_csv.ConvertOptions(
        column_types=dict.fromkeys(names, pa.string()), strings_can_be_null=True, null_values=_NOTHING
    )
    try:
        with _opened(path, notes) as file:
            text = in_one_space(file.read()) if spaces else b""
            cut = _last_row_may_be_cut(path, text, notes)
            table = pa_csv.read_csv(
                io.BytesIO(text) if spaces else file,
                read_options=pa_csv.ReadOptions(use_threads=False, column_names=names, skip_rows=above + 1 + between),
                parse_options=pa_csv.ParseOptions(delimiter=delimiter, invalid_row_handler=cut),
                convert_options=as_text,
            )
    except (pa.ArrowException, OSError) as error:
        raise LogError(str(error), where=path, how="fix that line") from error
    if table.num_rows == 0:
        raise LogError("no row below the header", where=path, how="record or export it again")
    if comma:
        table = pa.table([pc.replace_substring(column, ",", ".") for column in table.columns], names=names)
    return _without_units(table, units), between


def _without_units(table: pa.Table, units: dict[str, str]) -> pa.Table:
    """Columns whose cells all have the same unit behind their number, `0.05 sec`, as numbers; `units` has it then."""
    for at, name in enumerate(table.column_names):
        cells = table[name].drop_null().slice(0, 100).to_pylist()
        behind = {match[1] if (match := _WITH_UNIT.fullmatch(cell)) else "" for cell in cells}
        if len(behind) == 1 and (unit := unit_of(spelled := behind.pop())):
            numbers = pc.replace_substring_regex(table[name], rf"\s*{re.escape(spelled)}\s*$", "")
            table = table.set_column(at, name, numbers)
            units.setdefault(name, unit)
    return table


def _row_of_units(names: Sequence[str], cells: Sequence[str]) -> dict[str, str]:
    """Units by column, where the row below the header holds units; empty where it holds data.

    It has no number but 1 (no unit), and at least half of its cells that are not empty are units.
    """
    said = [cell for cell in cells if cell.strip()]
    units = [unit_of(cell) for cell in said]
    is_data = len(cells) != len(names) or any(number_of(cell) is not None and cell.strip() != "1" for cell in said)
    if is_data or not any(units) or 2 * sum(unit is not None for unit in units) < len(said):
        return {}
    return {name: unit for name, cell in zip(names, cells, strict=True) if (unit := unit_of(cell))}


def _are_numbers(line: str, separators: str) -> bool:
    """Whether a line holds several cells between any of these separators, most but a stamp numbers."""
    if any(other in line for other in _SEPARATORS if other not in separators):
        return False
    cells = re.split(f"[{re.escape(separators)}]+", DATE_AND_TIME.sub("0", line.strip()))
    return len(cells) > 1 and 2 * sum(number_of(cell) is not None for cell in cells) > len(cells)


def has_numbers(path: Path) -> bool:
    """Whether one of the first lines of a text holds several numbers and nothing else."""
    try:
        return any(_are_numbers(line, f" {_SEPARATORS}") for line in _first_lines(path))
    except LogError:
        return False


def _as_many_as_cells(names: list[str], header: str, row: str, path: Path) -> list[str]:
    """Names above a table separated by spaces, which may themselves be separated by something else.

    Two names above the date and the time of a stamp become one.
    """
    cells, parts = DATE_AND_TIME.sub(r"\1T\2", row).split(), row.split()
    if len(names) == len(parts) == len(cells) + 1:
        at = next(at for at, (cell, part) in enumerate(zip(cells, parts, strict=False)) if cell != part)
        return [*names[:at], " ".join(names[at : at + 2]), *names[at + 2 :]]
    others = [name.strip() for name in re.split(f"[{_SEPARATORS}]", header)]
    if len(others) == len(cells):
        return others
    if len(names) != len(cells):
        raise LogError(
            f"{len(names)} names above {len(cells)} columns separated by spaces",
            where=path,
            how="give each column one name without spaces in it",
        )
    return names


def _cells(lines: Sequence[str], delimiter: str, path: Path) -> list[list[str]]:
    """Cells of lines."""
    try:
        return list(csv.reader(lines, delimiter=delimiter))
    except csv.Error as error:
        raise LogError(f"not a table: {error}", where=path, how="export it again") from error


def _lines_above_header(table: Sequence[Sequence[str]]) -> int:
    """How many lines stand before the header, as loggers of cars write them; 0 where none does.

    All cells of a header are different texts, and all rows below it, but for one of units, have a number and as many
    cells.
    """
    rows = [[cell.strip() for cell in cells] for cells in table]
    for above, names in enumerate(rows):
        below = [cells for cells in rows[above + 1 :] if any(cells)]
        numbers = [any(number_of(cell) is not None for cell in cells) for cells in below]
        is_header = len(names) > 1 and all(names) and len(set(names)) == len(names)
        if not is_header or any(number_of(name) is not None for name in names) or not all(numbers[1:]):
            continue
        if any(numbers) and all(len(cells) == len(names) for cells in below[:-1]):  # the last one may be cut
            return above
    return 0


def _last_row_may_be_cut(path: Path, text: bytes, notes: list[str]) -> Callable[[pa_csv.InvalidRow], str]:
    """What to do with rows of too few or too many cells: the last one is left out, as loggers are switched off.

    Args:
        text: what was read, where it is not the file's own text.
    """

    def handle(row: pa_csv.InvalidRow) -> str:
        if row.actual_columns > row.expected_columns:
            return "error"
        with io.BytesIO(text) if text else _opened(path) as file:
            file.seek(-min(file.seek(0, 2), len(row.text.encode()) + 8), 2)
            if file.read().strip(b"\r\n").endswith(b"\n" + row.text.strip("\r\n").encode()):
                notes.append(f"the last row is cut off after {row.actual_columns} cells, and left out")
                return "skip"
        return "error"

    return handle


def _opened(path: Path, notes: list[str] | None = None) -> io.BufferedIOBase:
    """A table's text in UTF-8 with a line of names: spreadsheets write UTF-16, and loggers have ways of their own.

    Any other text is read as Windows writes it, which a note says, if there is a list for it.
    """
    file = path.open("rb")
    begin = file.peek(_BEGIN)[:_BEGIN]
    is_known = begin.startswith(UTF_16) or any(mark in begin for mark in MARKS)
    as_it_is = not is_known and is_utf_8(file)
    file.seek(0)
    if as_it_is:
        return file
    with file:
        try:
            text = with_one_header(file.read())
        except UnicodeDecodeError as error:
            raise LogError("the text is neither UTF-8 nor cp1252", where=path, how="save it as UTF-8") from error
    if not is_known and notes is not None:
        notes.append("the text is not UTF-8, and read as cp1252; where names look wrong, save it as UTF-8")
    return io.BytesIO(text)


def _first_lines(path: Path) -> list[str]:
    """The first lines, of which the last one may be cut."""
    try:
        with _opened(path) as file:
            lines = [line for _ in range(_MOST_PREAMBLE + _ROWS_BELOW) if (line := file.readline(1 << 20))] or [b""]
    except OSError as error:
        raise LogError(f"cannot be opened: {error.strerror}", where=path) from error
    if not lines[0].strip():
        raise LogError("the file is empty, or begins with an empty line", where=path, how="record or export it again")
    text = [line.decode("utf-8-sig", "replace").rstrip("\r\n") for line in lines]
    if "\0" in text[0]:
        raise LogError("not a text file", where=path, how="save it as UTF-8 text with a header line")
    if len(lines) < 2:
        raise LogError("no row below the header", where=path, how="record or export it again")
    return text


def check_columns(path: Path, names: list[str]) -> None:
    """Raise where a table has no columns, or two of one name."""
    if len(names) > _MOST_COLUMNS:
        raise LogError(f"{len(names)} columns", where=path, how=f"export at most {_MOST_COLUMNS}")
    repeated = sorted(name for name, count in Counter(names).items() if count > 1)
    if repeated:
        raise LogError(f"column '{repeated[0]}' appears twice", where=path, how="give every column its own name")
    if not names:
        raise LogError("no column of numbers", where=path, how="export the quantities as numbers")
