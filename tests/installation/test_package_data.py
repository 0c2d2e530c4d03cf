"""Every file that is no Python is part of the installed package."""

import tomllib
from pathlib import Path

ROOT = Path(__file__).parents[2]
BUILT = {".py", ".pyc", ".so"}


def test_every_kind_of_file_is_installed() -> None:
    declared = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["tool"]["setuptools"]["package-data"]
    package = ROOT / "src" / "offpiste"
    installed = {path for pattern in declared["offpiste"] for path in package.glob(pattern)}
    files = {path for path in package.rglob("*") if path.is_file() and path.suffix not in BUILT}
    assert files - installed == set()
