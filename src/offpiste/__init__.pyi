# Public names, each written once: `__init__.py` imports them from here on first use.

from . import closed_loop as closed_loop
from . import dataset as dataset
from . import demo as demo
from . import dynamics as dynamics
from . import evaluation as evaluation
from . import export as export
from . import inspection as inspection
from . import live as live
from . import logs as logs
from . import mapping as mapping
from . import perception as perception
from . import planning as planning
from . import reproduction as reproduction
from . import rig as rig
from . import runtime as runtime
from . import simulation as simulation
from . import training as training
from . import transport as transport
from . import uncertainty as uncertainty
from . import visualization as visualization
from ._version import __version__ as __version__

# Driving.
from .closed_loop.drive_course import CourseDriveSettings as CourseDriveSettings
from .closed_loop.drive_course import drive_course as drive_course
from .closed_loop.planner import load_planner as load_planner
from .core.errors import OffpisteError as OffpisteError
from .core.state import RecordedTerrain as RecordedTerrain
from .core.state import Trajectory as Trajectory

# Making datasets.
from .dataset.extract import make_dataset as make_dataset
from .dataset.fit_pca import fit_pca as fit_pca
from .dataset.resample import Rows as Rows
from .dataset.resample import extract_rows as extract_rows
from .dataset.splits import parse_split as parse_split
from .dataset.store import Dataset as Dataset
from .dataset.store import open_dataset as open_dataset
from .dataset.windows import Windows as Windows

# Models and predicting.
from .dynamics import MODELS as MODELS
from .dynamics import Dynamics as Dynamics
from .dynamics import Vehicle as Vehicle
from .dynamics import as_callable as as_callable
from .dynamics import rollout as rollout

# Evaluating.
from .evaluation.evaluate_runs import evaluate_runs as evaluate_runs

# Inspecting and reading logs.
from .inspection.draft_rig import draft_rig as draft_rig
from .inspection.inspect import inspect_log as inspect_log
from .inspection.render import render_text as render_text
from .logs import Drive as Drive
from .logs import open_log as open_log
from .logs import read_drive as read_drive
from .logs.sensor_log import SensorLog as SensorLog
from .logs.sensor_log import open_sensors as open_sensors

# Mapping.
from .mapping.pipeline import FeatureCloud as FeatureCloud
from .mapping.pipeline import MapPipeline as MapPipeline
from .mapping.pipeline import MapSettings as MapSettings
from .mapping.replay import replay as replay
from .mapping.terrain_map import TerrainLayers as TerrainLayers
from .mapping.terrain_map import TerrainMap as TerrainMap
from .mapping.terrain_sampler import MapTerrain as MapTerrain
from .mapping.terrain_sampler import stack_maps as stack_maps
from .perception.backbones import open_backbone as open_backbone
from .perception.feature_extractor import load_feature_extractor as load_feature_extractor

# Planning.
from .planning.cost_map import CostMap as CostMap
from .planning.cost_map import cost_map as cost_map
from .planning.costs.layers import Hazards as Hazards
from .planning.costs.weights import CostWeights as CostWeights
from .planning.course import Course as Course
from .planning.course import Goal as Goal
from .planning.mppi import Plan as Plan
from .planning.mppi import improve as improve
from .rig.rig import Rig as Rig
from .rig.rig import load_rig as load_rig

# Simulating.
from .simulation.simulate import DriveSettings as DriveSettings
from .simulation.simulate import simulate as simulate
from .simulation.world.world import WorldSettings as WorldSettings

# Training.
from .training.config import TrainConfig as TrainConfig
from .training.prediction import encoded as encoded
from .training.run import Run as Run
from .training.run import load_run as load_run
from .training.run import pretrained as pretrained
from .training.train import train as train
from .uncertainty.calibration import calibrate as calibrate
from .uncertainty.fit import SpreadPrediction as SpreadPrediction
from .uncertainty.fit import predict_with_spread as predict_with_spread
