"""offpiste learns how an off-road vehicle will move on the ground ahead, and plans with what it learned."""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from offpiste.dataset.resample import extract_rows
    from offpiste.dataset.rows import Rows
    from offpiste.dataset.store import Dataset, open_dataset
    from offpiste.dataset.windows import Windows
    from offpiste.dynamics import MODELS, Dynamics, Vehicle, as_callable, rollout
    from offpiste.errors import OffpisteError
    from offpiste.logs import Drive, open_log, read_drive
    from offpiste.rig.rig import Rig, load_rig
    from offpiste.state import RecordedTerrain
    from offpiste.training.config import TrainConfig
    from offpiste.training.run import Run, load_run
    from offpiste.training.terrain_sources import encoded
    from offpiste.training.train import train

_HOME = {
    "Rows": "offpiste.dataset.rows",
    "extract_rows": "offpiste.dataset.resample",
    "Dataset": "offpiste.dataset.store",
    "open_dataset": "offpiste.dataset.store",
    "Windows": "offpiste.dataset.windows",
    "MODELS": "offpiste.dynamics",
    "Dynamics": "offpiste.dynamics",
    "Vehicle": "offpiste.dynamics",
    "as_callable": "offpiste.dynamics",
    "rollout": "offpiste.dynamics",
    "OffpisteError": "offpiste.errors",
    "Drive": "offpiste.logs",
    "open_log": "offpiste.logs",
    "read_drive": "offpiste.logs",
    "Rig": "offpiste.rig.rig",
    "load_rig": "offpiste.rig.rig",
    "TrainConfig": "offpiste.training.config",
    "encoded": "offpiste.training.terrain_sources",
    "Run": "offpiste.training.run",
    "load_run": "offpiste.training.run",
    "train": "offpiste.training.train",
    "RecordedTerrain": "offpiste.state",
}

__all__ = [  # noqa: RUF022  (the order of the stages)
    "OffpisteError",
    "Rig",
    "load_rig",
    "Drive",
    "open_log",
    "read_drive",
    "Rows",
    "extract_rows",
    "Dataset",
    "open_dataset",
    "Windows",
    "MODELS",
    "Dynamics",
    "Vehicle",
    "as_callable",
    "RecordedTerrain",
    "rollout",
    "TrainConfig",
    "train",
    "encoded",
    "Run",
    "load_run",
]


def __getattr__(name: str) -> Any:
    # Public names are imported when they are asked for, so that `import offpiste` and `--help` stay quick.
    if name not in _HOME:
        raise AttributeError(f"module 'offpiste' has no attribute '{name}'")
    return getattr(import_module(_HOME[name]), name)
