"""Cache of compiled code, which can be made again."""

import os
import shutil
import sys
import time
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import Final

VARIABLE = "OFFPISTE_CACHE"
"""Environment variable of the cache folder."""

KEPT_DAYS: Final = 30.0
"""Days after their last use at which entries are removed."""

ENTRIES: Final = (
    "kernels/*_" + 40 * "[0-9a-f]",
    "costs/" + 32 * "[0-9a-f]" + ".so",
    "datasets/" + 16 * "[0-9a-f]",  # of older versions
)
"""Patterns of entries. Other files in the folder are never touched."""


def cache_folder(environment: Mapping[str, str] = os.environ, platform: str = sys.platform) -> Path:
    r"""Return the user's cache folder by the conventions of the platform; it may not exist yet.

    `$OFFPISTE_CACHE`, or else `$XDG_CACHE_HOME/offpiste` and `~/.cache/offpiste`, on macOS `~/Library/Caches/offpiste`,
    on Windows `%LOCALAPPDATA%\offpiste\Cache`.
    """
    home = Path(os.path.expanduser("~"))  # noqa: PTH111  (Path.home() raises where there is none)
    if given := environment.get(VARIABLE):
        return Path(given).expanduser().absolute()
    if platform == "win32":
        return Path(environment.get("LOCALAPPDATA") or home / "AppData" / "Local") / "offpiste" / "Cache"
    if platform == "darwin":
        return home / "Library" / "Caches" / "offpiste"
    given = environment.get("XDG_CACHE_HOME", "")
    # The specification ignores relative paths.
    return (Path(given) if Path(given).is_absolute() else home / ".cache") / "offpiste"


def forget_unused(folder: Path, *, days: float = KEPT_DAYS) -> list[Path]:
    """Remove entries that were not used for some days, and return their paths.

    The last use of a folder is the last time that one of its files was read or written.
    """
    oldest = time.time() - 86400 * days
    unused = [entry for names in ENTRIES for entry in folder.glob(names) if _last_used(entry) < oldest]
    for entry in unused:
        if entry.is_dir():
            shutil.rmtree(entry, ignore_errors=True)
        else:
            with suppress(OSError):
                entry.unlink()
    return [entry for entry in unused if not entry.exists()]


def _last_used(entry: Path) -> float:
    last = 0.0
    for path in (entry, *entry.glob("*")):
        with suppress(FileNotFoundError):  # another process replaces it
            status = path.stat()
            last = max(last, status.st_mtime, 0.0 if path.is_dir() else status.st_atime)
    return last
