"""A side-by-side in a `World`: rigid bodies by MuJoCo; tyres, drive train and ground contact by `vehicle.physics`.

The bodies are a free chassis and four wheels that slide up and down on it. MuJoCo integrates them without contacts and
constraints. Wheels do not spin in MuJoCo: their spin is a separate state whose reaction acts as a torque.
"""

import ctypes
from collections import deque
from contextlib import suppress
from functools import cache
from pathlib import Path
from typing import Any, Final

import numpy as np

from offpiste.core.conventions import DT, GRAVITY
from offpiste.core.errors import OffpisteError, extra
from offpiste.logs.ground_truth import GROUND_PROPERTIES
from offpiste.simulation.sample import VehicleSample, WheelTruth
from offpiste.simulation.vehicle.parameters import VehicleParameters
from offpiste.simulation.vehicle.physics import STATE, substeps
from offpiste.simulation.world.grids import main_kinds, read_grid
from offpiste.simulation.world.world import World

with extra("sim"):
    import mujoco

SUBSTEPS = 10
"""Substeps in one step of `DT`; the fastest oscillation, a wheel's spin on its tyre, has about 100 rad/s."""
SETTLING_STEPS = 40
"""Steps after which a vehicle placed on the ground rests on its springs."""
TILT_LIMIT = np.cos(np.radians(70))
"""Cosine of the tilt beyond which the vehicle has rolled over."""
BORDER = 3.0
"""Distance from the world's edge at which the vehicle leaves it [m]."""
STANDSTILL = 0.3
"""Speed below which gears can be shifted [m/s]."""

_MODEL = """
<mujoco model="side-by-side">
  <option timestep="{timestep}" gravity="0 0 -{gravity}" integrator="Euler">
    <flag contact="disable" constraint="disable"/>
  </option>
  <worldbody>
    <body name="chassis">
      <freejoint/>
      <inertial pos="{p.sprung_com[0]} {p.sprung_com[1]} {p.sprung_com[2]}" mass="{p.sprung_mass}"
        diaginertia="{p.roll_inertia} {p.pitch_inertia} {p.yaw_inertia}"/>
      {wheels}
    </body>
  </worldbody>
</mujoco>
"""

_WHEEL = """
      <body name="wheel-{number}" pos="{x} {y} 0">
        <joint type="slide" axis="0 0 1"/>
        <inertial pos="0 0 0" mass="{p.unsprung_mass}" diaginertia="{tilt} {p.wheel_inertia} {tilt}"/>
      </body>"""


def build_bodies(parameters: VehicleParameters) -> Any:
    """Build `mujoco.MjModel` of a vehicle; qpos: pose point (3), quaternion wxyz (4), travel of the wheels (4)."""
    # A ring about half as wide as its radius: the transverse inertia is slightly over half the axial one.
    tilt = 0.6 * parameters.wheel_inertia
    places = enumerate(parameters.wheel_places)
    wheels = "".join(_WHEEL.format(number=i, x=x, y=y, tilt=tilt, p=parameters) for i, (x, y) in places)
    return mujoco.MjModel.from_xml_string(
        _MODEL.format(timestep=DT / SUBSTEPS, gravity=GRAVITY, p=parameters, wheels=wheels)
    )


@cache
def mj_step_address() -> int | None:
    """Return the address of MuJoCo's `mj_step` for compiled code, from the library in its wheel."""
    for file in Path(mujoco.__file__).parent.glob("*mujoco.*"):
        with suppress(OSError, AttributeError):
            return ctypes.cast(ctypes.CDLL(str(file)).mj_step, ctypes.c_void_p).value
    raise OffpisteError("mujoco does not contain its library", how="install the wheel of mujoco from PyPI")


class GearBox:
    """Forward, neutral and reverse gear; a shift needs a standstill and takes `steps` of `DT` in neutral."""

    def __init__(self, steps: int) -> None:
        self._steps, self._lever, self._left = steps, 1.0, 0

    @property
    def engaged(self) -> float:
        """1 forward, -1 reverse, 0 neutral."""
        return 0.0 if self._left else self._lever

    def shift(self, wanted: float | None, *, moving: bool) -> None:
        """Advance by one step and shift to a gear (1, 0 or -1; None keeps it) unless the vehicle moves."""
        self._left = max(self._left - 1, 0)
        if wanted is not None and wanted != self._lever and not moving:
            self._lever, self._left = float(wanted), self._steps


class VehicleSimulation:
    """A vehicle placed on the ground of a world and driven by commands.

    The same inputs give the same bytes on the same machine.

    Args:
        x, y, yaw: pose at the start [m, rad].
        speed: forward speed at the start [m/s].
    """

    def __init__(
        self, world: World, parameters: VehicleParameters, *, x: float, y: float, yaw: float, speed: float = 0.0
    ) -> None:
        self._world, self._parameters = world, parameters
        self._record = parameters.as_record()
        self._grids, self._plants = _grids(world), _plants(world)
        self._model = build_bodies(parameters)
        self._data = data = mujoco.MjData(self._model)
        self._qpos, self._qvel = data.qpos, data.qvel  # views of MuJoCo's memory
        self._forces = data.xfrc_applied, data.qfrc_applied
        self._state = np.zeros((), STATE)
        self._command = np.zeros(3)
        self._gears = GearBox(round(parameters.gear_time / DT))
        self._brakes: deque[float] = deque([0.0] * round(parameters.brake_delay / DT))
        self._steps = 0
        self._reported: set[str] = set()
        self._events: list[str] = []
        self._put(x, y, yaw)
        self._start(speed)

    def step(self, throttle: float, brake: float, steer: float, gear: float | None = None) -> None:
        """Advance by `DT` under a constant command.

        Args:
            throttle, brake: 0..1.
            steer: -1..1, positive left.
            gear: 1, 0 or -1, shifted at a standstill (`GearBox`); None keeps it.

        Raises:
            OffpisteError: the physics diverged.
        """
        self._gears.shift(gear, moving=bool(np.hypot(*self._qvel[:2]) > STANDSTILL))
        self._command[:] = np.clip((throttle, brake, steer), (0, 0, -1), (1, 1, 1))
        self._brakes.append(float(self._command[1]))
        held = np.array((self._command[0], self._brakes.popleft(), self._command[2], self._gears.engaged))
        self._substeps(SUBSTEPS, held, self._plants)
        self._steps += 1
        self._report_events()

    def sample(self) -> VehicleSample:
        """Return the current measurements and ground truth; each event is reported once."""
        quaternion = self._qpos[[4, 5, 6, 3]]
        events, self._events = tuple(self._events), []
        return VehicleSample(
            time=self._steps * DT,
            position=self._qpos[:3].copy(),
            orientation=quaternion / np.linalg.norm(quaternion),
            velocity=self._qvel[:3].copy(),
            angular_velocity=self._qvel[3:6].copy(),
            command=self._command.copy(),
            brake_pressure=float(self._state["brake_pressure"]),
            steer_angle=float(self._state["steering"]["angle"]),
            steer_rate=float(self._state["steering"]["rate"]),
            engine_speed=float(self._state["speeds"][0] * 60 / (2 * np.pi)),
            wheel_speed=self._state["speeds"][1:] * self._parameters.rolling_radius,
            truth=self._wheel_truth(),
            events=events,
            gear=self._gears.engaged,
        )

    def _substeps(self, count: int, command: np.ndarray, plants: tuple[Any, ...]) -> None:
        substeps(
            count, mj_step_address(), self._model._address, self._data._address, *self._grids, *plants, command,
            self._qpos, self._qvel, self._state, *self._forces, DT / SUBSTEPS, self._record,
        )  # fmt: skip
        if self._data.warning.number.any():  # MuJoCo resets the state and carries on
            what = f"the simulated vehicle diverged after {self._steps * DT:g} s"
            raise OffpisteError(what, how="check its commands, and the numbers in its file")

    def _put(self, x: float, y: float, yaw: float) -> None:
        # Place on the plane through the ground under the wheels, then settle on the springs without moving sideways.
        p = self._parameters
        c, s = np.cos(yaw), np.sin(yaw)
        places = (x, y) + np.array(p.wheel_places) @ np.array(((c, s), (-s, c)))
        heights = read_grid(self._world.elevation, self._world.origin, self._world.resolution, places)
        along = (heights[:2].sum() - heights[2:].sum()) / 2 / p.wheelbase
        across = (heights[::2].sum() - heights[1::2].sum()) / 2 / p.track
        forward = np.array((c, s, along)) / np.hypot(1, along)
        up = np.cross(forward, (-s, c, across))
        up /= np.linalg.norm(up)
        rotation = np.stack((forward, np.cross(up, forward), up), axis=1)
        self._qpos[:3] = x, y, heights.mean() + p.rest_height / up[2]
        mujoco.mju_mat2Quat(self._qpos[3:7], rotation.ravel())
        self._state["belt_ratio"] = p.ratio_low
        self._state["speeds"][0] = p.idle_speed
        for _ in range(SETTLING_STEPS * SUBSTEPS):
            self._substeps(1, np.array((0.0, 0.0, 0.0, self._gears.engaged)), _NO_PLANTS)
            self._qpos[:2] = x, y
            self._qvel[:2], self._qvel[5] = 0, 0
            self._state["deflection"][:], self._state["speeds"][1:] = 0, 0
            self._state["brake_pressure"] = 0

    def _start(self, speed: float) -> None:
        p = self._parameters
        forward = self._data.xmat[1].reshape(3, 3)[:, 0]
        self._qvel[:] = 0
        self._qvel[:3] = speed * forward
        shaft = p.final_ratio * speed / p.rolling_radius
        ratio = np.clip(p.cruise_speed / max(shaft, 1.0), p.ratio_high, p.ratio_low)
        state = self._state
        state["belt_ratio"], state["brake_pressure"], state["steering"] = ratio, 0, 0
        state["speeds"][:] = max(p.idle_speed, shaft * ratio), *[speed / p.rolling_radius] * 4
        state["roof_touched"], state["tree_touched"] = 0, 0

    def _report_events(self) -> None:
        world = self._world
        low = np.add(world.origin, BORDER)
        high = np.add(world.origin, world.resolution * (np.array(world.elevation.shape[::-1]) - 1)) - BORDER
        inside = ((low <= self._qpos[:2]) & (self._qpos[:2] <= high)).all()
        tilt = 1 - 2 * (self._qpos[4] ** 2 + self._qpos[5] ** 2)
        happening = {
            "rollover": tilt < TILT_LIMIT or self._state["roof_touched"],
            "collision with a tree": self._state["tree_touched"],
            "left the world": not inside,
        }
        new = [event for event, happened in happening.items() if happened and event not in self._reported]
        self._reported.update(new)
        self._events += new

    def _wheel_truth(self) -> WheelTruth:
        wheels, world = self._state["wheels"].copy(), self._world
        kinds = main_kinds(world.kinds, world.origin, world.resolution, wheels["contact"][:, :2])
        slips = (wheels[name] for name in ("load", "slip_ratio", "slip_angle"))
        return WheelTruth(wheels["contact"], wheels["properties"], kinds, *slips)


def _grids(world: World) -> tuple[Any, ...]:
    # Arguments of `substeps`, which checks no bounds.
    elevation, properties = (np.ascontiguousarray(grid, float) for grid in (world.elevation, world.properties))
    if min(elevation.shape) < 2 or properties.shape != (*elevation.shape, len(GROUND_PROPERTIES)):
        raise ValueError(f"elevation has shape {elevation.shape}, properties of the ground {properties.shape}")
    return elevation, properties, *elevation.shape, *map(float, world.origin), float(world.resolution)


def _plants(world: World) -> tuple[Any, ...]:
    trees, bushes = world.trees, world.bushes
    trunks = np.column_stack((trees.foot[:, :2], trees.trunk_radius))
    shrubs = np.column_stack((bushes.foot[:, :2], bushes.radius, bushes.drag))
    return np.ascontiguousarray(trunks, float), len(trunks), np.ascontiguousarray(shrubs, float), len(shrubs)


_NO_PLANTS: Final = np.zeros((0, 3)), 0, np.zeros((0, 4)), 0
