"""The user's cache folder, by platform."""

from pathlib import Path

import pytest

from offpiste.cache import cache_folder

HOME = Path.home()


@pytest.mark.parametrize(
    ("platform", "environment", "wanted"),
    [
        ("linux", {}, HOME / ".cache" / "offpiste"),
        ("linux", {"XDG_CACHE_HOME": "/var/cache/me"}, Path("/var/cache/me/offpiste")),
        ("linux", {"XDG_CACHE_HOME": "relative"}, HOME / ".cache" / "offpiste"),
        ("darwin", {"XDG_CACHE_HOME": "/var/cache/me"}, HOME / "Library" / "Caches" / "offpiste"),
        ("win32", {}, HOME / "AppData" / "Local" / "offpiste" / "Cache"),
        ("win32", {"LOCALAPPDATA": "/local"}, Path("/local/offpiste/Cache")),
        ("linux", {"OFFPISTE_CACHE": "/elsewhere", "XDG_CACHE_HOME": "/var/cache/me"}, Path("/elsewhere")),
    ],
)
def test_the_folder_follows_the_conventions_of_the_platform(
    platform: str, environment: dict[str, str], wanted: Path
) -> None:
    assert cache_folder(environment, platform) == wanted
