"""One short simulated drive that the tests of this package look at."""

from pathlib import Path

import pytest

from cli.command import run
from shared_drives import drive_with_sensors


@pytest.fixture(scope="session")
def drive(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with drive.mcap and pca.safetensors."""
    folder = tmp_path_factory.mktemp("viewing")
    drive_with_sensors(folder / "drive.mcap")
    options = "--rig proving_ground --backbone filterbank --images 2 --components 5 --split blocks:1,0,0 --out"
    assert run("fit-pca", folder / "drive.mcap", *options.split(), folder / "pca.safetensors") == 0
    return folder
