"""One short simulated drive that the tests of this package look at."""

from collections.abc import Callable
from pathlib import Path

import pytest

from offpiste.cli import main
from offpiste.simulation.simulate import DriveSettings, simulate
from offpiste.simulation.world.world import WorldSettings


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
    world = WorldSettings("mojave", seed=3, size=60.0, resolution=0.5)
    simulate(DriveSettings(world, 2.5, seed=1, sensors="light"), folder / "drive.mcap")
    options = {"--rig": "proving_ground", "--backbone": "filterbank", "--images": "2", "--components": "5"}
    options |= {"--split": "blocks:1,0,0", "--out": str(folder / "pca.safetensors")}
    assert _run("fit-pca", str(folder / "drive.mcap"), *(word for pair in options.items() for word in pair)) == 0
    return folder
