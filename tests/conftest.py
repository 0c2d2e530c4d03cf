"""Shared by all tests; shapes and types of offpiste's functions are checked while they run."""

from jaxtyping import install_import_hook

install_import_hook("offpiste", "beartype.beartype")

import os  # noqa: E402
from pathlib import Path  # noqa: E402

import pytest  # noqa: E402


@pytest.fixture(scope="session")
def data_folder() -> Path:
    """Recorded data beside the project (its README says what it is)."""
    beside = Path(__file__).parents[2] / "shared" / "data"
    folder = Path(os.environ.get("OFFPISTE_DATA") or beside)
    if not folder.is_dir():
        pytest.skip(f"no recorded data: {folder} is no folder; set OFFPISTE_DATA")
    return folder
