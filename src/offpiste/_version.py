"""Version of the package, and commit and day of a result."""

import subprocess
from datetime import UTC, datetime
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

try:
    __version__ = version("offpiste")
except PackageNotFoundError:  # a source tree that is not installed
    __version__ = "0+unknown"


def commit() -> str:
    """Return the commit of the checkout, with "-dirty" if files differ; "" outside a checkout."""
    root = Path(__file__).parents[2]
    if not (root / ".git").exists():
        return ""
    command = ["git", "-C", str(root), "describe", "--always", "--dirty"]
    try:
        return subprocess.run(command, capture_output=True, text=True, check=True).stdout.strip()
    except (OSError, subprocess.CalledProcessError):  # no git, or not the user's checkout
        return ""


def today() -> str:
    """Return the day as 2026-11-22."""
    return datetime.now(UTC).date().isoformat()
