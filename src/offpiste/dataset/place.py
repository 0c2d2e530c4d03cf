"""Where a dataset lies: in a folder of this machine, or in an object store, which is read from a copy in the cache."""

import hashlib
import os
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Final

from offpiste.core.cache import cache_folder, forget_unused
from offpiste.core.checksums import CHECKSUMS
from offpiste.core.errors import DatasetError
from offpiste.core.files import write_bytes, write_folder
from offpiste.core.object_store import Store, store_at, url_of
from offpiste.core.progress import track

_SETTINGS: Final = ("zarr.json", CHECKSUMS)
"""Files of a dataset beside its drives, in the order in which they are written."""


def drive_names(path: Path) -> list[str]:
    """Names of the drives that a dataset holds whole."""
    if (url := url_of(path)) is not None:
        return _uploaded(store_at(url))
    return sorted(f.name for f in path.iterdir() if f.is_dir() and not f.name.startswith("."))


@contextmanager
def working_copy(path: Path) -> Iterator[Path]:
    """Folder to add drives in: the dataset, or for one in an object store a copy of its settings.

    Drives that are in the store already are empty folders of the copy. Those that are added are uploaded at the end;
    they count as there once their checksums are, which come last.
    """
    url = url_of(path)
    if url is None:
        yield path
        return
    store = store_at(url)
    with tempfile.TemporaryDirectory(prefix="offpiste-") as folder:
        copy = Path(folder) / path.name
        before = _settings_in(store)
        for name, content in before.items():
            write_bytes(copy / name, content)
        for name in _uploaded(store) if before else ():
            (copy / name).mkdir()
        yield copy
        for drive in sorted(copy.iterdir()):
            if drive.is_dir() and not drive.name.startswith(".") and any(drive.iterdir()):
                store.upload(drive, drive.name, last=CHECKSUMS)
        for name in _SETTINGS:
            if (copy / name).read_bytes() != before.get(name):
                store.put(copy / name, name)


def mirrored(path: Path) -> Path:
    """The dataset, or for one in an object store its copy in the user's cache folder, brought up to date.

    Raises:
        DatasetError: there is none.
    """
    url = url_of(path)
    if url is None:
        return path
    store = store_at(url)
    settings = _settings_in(store)
    if not settings:
        raise DatasetError("not a dataset", where=url, how="make one with `offpiste extract`")
    copy = cache_folder() / "datasets" / hashlib.sha256(url.encode()).hexdigest()[:16] / path.name
    for name, content in settings.items():
        write_bytes(copy / name, content)
    drives = _uploaded(store)
    for gone in {*drive_names(copy)} - {*drives}:
        shutil.rmtree(copy / gone)
    for name in track(drives, f"bring {path.name}"):
        _bring(store, name, copy / name)
    os.utime(copy.parent)  # it is used now
    forget_unused(cache_folder())
    return copy


def remove_if_empty(path: Path) -> None:
    """Remove a dataset that no drive was written into."""
    if drive_names(path):
        return
    url = url_of(path)
    if url is None:
        shutil.rmtree(path)
    else:
        store_at(url).remove()


def _uploaded(store: Store) -> list[str]:
    found = [name.partition("/")[0] for name in store.names(f"*/{CHECKSUMS}")]
    return [name for name in found if not name.startswith(".")]  # nor any that leads out of the dataset


def _settings_in(store: Store) -> dict[str, bytes]:
    """Settings of a dataset in a store; none where there is no whole one."""
    found = {name: store.read(name) for name in _SETTINGS}
    settings = {name: content for name, content in found.items() if content is not None}
    return settings if len(settings) == len(_SETTINGS) else {}


def _bring(store: Store, name: str, copy: Path) -> None:
    """Copy a drive, unless it is there already."""
    checksums = store.read(f"{name}/{CHECKSUMS}")
    if copy.exists() and checksums == (copy / CHECKSUMS).read_bytes():
        return

    def write(partial: Path) -> None:
        store.bring(partial, name)

    shutil.rmtree(copy, ignore_errors=True)
    write_folder(copy, write)
