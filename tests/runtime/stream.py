"""Stream of messages without a simulator: a vehicle that moves as a model predicts, on a plain scanned by one LiDAR."""

from dataclasses import dataclass, field

import numpy as np
import torch

from offpiste.core.conventions import CONTROL, DT
from offpiste.core.state import ModelState, Terrain
from offpiste.dynamics import Parametric, Vehicle
from offpiste.dynamics.feature_encoder import Compressor
from offpiste.dynamics.hybrid import Hybrid
from offpiste.logs.measurements import Camera, Cloud, Image, Lidar
from offpiste.mapping.pipeline import MapSettings
from offpiste.mapping.replay import MapperSettings
from offpiste.mapping.voxel_map import VoxelSettings
from offpiste.perception.camera import make_pinhole_camera
from offpiste.planning import mppi
from offpiste.planning.controls import PEDAL_LIMITS
from offpiste.planning.course import Course
from offpiste.rig.camera import CameraModel
from offpiste.rig.sensors import CameraSource, LidarSource
from offpiste.runtime.estimator import VehicleReading
from offpiste.runtime.perception import SensorSetup
from offpiste.runtime.runtime import Runtime
from offpiste.runtime.settings import RuntimeSettings

WHEELS = np.array([[1.03, 0.66], [1.03, -0.66], [-1.03, 0.66], [-1.03, -0.66]])
FLAT = Terrain.of(torch.tensor([0.0, 0.0, 1.0]).expand(1, 4, 3))
FEATURES = 3


def parametric(*more):
    """The parametric model, with further controls."""
    return Parametric(Vehicle(1150.0, 2.06, 0.5, (*CONTROL, *more), ())).eval()


def feature_model():
    """Hybrid model that reads features, its network untrained."""
    torch.manual_seed(0)
    return Hybrid(Vehicle(1150.0, 2.06, 0.5, CONTROL, (), features=FEATURES), encoder=Compressor(FEATURES)).eval()


def settings(**changed):
    sampling = mppi.Settings(PEDAL_LIMITS, (0.35, 0.3), samples=64, rest=(0.2, 0.0))
    small = MapSettings(VoxelSettings(reach=24.0, capacity=200_000, threads=1))
    return RuntimeSettings(**{"sampling": sampling, "replay": MapperSettings(map=small), "margin": 2.0, **changed})


def camera():
    """Camera on the roof that looks 30 degrees down."""
    turn = np.array([[0, -np.sin(0.5), np.cos(0.5)], [-1, 0, 0], [0, -np.cos(0.5), -np.sin(0.5)]])
    mounting = np.eye(4)
    mounting[:3, :3], mounting[:3, 3] = turn, (0.5, 0.0, 1.6)
    model = CameraModel(140, 98, np.array([[90.0, 0, 69.5], [0, 90.0, 48.5], [0, 0, 1]]))
    return make_pinhole_camera(Camera("eye", model, mounting, CameraSource("/eye")), 14)


def extract_features(pixels):
    rows, columns = pixels.shape[0] // 14, pixels.shape[1] // 14
    return np.full((rows, columns, FEATURES), pixels.mean() / 255, np.float32)


@dataclass
class Stream:
    """Runs a run time in lockstep."""

    runtime: Runtime
    truth: Parametric = field(default_factory=parametric)
    state: tuple = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    reads: object = lambda t: True  # whether such a message arrives at a time
    scans: object = lambda t: True
    images: object = lambda t: True
    controls: list = field(default_factory=list)
    states: list = field(default_factory=list)
    height: float = 0.0  # of the ground that is scanned [m]
    geared: bool = False

    def run(self, seconds):
        """Continue the drive; returns the stream."""
        empty = torch.zeros(1, 0)
        if not self.states:
            self.model_state = ModelState(torch.tensor([self.state]), torch.full((1, 4), torch.nan), empty)
        with torch.no_grad():
            for row in range(len(self.controls), len(self.controls) + round(seconds / DT)):
                self._step(row)
        return self

    def _step(self, row):
        t = row * DT
        x, y, yaw, vx, vy, rate = self.model_state.state[0].double().tolist()
        self.states.append((x, y, yaw, vx, vy, rate))
        if self.reads(t):
            self.runtime.vehicle(reading(t, x, y, yaw, vx, vy, rate))
        if row % 25 == 0 and self.images(t):
            self.runtime.image(Image(t, "eye", np.full((98, 140, 3), 120, np.uint8)))
        if row % 5 == 0 and self.scans(t):
            self.runtime.scan(scan(t, self.height))
        self.controls.append(self.runtime.step(t))
        due = self.controls[-1]
        given = np.append(due.command, due.gear) if self.geared else due.command
        command = torch.as_tensor(given, dtype=torch.float32)
        self.model_state = self.truth.step(self.model_state, command[None], FLAT)

    def modes(self):
        """Modes and reasons, in order."""
        return [(event.mode, event.why) for event in self.runtime.events]


class Held:
    """A vehicle that nothing moves."""

    def step(self, model_state, command, terrain):
        return model_state


def reading(t, x=0.0, y=0.0, yaw=0.0, vx=0.0, vy=0.0, rate=0.0, *, actuators=np.nan):
    cos, sin = np.cos(yaw), np.sin(yaw)
    velocity = np.array((cos * vx - sin * vy, sin * vx + cos * vy, 0.0))
    quaternion = np.array((0.0, 0.0, np.sin(yaw / 2), np.cos(yaw / 2)))
    return VehicleReading(t, np.array((x, y, 0.33)), quaternion, velocity, rate, np.full(4, actuators))


def scan(t, height=0.0):
    """A plain at some height [m]."""
    at = np.arange(-20.0, 20.0, 0.35)
    ground = np.stack((*(axis.ravel() for axis in np.meshgrid(at, at)), np.full(len(at) ** 2, height - 2.33)), axis=1)
    return Cloud(t, "lidar", ground, None, np.ones(len(ground)))


def sensor_setup(extractor=None):
    """A LiDAR, and a camera if its features are extracted."""
    mounting = np.eye(4)
    mounting[2, 3] = 2.0
    lidars = {"lidar": Lidar("lidar", mounting, LidarSource("/points"))}
    return SensorSetup(lidars, {"eye": camera()}, extractor) if extractor else SensorSetup(lidars)


def course(length=60.0, speed=5.0):
    x = np.arange(0.0, length)
    return Course(np.stack((x, np.zeros_like(x)), axis=1), np.full(len(x), speed))


def straight_drive(*, dynamics=None, camera=None, length=60.0, wanted=5.0, seed=0, spread=None, stream=None, **changed):
    """A stream for a run time on a straight course; `camera` extracts features of its images."""
    model = dynamics or (feature_model() if camera else parametric())
    there, limited = course(length, wanted), settings(**changed)
    runtime = Runtime(model, sensor_setup(camera), WHEELS, there, limited, seed=seed, spread=spread)
    return Stream(runtime, geared="gear" in model.vehicle.control_columns, **(stream or {}))
