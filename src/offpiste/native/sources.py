"""Sources of the compiled library, their digest, by which a stale library is found, and flags of compilers.

`setup.py` runs this file before anything is installed, so that it imports nothing else.
"""

import hashlib
from pathlib import Path

PACKAGE = Path(__file__).parents[1]

FLAGS = ("-O3", "-std=c++17", "-fvisibility=hidden", "-fno-math-errno", "-fno-trapping-math", "-Wno-psabi")
"""Flags of g++ and clang++."""


PRINTED = tuple(
    PACKAGE / name for name in ("dynamics/header/physics.h", "dynamics/header/physics_adjoint.h", "native/cpp/layout.h")
)
"""Headers that the installation prints (`dynamics/kernels/generate.py`)."""

PRINTED_FROM = tuple(
    PACKAGE / f"{name}.py"
    for name in (
        "core/channels", "core/conventions", "dynamics/actuator_lags", "dynamics/bicycle",
        "dynamics/kernels/generate", "dynamics/kernels/layout", "dynamics/kernels/scalar_step",
        "dynamics/kernels/tape",
    )
)  # fmt: skip
"""Python files that `PRINTED` depends on."""


def sources() -> list[Path]:
    """Return all C++ files of the package, and the Python files that some of them are printed from."""
    return sorted([*PRINTED_FROM, *(path for pattern in ("*.h", "*.cpp") for path in PACKAGE.rglob(pattern))])


def digest() -> str:
    """Return the SHA-256 of all sources."""
    return hashlib.sha256(b"\0".join(path.read_bytes() for path in sources())).hexdigest()
