"""Location of a dataset: a local folder, or an object store that is read through a copy in the cache."""

import hashlib
import os
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path, PurePosixPath
from typing import Any, Final

from offpiste.core.cache import cache_folder, forget_unused
from offpiste.core.checksums import CHECKSUMS
from offpiste.core.errors import DatasetError
from offpiste.core.files import temporary_folder, write_bytes
from offpiste.core.object_store import download, opened, url_of
from offpiste.core.progress import track

_SETTINGS: Final = ("zarr.json", CHECKSUMS)
"""Files of a dataset beside its drives, in the order of writing."""


def drive_names(path: Path) -> list[str]:
    """Return the names of a dataset's complete drives."""
    if (url := url_of(path)) is not None:
        with opened(url) as (files, root):
            return _uploaded(files, root)
    return sorted(f.name for f in path.iterdir() if f.is_dir() and not f.name.startswith("."))


@contextmanager
def working_copy(path: Path) -> Iterator[Path]:
    """Yield the folder to add drives to: the dataset, or a copy of the settings of one in an object store.

    Drives in the store are empty folders of the copy. Added drives are uploaded at the end, checksums last: they mark
    a drive as complete.
    """
    url = url_of(path)
    if url is None:
        yield path
        return
    with tempfile.TemporaryDirectory(prefix="offpiste-") as folder:
        copy = Path(folder) / path.name
        with opened(url) as (files, root):
            before = _settings_in(files, root)
            uploaded = _uploaded(files, root) if before else []
        for name, content in before.items():
            write_bytes(copy / name, content)
        for name in uploaded:
            (copy / name).mkdir()
        yield copy
        with opened(url) as (files, root):
            for drive in sorted(copy.iterdir()):
                if drive.is_dir() and not drive.name.startswith(".") and any(drive.iterdir()):
                    _upload(files, drive, f"{root}/{drive.name}")
            for name in _SETTINGS:
                if (copy / name).read_bytes() != before.get(name):
                    files.put_file(str(copy / name), f"{root}/{name}")


def mirrored(path: Path) -> Path:
    """Return the dataset's folder; one in an object store is updated in the user's cache folder first.

    Raises:
        DatasetError: there is no dataset.
    """
    url = url_of(path)
    if url is None:
        return path
    with opened(url) as (files, root):
        settings, drives = _settings_in(files, root), _uploaded(files, root)
        checksums = {name: files.cat_file(f"{root}/{name}/{CHECKSUMS}") for name in drives}
    if not settings:
        raise DatasetError("not a dataset", where=url, how="make one with `offpiste extract`")
    copy = cache_folder() / "datasets" / hashlib.sha256(url.encode()).hexdigest()[:16] / path.name
    for name, content in settings.items():
        write_bytes(copy / name, content)
    for name in drive_names(copy):
        if not (copy / name / CHECKSUMS).exists() or (copy / name / CHECKSUMS).read_bytes() != checksums.get(name):
            shutil.rmtree(copy / name)
    for name in track(drives, f"copy {path.name}"):
        if not (copy / name).exists():
            with temporary_folder(copy / name) as partial:
                download(f"{url}/{name}", partial / name)
                (partial / name).replace(copy / name)
    os.utime(copy.parent)  # `forget_unused` keeps it for 30 days from now
    forget_unused(cache_folder())
    return copy


def remove_if_empty(path: Path) -> None:
    """Remove a dataset without drives."""
    if drive_names(path):
        return
    if (url := url_of(path)) is None:
        shutil.rmtree(path)
        return
    with opened(url) as (files, root):
        _remove(files, root)


def _uploaded(files: Any, root: str) -> list[str]:
    found = [PurePosixPath(name).parent.name for name in files.glob(f"{root}/*/{CHECKSUMS}")]
    return sorted(name for name in found if not name.startswith("."))  # ".." would lead out of the dataset


def _settings_in(files: Any, root: str) -> dict[str, bytes]:
    """Read the settings of a dataset in a store; none if it is incomplete."""
    try:
        return {name: files.cat_file(f"{root}/{name}") for name in _SETTINGS}
    except FileNotFoundError:
        return {}


def _upload(files: Any, drive: Path, to: str) -> None:
    """Replace a drive in the store."""
    _remove(files, to)
    names = [str(file.relative_to(drive)) for file in drive.rglob("*") if file.is_file() and file.name != CHECKSUMS]
    files.put([str(drive / name) for name in names], [f"{to}/{name}" for name in names])
    files.put_file(str(drive / CHECKSUMS), f"{to}/{CHECKSUMS}")


def _remove(files: Any, folder: str) -> None:
    if found := files.find(folder):
        files.rm(found)
