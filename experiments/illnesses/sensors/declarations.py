"""Illnesses of cameras, LiDARs and the pose's height: each is declared once, with what a finding must say."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from experiments.illnesses.illness import UnknownIllness
from experiments.illnesses.sensors.case import ChangedLog, SensorCase, mounting_key, sensor_errors, true_mounting
from experiments.illnesses.sensors.drives import CAMERA, LIDAR
from offpiste.core.registry import Registry
from offpiste.inspection.misfit import turned
from offpiste.rig.rig import Rig

Change = Callable[[SensorCase, float, np.random.Generator], SensorCase]
Cured = Callable[[SensorCase, Rig], bool]

_ANGLE, _DELAY = 0.5, 0.015
"""A cure is right if it leaves at most this of a turn [deg] and of a delay [s]."""
_PERIOD: Final = 16.0
"""Period of the height that goes up and down [s]."""
_DEEPEST: Final = 13.0
"""Depth of the deepest return below the ground [m]."""


@dataclass(frozen=True)
class SensorIllness:
    """What is wrong with a sensor, or with its entry in the rig.

    Attributes:
        unit: of the strengths.
        strengths: graded, the weakest first.
        where: place of the finding that counts as found.
        what: words of it.
        consequences: places in which it may show too; a finding there neither finds it nor is a false alarm.
        cured: whether a rig undoes it, given the sick case; None where no entry can.
        change: the case with the illness of a strength.
    """

    name: str
    unit: str
    strengths: tuple[float, ...]
    where: str
    what: str
    consequences: tuple[str, ...]
    cured: Cured | None
    change: Change


SENSOR_ILLNESSES: Final[Registry[SensorIllness]] = Registry("sensor illness", error=UnknownIllness)
"""All of them by name."""


def _illness(
    name: str,
    strengths: tuple[float, ...],
    unit: str,
    where: str,
    what: str,
    *,
    consequences: tuple[str, ...] = (),
    cured: Cured | None = None,
) -> Callable[[Change], Change]:
    """Declare the illness that the decorated function makes; see `SensorIllness`."""

    def declare(change: Change) -> Change:
        one = SensorIllness(name, unit, strengths, where, what, consequences, cured, change)
        SENSOR_ILLNESSES.register(name)(one)
        return change

    return declare


def _declare_mounting(kind: str, name: str) -> None:
    def cured(case: SensorCase, rig: Rig) -> bool:
        angle, delay = sensor_errors(rig, case.layout, name)
        return angle <= _ANGLE and delay <= _DELAY

    # What a LiDAR that is turned shows of the ground and of the vehicle is at other places.
    others = (name, "poses", "LiDARs") if name == LIDAR else (name,)

    @_illness(f"{kind} turned", (0.5, 1.0, 2.0, 5.0), "deg", name, "degrees away", consequences=others, cured=cured)
    def _turned(case: SensorCase, strength: float, random: np.random.Generator) -> SensorCase:
        axis = random.standard_normal(3)
        turn = np.append(np.deg2rad(strength) * axis / np.linalg.norm(axis), 0.0)
        matrix = turned(true_mounting(case.layout, name), turn)
        orientation = Rotation.from_matrix(matrix[:3, :3]).as_quat().tolist()
        return case.with_rig((mounting_key(name), {"position": matrix[:3, 3].tolist(), "orientation": orientation}))

    @_illness(f"{kind} late", (20.0, 50.0, 100.0, 200.0), "ms", name, "too late", consequences=others, cured=cured)
    def _late(case: SensorCase, strength: float, random: np.random.Generator) -> SensorCase:
        """Stamps that are late under a rig that says nothing of it, by a rig that wrongly says that they are early."""
        return case.with_rig((f"{mounting_key(name).rpartition('.')[0]}.delay", -strength / 1e3))


_declare_mounting("camera", CAMERA)
_declare_mounting("LiDAR", LIDAR)


def with_ghosts(
    points: Float[np.ndarray, "n 3"], sensor: Float[np.ndarray, " 3"], share: float, rng: np.random.Generator
) -> Float[np.ndarray, "n 3"]:
    """Move a share of the points whose rays point down 0.7 to 13 m lower, along their rays."""
    if share <= 0:
        return points
    rays = points - sensor
    steep = np.flatnonzero(rays[:, 2] < -0.035 * np.linalg.norm(rays[:, :2], axis=1))
    chosen = rng.choice(steep, min(round(share * len(points)), len(steep)), replace=False)
    result = points.copy()
    result[chosen] += rays[chosen] * (rng.uniform(0.7, _DEEPEST, len(chosen)) / -rays[chosen, 2])[:, None]
    return result


@_illness("ghosts", (0.01, 0.05, 0.2), "% of the returns", "LiDARs", "ghosts")
def _ghosts(case: SensorCase, strength: float, random: np.random.Generator) -> SensorCase:
    """Returns up to 13 m below the ground."""
    sensor = case.layout.lidar.position
    return case.with_clouds(lambda points, rng: with_ghosts(points, sensor, strength / 100, rng), _seed(random))


@_illness("dust", (0.2, 1.0, 5.0), "% of the returns", "LiDARs", "much that moves", consequences=(LIDAR,))
def _dust(case: SensorCase, strength: float, random: np.random.Generator) -> SensorCase:
    """Returns in the air behind the vehicle, 3 to 8 m from the LiDAR, nearer along rays that end on something."""
    sensor = case.layout.lidar.position

    def dusty(points: np.ndarray, rng: np.random.Generator) -> np.ndarray:
        ray = points - sensor
        length = np.linalg.norm(ray, axis=1)
        behind = np.flatnonzero((ray[:, 0] < 0) & (length > 4.0))
        chosen = rng.choice(behind, min(round(strength / 100 * len(points)), len(behind)), replace=False)
        nearer = rng.uniform(3.0, np.minimum(length[chosen], 8.0))
        result = points.copy()
        result[chosen] = sensor + ray[chosen] * (nearer / length[chosen])[:, None]
        return result

    return case.with_clouds(dusty, _seed(random))


def _covers(rig: Rig, place: tuple[float, float, float]) -> bool:
    """Whether the box of the own body in a rig holds a place in the body frame."""
    box = rig.lidars[LIDAR].own_body
    return box is not None and all(low <= at <= high for low, at, high in zip(box[0], place, box[1], strict=True))


@_illness("post in view", (0.02, 0.05, 0.15), "m wide", LIDAR, "sees the vehicle itself", consequences=("LiDARs",),
          cured=lambda case, rig: _covers(rig, case.part))  # fmt: skip
def _post(case: SensorCase, strength: float, random: np.random.Generator) -> SensorCase:
    """A part of the vehicle that stands 1.0 to 1.6 m from the LiDAR, outside the box of its own body."""
    sensor = case.layout.lidar.position
    while True:
        away, around = random.uniform(1.0, 1.6), random.uniform(-np.pi, np.pi)
        x, y, z = sensor + away * np.array([np.cos(around), np.sin(around), -0.25])
        if not _covers(case.rig, (x, y, z)):
            break

    def with_post(points: np.ndarray, rng: np.random.Generator) -> np.ndarray:
        ray = points - sensor
        flat = np.hypot(ray[:, 0], ray[:, 1])
        beside = np.abs((np.arctan2(ray[:, 1], ray[:, 0]) - around + np.pi) % (2 * np.pi) - np.pi) * away
        hit = (beside < strength / 2) & (flat > away) & (np.abs(ray[:, 2]) * away / np.maximum(flat, 1e-3) < 0.5)
        result = points.copy()
        result[hit] = sensor + ray[hit] * (away / flat[hit])[:, None]
        return result

    return replace(case.with_clouds(with_post, _seed(random)), part=(x, y, z))


@_illness("camera freezes", (0.15, 0.5), "of the drive", CAMERA, "repeats images")
def _frozen(case: SensorCase, strength: float, random: np.random.Generator) -> SensorCase:
    """Shows one image for a part of the drive."""
    times = np.sort(case.log.stamps(case.rig.cameras[CAMERA].topic))
    length = round(strength * len(times))
    start = int(random.integers(0, len(times) - length))
    first, last = times[start], times[start + length]
    frozen = ChangedLog(case.log, shown=lambda time: np.where((time >= first) & (time <= last), first, time))
    return replace(case, log=frozen)


@_illness("pose's height drifts", (0.02, 0.06, 0.2), "m/s", "poses", "drift in height", consequences=("LiDARs",))
def _height(case: SensorCase, strength: float, random: np.random.Generator) -> SensorCase:
    """Height of the pose that goes up for 8 s, and down for 8 s."""

    def height(time: np.ndarray) -> np.ndarray:
        half = _PERIOD / 2
        return strength * half * np.abs((time - time[0]) / half % 2 - 1)

    return replace(case, log=ChangedLog(case.log, height=height))


def _seed(random: np.random.Generator) -> int:
    return int(random.integers(1 << 30))
