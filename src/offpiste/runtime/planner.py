"""A trained run as a planner, and its warm-up."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

import numpy as np
from jaxtyping import Float

from offpiste.core.channels import registered_actuators
from offpiste.core.checksums import sha256_of
from offpiste.core.conventions import ACTUATORS, DT
from offpiste.core.errors import PlanningError, RunError
from offpiste.core.shipped import PCA, PREFIX
from offpiste.dynamics import Dynamics
from offpiste.logs.ground_truth import GROUND_PROPERTIES
from offpiste.logs.measurements import Camera, Cloud, Image, Lidar
from offpiste.perception.camera import make_pinhole_camera
from offpiste.perception.feature_extractor import FeatureExtractor, load_feature_extractor
from offpiste.planning.course import Course
from offpiste.runtime.estimator import VehicleReading
from offpiste.runtime.perception import SensorSetup
from offpiste.runtime.runtime import Runtime
from offpiste.runtime.settings import RuntimeSettings
from offpiste.training.checkpoint import WEIGHTS
from offpiste.training.run import load_run
from offpiste.uncertainty.fit import FILE, load_spread
from offpiste.uncertainty.novelty import Novelty, load_memory_bank, mask_novel_ground
from offpiste.uncertainty.spread import Spread

WARM_UP: Final = 1.0
"""Duration of the warm-up drive [s]."""


@dataclass(frozen=True)
class Planner:
    """A trained model and what it needs to drive."""

    name: str  # name of the model; "ceiling" if it is given the simulator's ground properties
    folder: Path  # folder of the run
    dynamics: Dynamics
    extractor: FeatureExtractor | None = None  # backbone and PCA; None if the model reads no visual features
    weights: str = ""  # hash of the weights, as a run may be trained again in its folder
    seed: int = 0  # seed of the training
    novelty: Novelty = "ignored"  # treatment of ground unlike any in training
    spread: Spread | None = None  # spread of the predictions; None without `offpiste calibrate`

    @property
    def knows_ground(self) -> bool:
        """True if the model reads the ground's true properties."""
        return self.extractor is None and self.dynamics.encoder is not None

    def sensor_setup(self, cameras: Mapping[str, Camera], lidars: Mapping[str, Lidar]) -> SensorSetup:
        """Return sensors for the run time; cameras only if the model reads images."""
        if (extractor := self.extractor) is None:
            return SensorSetup(lidars)
        pinholes = {name: make_pinhole_camera(camera, extractor.patch) for name, camera in cameras.items()}
        return SensorSetup(lidars, pinholes, extractor.extract)


def load_planner(
    folder: str | Path, pca: Path | None = None, *, novelty: Novelty = "ignored", device: str = "cpu"
) -> Planner:
    """Load a run and, if its model reads visual features, its feature extractor.

    Args:
        folder: folder of the run, or `pretrained:NAME`.
        pca: PCA file of the run's dataset; shipped models have their own.
        novelty: "missing" treats ground unlike any in training as ground without features.
        device: device of the feature extractor; the model is on the CPU.

    Raises:
        RunError: no such run; the PCA is missing or differs from that of training; the spread belongs to other weights;
            or novelty needs features or a memory bank that the run lacks.
        PerceptionError: not a PCA, or its backbone is not available.
    """
    run = load_run(folder)
    dynamics, ships, where = run.dynamics, str(folder).startswith(PREFIX), str(folder)
    if missing := [name for name in ("throttle", "steer") if name not in dynamics.vehicle.control]:
        what = f"was trained without {' and '.join(missing)}, which a planner commands"
        raise RunError(what, where=where, how="give a run trained on both commands")
    planner = Planner(
        name=run.model,
        folder=run.folder,
        dynamics=dynamics,
        weights=sha256_of(run.folder / WEIGHTS)[:16],
        seed=run.seed,
        novelty=novelty,
        spread=load_spread(run) if (run.folder / FILE).exists() else None,
    )
    if dynamics.encoder is None:
        if novelty == "missing":
            raise RunError("reads no features, so --novelty has no effect", where=where, how="leave --novelty out")
        return planner
    if novelty == "missing":
        mask_novel_ground(dynamics, load_memory_bank(run))
    if run.pca is None:
        if not run.features:
            raise RunError("does not state its features", where=where, how="train again")
        if run.features != GROUND_PROPERTIES:
            what = f"reads features that cameras do not provide: {', '.join(run.features[:4])} …"
            how = "give a run trained on visual features, on ground-truth ones, or on none"
            raise RunError(what, where=where, how=how)
        return replace(planner, name="ceiling")
    pca = run.folder.parent / PCA if pca is None and ships else pca
    if pca is None:
        raise RunError("reads visual features", where=where, how="give --pca, the file its dataset was extracted with")
    extractor = load_feature_extractor(pca, device)
    if extractor.identity != run.pca:
        what = f"was trained with another PCA ({run.pca}) than {pca} ({extractor.identity})"
        raise RunError(what, where=where, how="give the file that its dataset was extracted with")
    return replace(planner, extractor=extractor)


def warm_up(
    dynamics: Dynamics,
    sensors: SensorSetup,
    wheels: Float[np.ndarray, "4 2"],
    settings: RuntimeSettings | None = None,
    *,
    spread: Spread | None = None,
) -> None:
    """Drive along a straight line over synthetic flat ground for a second.

    Otherwise the first plan of a `Runtime` with these arguments would wait for memory, and after an installation for
    the compilation of kernels for a GPU and of added cost terms.

    Raises:
        PlanningError: as `Runtime`, or no plan can be made with these settings.
    """
    speed, x = 2.0, np.arange(0.0, 60.0)
    course = Course(np.stack((x, np.zeros_like(x)), axis=1), np.full(len(x), speed))
    runtime = Runtime(dynamics, sensors, wheels, course, settings, spread=spread)
    level, registered = np.array((0, 0, 0, 1.0)), {actuator.name: 0.0 for actuator in registered_actuators()}
    for row in range(round(WARM_UP / DT)):
        time = row * DT
        place, velocity = np.array((speed * time, 0.0, 0.0)), np.array((speed, 0.0, 0.0))
        runtime.vehicle(VehicleReading(time, place, level, velocity, 0.0, np.zeros(len(ACTUATORS)), registered))
        if row % 10 == 1:  # there is no pose before the first row
            _see_flat_ground(runtime, sensors, time)
        runtime.step(time)
    if not runtime.predictions:
        why = runtime.failures[-1] if runtime.failures else runtime.events[-1].why
        raise PlanningError(f"no plan was made on flat ground: {why}", how="change the settings of the run time")


def _see_flat_ground(runtime: Runtime, sensors: SensorSetup, time: float) -> None:
    """Add a grey image of each camera and a scan of flat ground from each LiDAR."""
    for name, camera in sensors.cameras.items():
        width, height = camera.rectifier.source.size
        runtime.image(Image(time, name, np.full((height, width, 3), 128, np.uint8)))
    side = np.arange(-20.0, 20.0, 0.25)
    ground = np.stack(np.meshgrid(side, side, 0.0), axis=-1).reshape(-1, 3)
    for name, lidar in sensors.lidars.items():
        points = (ground - lidar.body_from_lidar[:3, 3]) @ lidar.body_from_lidar[:3, :3]
        runtime.scan(Cloud(time, name, points, np.zeros(len(points)), np.full(len(points), np.nan)))
