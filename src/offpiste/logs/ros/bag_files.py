"""Files of a bag: which there are, their readers, and damage reported in one line."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from rosbags import rosbag1, rosbag2

from offpiste.errors import LogError
from offpiste.logs.ros.mcap_recovery import StreamedMcap

_Indexed = rosbag1.Reader | rosbag2.Reader
Reader = _Indexed | StreamedMcap
MAGIC = {".bag": b"#ROSBAG V", ".mcap": b"\x89MCAP0\r\n", ".db3": b"SQLite format 3\0"}
"""First bytes of files, by their endings."""
_REPAIRS = {
    ".bag": "repair it with `rosbag reindex FILE`, or record or copy it again",
    ".mcap": "repair it with `mcap recover FILE -o REPAIRED.mcap`, or record or copy it again",
    ".db3": "repair it with `sqlite3 FILE .recover | sqlite3 REPAIRED.db3`, or record or copy it again",
}


def storage_files(folder: Path) -> list[Path]:
    """A ROS 2 bag's files in order: drive_2.mcap before drive_10.mcap."""
    files = [file for file in folder.iterdir() if file.suffix in (".mcap", ".db3") and file.is_file()]
    return sorted(files, key=lambda file: (len(file.name), file.name))


def open_readers(path: Path, notes: list[str]) -> list[Reader]:
    """Opened readers of a bag, in the order of its files.

    Args:
        notes: warnings are added to it.

    Raises:
        LogError: the bag is empty, damaged, or of another format than its ending.
    """
    if not path.is_dir():
        return [_open_file(path, notes)]
    failed = LogError("no metadata.yaml", where=path, how=_repair(path))
    if (path / "metadata.yaml").is_file():
        try:
            return [_opened(rosbag2.Reader, path)]
        except LogError as error:
            failed = error
    readers: list[Reader] = []
    for file in storage_files(path):
        try:
            readers.append(_open_file(file, notes))
        except LogError as error:
            notes.append(f"left out: {error}")
    if not readers:
        raise failed
    notes.append(f"{path}: {failed.what} (was the recorder killed?); {len(readers)} files are read one by one")
    return readers


def _open_file(path: Path, notes: list[str]) -> Reader:
    _check_beginning(path)
    wal = path.with_name(f"{path.name}-wal")
    if path.suffix == ".db3" and wal.is_file() and wal.stat().st_size > 0:
        notes.append(f"{wal}: messages not yet moved into the .db3 are not read; `sqlite3 FILE .schema` moves them")
    try:
        return _opened(rosbag1.Reader if path.suffix == ".bag" else rosbag2.Reader, path)
    except LogError:
        if path.suffix != ".mcap":
            raise
    reader = StreamedMcap(path)
    notes.extend(reader.warnings)
    return reader


def _opened(kind: Callable[[Path], _Indexed], path: Path) -> _Indexed:
    with reported(path, "cannot be read"):
        reader = kind(path)
        reader.open()
        return reader


def _check_beginning(path: Path) -> None:
    try:
        with path.open("rb") as file:
            head = file.read(16)
    except OSError as error:
        raise LogError(f"cannot be opened: {error.strerror}", where=path) from error
    if not head:
        raise LogError("the file is empty", where=path, how="record or copy it again")
    if not head.startswith(MAGIC[path.suffix]):
        true = next((suffix for suffix, magic in MAGIC.items() if head.startswith(magic)), "")
        how = f"it is a {true} file: rename it" if true else "give it the ending of its format"
        raise LogError(f"not a {path.suffix} file", where=path, how=how)


def _repair(path: Path) -> str:
    default = "repair it with `ros2 bag reindex FOLDER`, or record or copy it again"
    return default if path.is_dir() else _REPAIRS.get(path.suffix, default)


@contextmanager
def reported(path: Path, what: str) -> Iterator[None]:
    """Turn errors into one line: rosbags lets those of struct, lz4, zstd, bz2 and SQLite through."""
    try:
        yield
    except LogError:
        raise
    except Exception as error:
        reason = " ".join(str(error).split())[:200] or type(error).__name__
        raise LogError(f"{what}: {reason}", where=path, how=_repair(path)) from error
