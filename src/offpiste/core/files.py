"""Atomic writing of files and folders."""

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
"""Suffix of unfinished files and folders, which have a hidden name beside their final path."""


def _beside(path: Path, make: Callable[..., Made]) -> Made:
    """Make a temporary file or folder under a hidden name beside a path, whose parent is created."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        return make(prefix=f".{path.name}.", suffix=PARTIAL, dir=path.parent)
    except FileNotFoundError as error:
        raise OffpisteError("nothing can be written there", where=path.parent, how="give another folder") from error


@contextmanager
def _locked(partial: Path) -> Iterator[None]:
    """Lock an unfinished file against `remove_partials` of other processes, if the file system has locks.

    Raises:
        BlockingIOError: another process has locked it.
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


def write_whole(path: Path, write: Callable[[Path], object]) -> None:
    """Write a file beside `path`, then move it there; an interruption leaves the old file."""
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


def write_folder(path: Path, write: Callable[[Path], object]) -> None:
    """Write a folder, which must not be the current one, beside its final path and move it there when complete."""
    refuse_url(path)
    if path.resolve() == Path.cwd():
        raise OffpisteError("is the current folder", where=path, how="give a folder that does not exist yet")
    with temporary_folder(path) as partial:
        write(partial)
        partial.chmod(0o755)
        partial.replace(path)


@contextmanager
def temporary_folder(path: Path) -> Iterator[Path]:
    """Make a hidden temporary folder beside a path; it is removed afterwards."""
    partial = Path(_beside(path, tempfile.mkdtemp))
    with _locked(partial):
        try:
            yield partial
        finally:
            shutil.rmtree(partial, ignore_errors=True)


def check_folder(out: Path, *, option: str = "--out", own: Sequence[str] | None = None) -> None:
    """Raise `OffpisteError` if a command cannot write a folder: a file, in an object store, or with other content.

    Args:
        option: its option, for the message.
        own: patterns of files that mark a folder of this command; None accepts any content.
    """
    refuse_url(out)
    for place in (out, *out.parents):
        if place.exists() and not place.is_dir():
            raise OffpisteError("is a file", where=place, how=f"give a folder as {option}")
    if own is None or not out.exists() or any(next(out.glob(pattern), None) is not None for pattern in own):
        return
    if other := sorted(each.name for each in out.iterdir() if not each.name.startswith(".")):
        how = f"give a folder that is empty or does not exist yet as {option}"
        raise OffpisteError(f"contains other files ({other[0]})", where=out, how=how)


@contextmanager
def unfinished(out: Path, mark: str) -> Iterator[None]:
    """Mark a folder by a hidden file until it is complete; with the mark in `own`, `check_folder` accepts it."""
    write_bytes(out / mark, b"")
    yield
    (out / mark).unlink(missing_ok=True)


def remove_partials(folder: Path, name: str = "") -> None:
    """Remove unfinished files of killed processes, of one final name or all; those of running processes stay."""
    for partial in folder.glob(f".{escape(name)}.*{PARTIAL}" if name else f".*{PARTIAL}"):
        with suppress(BlockingIOError), _locked(partial):
            if partial.is_dir():
                shutil.rmtree(partial, ignore_errors=True)
            else:
                partial.unlink(missing_ok=True)


def write_bytes(path: Path, content: bytes) -> None:
    """Write bytes atomically."""
    write_whole(path, lambda partial: partial.write_bytes(content))


def write_text(path: Path, text: str) -> None:
    """Write text atomically."""
    write_bytes(path, text.encode("utf-8"))
