"""Shared by all tests; shapes and types of offpiste's functions are checked while they run."""

import os
import pathlib
import tempfile

if "PYTEST_XDIST_WORKER" in os.environ:  # each worker has a core; libraries read this when they are first imported
    os.environ.setdefault("OMP_NUM_THREADS", "1")

# Machine code of yesterday is as good as today's; fitted stages of yesterday must not be taken.
os.environ.setdefault("NUMBA_CACHE_DIR", str(pathlib.Path(__file__).parents[1] / ".numba_cache"))
os.environ["OFFPISTE_CACHE"] = (_shared := tempfile.TemporaryDirectory(prefix="offpiste-cache-")).name

from jaxtyping import install_import_hook

install_import_hook("offpiste", "beartype.beartype")

from pathlib import Path  # noqa: E402

import pytest  # noqa: E402
from hypothesis import settings  # noqa: E402

# The suite gives the same answer every time; `--hypothesis-profile=default` looks for new counterexamples.
settings.register_profile("repeatable", derandomize=True, deadline=None)
settings.load_profile("repeatable")


@pytest.fixture(scope="session")
def data_folder() -> Path:
    """Recorded data beside the project (its README says what it is)."""
    beside = Path(__file__).parents[2] / "shared" / "data"
    folder = Path(os.environ.get("OFFPISTE_DATA") or beside)
    if not folder.is_dir():
        pytest.skip(f"no recorded data: {folder} is no folder; set OFFPISTE_DATA")
    return folder
