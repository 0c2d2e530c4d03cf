"""Files in object stores (`s3://`, `gs://` and others of fsspec) and their local copies."""

import logging
import re
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path, PurePosixPath
from typing import Any, Final

from offpiste.core.errors import OffpisteError, installation_of

logger = logging.getLogger(__name__)

_URL: Final = re.compile(r"([a-z][a-z0-9+.-]+):/{1,2}([^/].*)")
_EXTRAS: Final = {"s3": "s3", "s3a": "s3", "gs": "gcs", "gcs": "gcs"}


def url_of(path: str | Path) -> str | None:
    """Return the URL of a path in an object store, with the slash that `Path` removes; None for a local path."""
    found = _URL.fullmatch(str(path))
    return f"{found[1]}://{found[2].rstrip('/')}" if found and not Path(path).exists() else None


def refuse_url(path: str | Path) -> None:
    """Raise `OffpisteError` if a path is in an object store."""
    if (url := url_of(path)) is not None:
        how = "give a local path; `inspect`, `fit-pca` and `extract` read object stores"
        raise OffpisteError("is in an object store", where=url, how=how)


@contextmanager
def opened(url: str) -> Iterator[tuple[Any, str]]:
    """Open the fsspec file system of a URL, and give it and the path in it.

    Raises:
        OffpisteError: a package for such URLs is missing, or the store cannot be reached.
    """
    import fsspec

    scheme = url.partition("://")[0]
    try:
        files, root = fsspec.url_to_fs(url)
        files.invalidate_cache()  # other processes may have written there
        yield files, root.rstrip("/")
    except OffpisteError:
        raise
    except ImportError as error:
        needed = error.name or f"fsspec's package for {scheme}"
        how = installation_of(_EXTRAS[scheme]) if scheme in _EXTRAS else f"pip install '{needed}'"
        raise OffpisteError(f"reading {scheme}:// needs another package", how=how) from error
    except Exception as error:  # stores raise errors of their own libraries
        why = f"{type(error).__name__}: {error}" if str(error) else type(error).__name__
        how = "check its name, the network and the credentials"
        raise OffpisteError(f"cannot be reached ({why})", where=url, how=how) from error


def expanded(paths: Sequence[str | Path]) -> list[str | Path]:
    """Expand patterns in URLs; raises `OffpisteError` if a pattern matches nothing."""
    result: list[str | Path] = []
    for path in paths:
        url = url_of(path)
        if url is None or not set("*?[") & set(url):
            result.append(path)
            continue
        with opened(url) as (files, pattern):
            found = sorted(files.unstrip_protocol(name.lstrip("/")) for name in files.glob(pattern))
        if not found:
            raise OffpisteError("nothing matches", where=url, how="check its spelling")
        result += found
    return result


def download(url: str, to: Path) -> None:
    """Copy a file or folder of a store to a local path that does not exist yet.

    Raises:
        OffpisteError: the URL does not exist, or a name in the store points outside the folder.
    """
    with opened(url) as (files, root):
        names = files.find(root)
        if not names:
            raise OffpisteError("no such file or folder", where=url, how="check its spelling")
        for name in names:
            if ".." in PurePosixPath(name).parts or "\\" in name:
                raise OffpisteError(f"'{name}' is not a valid file name", where=url, how="remove it from the store")
        files.get(root, str(to), recursive=True)


@contextmanager
def brought(path: str | Path) -> Iterator[Path]:
    """Give a local path; a file or folder in an object store is copied, and the copy removed afterwards."""
    url = url_of(path)
    if url is None:
        yield Path(path)
        return
    with tempfile.TemporaryDirectory(prefix="offpiste-") as folder:
        here = Path(folder) / url.rpartition("/")[2]
        logger.info(f"{url}: copied to this machine")
        download(url, here)
        try:
            yield here
        except OffpisteError as error:
            error.where = error.where.replace(str(here), url)
            raise
