"""Where offpiste keeps what it can make again: machine code of its kernels, fitted stages of training."""

import os
import sys
from collections.abc import Mapping
from pathlib import Path

VARIABLE = "OFFPISTE_CACHE"
"""Environment variable that names another folder."""


def cache_folder(environment: Mapping[str, str] = os.environ, platform: str = sys.platform) -> Path:
    r"""The user's cache folder for offpiste, by the platform's conventions; it may not exist yet.

    `$OFFPISTE_CACHE`, or else `$XDG_CACHE_HOME/offpiste` and `~/.cache/offpiste`, on macOS `~/Library/Caches/offpiste`,
    on Windows `%LOCALAPPDATA%\offpiste\Cache`.
    """
    if given := environment.get(VARIABLE):
        return Path(given).expanduser().absolute()
    if platform == "win32":
        local = environment.get("LOCALAPPDATA")
        return (Path(local) if local else _home() / "AppData" / "Local") / "offpiste" / "Cache"
    if platform == "darwin":
        return _home() / "Library" / "Caches" / "offpiste"
    given = environment.get("XDG_CACHE_HOME", "")
    # The specification ignores relative paths.
    return (Path(given) if Path(given).is_absolute() else _home() / ".cache") / "offpiste"


def _home() -> Path:
    return Path(os.path.expanduser("~"))  # noqa: PTH111  (Path.home() raises where there is none)
