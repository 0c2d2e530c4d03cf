"""Of which code and day a result is."""

import subprocess
from datetime import UTC, datetime


def commit() -> str:
    """The checkout's commit, with "-dirty" where files differ from it."""
    command = ["git", "describe", "--always", "--dirty"]
    return subprocess.run(command, capture_output=True, text=True, check=True).stdout.strip()


def today() -> str:
    """The day, as 2026-11-22."""
    return datetime.now(UTC).date().isoformat()
