"""The user's cache folder."""

import os
import time
from pathlib import Path

from offpiste.core.cache import cache_folder, forget_unused

HOME = Path.home()


def test_the_folder_follows_the_conventions_of_the_platform() -> None:
    for platform, environment, wanted in (
        ("linux", {}, HOME / ".cache" / "offpiste"),
        ("linux", {"XDG_CACHE_HOME": "/var/cache/me"}, Path("/var/cache/me/offpiste")),
        ("linux", {"XDG_CACHE_HOME": "relative"}, HOME / ".cache" / "offpiste"),
        ("darwin", {"XDG_CACHE_HOME": "/var/cache/me"}, HOME / "Library" / "Caches" / "offpiste"),
        ("win32", {}, HOME / "AppData" / "Local" / "offpiste" / "Cache"),
        ("win32", {"LOCALAPPDATA": "/local"}, Path("/local/offpiste/Cache")),
        ("linux", {"OFFPISTE_CACHE": "/elsewhere", "XDG_CACHE_HOME": "/var/cache/me"}, Path("/elsewhere")),
    ):
        assert cache_folder(environment, platform) == wanted


def _entry(path: Path, *, read: float, written: float) -> Path:
    """A file last read and written some days ago, in a folder made as long ago."""
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(b"x")
    now = time.time()
    os.utime(path, (now - 86400 * read, now - 86400 * written))
    return path


def _aged(folder: Path, days: float) -> None:
    os.utime(folder, (time.time() - 86400 * days,) * 2)


def test_what_was_used_of_late_stays_and_what_is_not_the_caches_own(tmp_path: Path) -> None:
    kernels = [tmp_path / "kernels" / f"vehicle_{40 * digit}" / "code.nbc" for digit in "1b"]
    for path, days in zip(kernels, (31, 29), strict=True):
        _entry(path, read=days, written=90)
    chunk = _entry(tmp_path / "datasets" / (16 * "2") / "data.zarr" / "chunk", read=90, written=90)
    others = [
        _entry(tmp_path / folder / "mine.zarr" / "chunk", read=90, written=90)
        for folder in ("datasets", "kernels", "pictures")
    ]
    for folder in (kernels[0].parent, kernels[1].parent, *chunk.parents[:2], *(each.parent for each in others)):
        _aged(folder, 90)
    removed = forget_unused(tmp_path)
    assert set(removed) == {kernels[0].parent, chunk.parents[1]}
    assert not any(path.exists() for path in removed)
    assert all(path.exists() for path in (kernels[1], *others))
    assert forget_unused(tmp_path) == forget_unused(tmp_path / "nowhere") == []
