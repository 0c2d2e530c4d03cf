"""Writing of files whole or not at all."""

import os
import shutil
import tempfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from glob import escape
from pathlib import Path
from typing import TypeVar

from offpiste.core.errors import OffpisteError
from offpiste.core.object_store import refuse_url

Made = TypeVar("Made")

PARTIAL = ".partial"
"""Ending of files and folders that are being written, under a hidden name beside their place."""


def _beside(path: Path, make: Callable[..., Made]) -> Made:
    """What `tempfile` makes under a hidden name beside a path, in a folder that is made where there is none.

    Raises:
        OffpisteError: nothing can be made there, as in /proc.
    """
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        return make(prefix=f".{path.name}.", suffix=PARTIAL, dir=path.parent)
    except FileNotFoundError as error:
        raise OffpisteError("nothing can be written there", where=path.parent, how="give another folder") from error


@contextmanager
def _locked(partial: Path) -> Iterator[None]:
    """Lock what is being written while this process lives, so that `remove_partials` of others leaves it.

    Nothing is locked where the system or the file system has no such locks.

    Raises:
        BlockingIOError: another process holds it.
    """
    with ExitStack() as opened:
        try:
            import fcntl

            handle = os.open(partial, os.O_RDONLY)
            opened.callback(os.close, handle)
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise
        except (ImportError, OSError):
            pass
        yield


def write_whole(path: Path, write: Callable[[Path], None]) -> None:
    """Have `write` fill a file beside `path`, then move it there; an interruption leaves the old file."""
    refuse_url(path)
    handle, name = _beside(path, tempfile.mkstemp)
    os.close(handle)
    partial = Path(name)
    with _locked(partial):
        try:
            write(partial)
            partial.chmod(0o644)
            with partial.open("rb") as written:
                os.fsync(written.fileno())  # without it, a loss of power may leave the new name to an empty file
            partial.replace(path)
        finally:
            partial.unlink(missing_ok=True)


def write_folder(path: Path, write: Callable[[Path], None]) -> None:
    """Write a folder beside its place and move it there when it is complete.

    Raises:
        OffpisteError: it is the current folder, which cannot be replaced, or in an object store.
    """
    refuse_url(path)
    if path.resolve() == Path.cwd():
        raise OffpisteError("is the current folder", where=path, how="give a folder that is not yet there")
    with temporary_folder(path) as partial:
        write(partial)
        partial.chmod(0o755)
        partial.replace(path)


@contextmanager
def temporary_folder(path: Path) -> Iterator[Path]:
    """A folder under a hidden name beside a path, for files that are needed while that is made; removed afterwards."""
    partial = Path(_beside(path, tempfile.mkdtemp))
    with _locked(partial):
        try:
            yield partial
        finally:
            shutil.rmtree(partial, ignore_errors=True)


def check_folder(out: Path, *, option: str = "--out", own: Sequence[str] | None = None) -> None:
    """Check that a command can write a folder.

    Args:
        option: that gives it, for the message.
        own: patterns of files, one of which the command leaves; None: the caller looks at what is there.

    Raises:
        OffpisteError: it is a file, or lies in one, or in an object store, or holds something else.
    """
    refuse_url(out)
    for place in (out, *out.parents):
        if place.exists() and not place.is_dir():
            raise OffpisteError("is a file", where=place, how=f"give a folder as {option}")
    if own is None or not out.exists() or any(next(out.glob(pattern), None) is not None for pattern in own):
        return
    if other := sorted(each.name for each in out.iterdir() if not each.name.startswith(".")):
        how = f"give a folder that is empty or not there yet as {option}"
        raise OffpisteError(f"holds something else ({other[0]})", where=out, how=how)


@contextmanager
def unfinished(out: Path, mark: str) -> Iterator[None]:
    """Keep a hidden file in a folder until it is written whole: with it among `own`, `check_folder` accepts the rest.

    Args:
        mark: name of the file, which begins with a dot.
    """
    write_bytes(out / mark, b"")
    yield
    (out / mark).unlink(missing_ok=True)


def remove_partials(folder: Path, name: str = "") -> None:
    """Remove what killed processes left half written; what a process still writes stays.

    Args:
        name: of the file or folder that they were writing; "" for all in `folder`.
    """
    named = f".{escape(name)}.*{PARTIAL}" if name else f".*{PARTIAL}"
    for partial in folder.glob(named):
        with suppress(BlockingIOError), _locked(partial):
            if partial.is_dir():
                shutil.rmtree(partial, ignore_errors=True)
            else:
                partial.unlink(missing_ok=True)


def write_bytes(path: Path, content: bytes) -> None:
    """Write bytes whole or not at all."""

    def write(partial: Path) -> None:
        partial.write_bytes(content)

    write_whole(path, write)


def write_text(path: Path, text: str) -> None:
    """Write text whole or not at all."""
    write_bytes(path, text.encode("utf-8"))
