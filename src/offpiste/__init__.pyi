# Public names; `__init__.py` reads this file and imports them on first use.

from ._version import __version__
from .closed_loop.drive_course import CourseDriveSettings
from .closed_loop.drive_course import drive_course as drive
from .core.errors import OffpisteError
from .core.state import Trajectory
from .dataset.fit_pca import fit_pca
from .dataset.store import Dataset, open_dataset
from .dataset.windows import Windows
from .dynamics import MODELS
from .evaluation.evaluate_runs import evaluate_runs as evaluate
from .exports.formats import export
from .inspection.draft_rig import draft_rig
from .inspection.extract import extract
from .inspection.inspect import inspect_log as inspect
from .logs import open_log, read_drive
from .mapping.replay import replay
from .planning.costs.layers import Hazards
from .planning.costs.weights import CostWeights
from .planning.course import Course, Goal
from .rig.rig import Rig, load_rig
from .runtime.planner import Planner, load_planner
from .runtime.scene import DrivingPlan, Scene, plan, read_scene
from .simulation.simulate import DriveSettings, simulate
from .simulation.world.world import WorldSettings
from .training.config import TrainConfig
from .training.run import Run, predict
from .training.run import load_run as load
from .training.train import train

__all__ = [
    "MODELS",
    "CostWeights",
    "Course",
    "CourseDriveSettings",
    "Dataset",
    "DriveSettings",
    "DrivingPlan",
    "Goal",
    "Hazards",
    "OffpisteError",
    "Planner",
    "Rig",
    "Run",
    "Scene",
    "TrainConfig",
    "Trajectory",
    "Windows",
    "WorldSettings",
    "__version__",
    "draft_rig",
    "drive",
    "evaluate",
    "export",
    "extract",
    "fit_pca",
    "inspect",
    "load",
    "load_planner",
    "load_rig",
    "open_dataset",
    "open_log",
    "plan",
    "predict",
    "read_drive",
    "read_scene",
    "replay",
    "simulate",
    "train",
]
