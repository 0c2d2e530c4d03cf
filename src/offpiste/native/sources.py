"""Sources of the compiled library, and their digest, by which a stale library is found.

`setup.py` runs this file before anything is installed, so that it imports nothing else.
"""

import hashlib
from pathlib import Path

PACKAGE = Path(__file__).parents[1]


def sources() -> list[Path]:
    """Return all C++ files of the package."""
    return sorted(path for pattern in ("*.h", "*.cpp") for path in PACKAGE.rglob(pattern))


def digest() -> str:
    """Return the SHA-256 of all sources."""
    return hashlib.sha256(b"\0".join(path.read_bytes() for path in sources())).hexdigest()
