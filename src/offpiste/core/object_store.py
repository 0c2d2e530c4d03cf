"""Files in object stores (`s3://`, `gs://` and whatever else fsspec opens): brought here, and uploaded."""

import logging
import re
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Any, Final

from offpiste.core.errors import OffpisteError, installation_of

logger = logging.getLogger(__name__)

_URL: Final = re.compile(r"([a-z][a-z0-9+.-]+):/{1,2}([^/].*)")
_EXTRAS: Final = {"s3": "s3", "s3a": "s3", "gs": "gcs", "gcs": "gcs"}


def url_of(path: str | Path) -> str | None:
    """URL of a place in an object store; None for a place on this machine.

    A `Path` of a URL has lost one of its two slashes, which it gets back here.
    """
    found = _URL.fullmatch(str(path))
    return f"{found[1]}://{found[2].rstrip('/')}" if found and not Path(path).exists() else None


@dataclass(frozen=True)
class Store:
    """A folder of an object store, or one file.

    Attributes:
        files: fsspec's file system.
        root: the folder in it.
    """

    url: str
    files: Any
    root: str

    def names(self, pattern: str) -> list[str]:
        """Files below the folder that match a pattern, by their paths in it."""
        with self._reached() as files:
            return sorted(found[len(self.root) :].lstrip("/") for found in files.glob(f"{self.root}/{pattern}"))

    def read(self, name: str) -> bytes | None:
        """Content of a small file; None if there is none."""
        with self._reached() as files:
            try:
                return bytes(files.cat_file(self._place(name)))
            except FileNotFoundError:
                return None

    def bring(self, to: Path, name: str = "") -> bool:
        """Copy a file or a folder to a place on this machine; False if there is none."""
        source = self._place(name)
        with self._reached() as files:
            if files.isfile(source):
                files.get_file(source, str(to))
                return True
            found = files.find(source)
            places = [to / _inside(file.removeprefix(source).lstrip("/"), self.url) for file in found]
            for folder in {place.parent for place in places}:
                folder.mkdir(parents=True, exist_ok=True)
            files.get(found, [str(place) for place in places])
            return bool(found)

    def put(self, file: Path, name: str) -> None:
        """Upload a file."""
        with self._reached() as files:
            files.put_file(str(file), self._place(name))

    def upload(self, folder: Path, name: str, *, last: str) -> None:
        """Replace a folder in the store; one file comes last, so that whoever finds it finds all the others."""
        self.remove(name)
        found = sorted(str(file.relative_to(folder)) for file in folder.rglob("*") if file.is_file())
        first = [file for file in found if file != last]
        with self._reached() as files:
            files.put([str(folder / file) for file in first], [self._place(f"{name}/{file}") for file in first])
        self.put(folder / last, f"{name}/{last}")

    def remove(self, name: str = "") -> None:
        """Remove what lies below a folder in the store."""
        with self._reached() as files:
            if found := files.find(self._place(name)):
                files.rm(found)

    def _place(self, name: str) -> str:
        return f"{self.root}/{name}" if name else self.root

    @contextmanager
    def _reached(self) -> Iterator[Any]:
        self.files.invalidate_cache()  # others write there, too
        with _errors_of(self.url):
            yield self.files


def store_at(url: str) -> Store:
    """Open an object store.

    Raises:
        OffpisteError: nothing here opens such URLs, or it cannot be reached.
    """
    import fsspec

    scheme = url.partition("://")[0]
    try:
        with _errors_of(url):
            files, root = fsspec.url_to_fs(url)
    except ImportError as error:
        needed = error.name or f"fsspec's package for {scheme}"
        how = installation_of(_EXTRAS[scheme]) if scheme in _EXTRAS else f"pip install '{needed}'"
        raise OffpisteError(f"reading {scheme}:// needs another package", how=how) from error
    return Store(url, files, root.rstrip("/"))


def expanded(paths: Sequence[str | Path]) -> list[str | Path]:
    """The paths, and for patterns of URLs what they match: a shell expands patterns of this machine's files only.

    Raises:
        OffpisteError: a pattern matches nothing.
    """
    result: list[str | Path] = []
    for path in paths:
        url = url_of(path)
        if url is None or not set("*?[") & set(url):
            result.append(path)
            continue
        folder, _, pattern = url.rpartition("/")
        found = store_at(folder).names(pattern)
        if not found:
            raise OffpisteError("nothing matches", where=url, how="check its spelling")
        result += [f"{folder}/{name}" for name in found]
    return result


@contextmanager
def brought(path: str | Path) -> Iterator[Path]:
    """A file or a folder on this machine; one of an object store is copied, and the copy is removed afterwards.

    Raises:
        OffpisteError: there is no such place in the store, or it cannot be reached.
    """
    url = url_of(path)
    if url is None:
        yield Path(path)
        return
    with tempfile.TemporaryDirectory(prefix="offpiste-") as folder:
        here = Path(folder) / url.rpartition("/")[2]
        logger.info(f"{url}: brought here")
        if not store_at(url).bring(here):
            raise OffpisteError("no such file or folder", where=url, how="check its spelling")
        try:
            yield here
        except OffpisteError as error:
            error.where = error.where.replace(str(here), url)
            raise


def refuse_url(path: str | Path) -> None:
    """Raise if a place lies in an object store, where a command cannot read or write."""
    if (url := url_of(path)) is not None:
        how = "give a place on this machine; `offpiste extract` reads and writes there"
        raise OffpisteError("lies in an object store", where=url, how=how)


def _inside(name: str, url: str) -> Path:
    """A path of a store, refused if it would leave the folder that it is copied to."""
    parts = PurePosixPath(name).parts
    if not parts or ".." in parts or name.startswith("/") or "\\" in name:
        raise OffpisteError(f"holds '{name}', which is no name of a file", where=url, how="remove it from the store")
    return Path(*parts)


@contextmanager
def _errors_of(url: str) -> Iterator[None]:
    try:
        yield
    except (OffpisteError, ImportError):
        raise
    except Exception as error:  # every store raises errors of its own libraries
        why = f"{type(error).__name__}: {error}" if str(error) else type(error).__name__
        how = "check its name, the network and the credentials"
        raise OffpisteError(f"cannot be reached ({why})", where=url, how=how) from error
