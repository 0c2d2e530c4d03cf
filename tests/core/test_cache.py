"""The user's cache folder."""

from pathlib import Path

from offpiste.core.cache import cache_folder

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
