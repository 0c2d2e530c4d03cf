"""Cache of compiled code, which can be made again."""

import os
import sys
from collections.abc import Mapping
from pathlib import Path

VARIABLE = "OFFPISTE_CACHE"
"""Environment variable of the cache folder."""


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
