"""One short simulated drive that the tests of this package look at."""

from collections.abc import Callable
from pathlib import Path

import pytest

from offpiste.cli import main
from shared_drives import drive_with_sensors


def _run(*arguments: str) -> int:
    with pytest.raises(SystemExit) as exit_:
        main(list(arguments))
    return int(exit_.value.code or 0)


@pytest.fixture(scope="session")
def run() -> Callable[..., int]:
    """Runs a command; its exit code."""
    return _run


@pytest.fixture(scope="session")
def drive(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with drive.mcap and pca.safetensors."""
    folder = tmp_path_factory.mktemp("viewing")
    drive_with_sensors(folder / "drive.mcap")
    options = {"--rig": "proving_ground", "--backbone": "filterbank", "--images": "2", "--components": "5"}
    options |= {"--split": "blocks:1,0,0", "--out": str(folder / "pca.safetensors")}
    assert _run("fit-pca", str(folder / "drive.mcap"), *(word for pair in options.items() for word in pair)) == 0
    return folder
