"""Poses that are stamped wrong: the one delay that explains most of the times by which all else is apart from them.

A late pose looks like a yaw rate, a velocity and a steering that are all early. Every measured time between two
channels is compared with what healthy vehicles have, once as stamped and once with the heading, the position or both
late by some time. Each other sensor may be wrong by itself, too, at a cost: its differences count no more than that.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from offpiste.core.geometry import planar_body_from_world
from offpiste.inspection.driven_path import STEP, DrivenPath, fit_delayed
from offpiste.inspection.findings import Finding
from offpiste.inspection.lags import SURE, LagFit, fit_lags
from offpiste.inspection.pedals import EFFECTS
from offpiste.inspection.steering_fit import SteeringFit, moving_rows
from offpiste.inspection.velocity import fit_frames, fit_turn_rate, fit_wheel_speed, turn_rate_name
from offpiste.logs.drive import Drive
from offpiste.rig.edits import Edit
from offpiste.rig.labels import is_measured_steering

_LATE: Final = 0.12
"""Delays from here on are reported [s]."""
_ONE_MORE: Final = 9.0
"""Cost of one thing that is wrong: a difference of three standard deviations."""
_TRIED: Final = np.arange(-1.6, 1.61, 0.01)
"""Delays that are tried [s]."""
_SENSOR: Final = (0.0, 0.03)
"""Time by which one sensor is behind another of the same motion, and its spread among healthy logs [s]."""
_FOLLOWS: Final = 0.4
"""RMS difference to the pose's derivative over its RMS, below which a sensor shows the same motion."""
_SPINNING: Final = (-0.1, 0.2)
"""The same of wheels that spin before the vehicle moves."""
_ROLLING: Final = 0.06
"""Spread of wheels that roll [s]."""
_ALL_SPIN: Final = 0.2
"""Misfit of the wheels' speed from which they count as spinning."""
_PEDAL: Final = (0.1, 0.15)
_STEERING: Final = {"steer": (0.12, 0.07), "steer_angle": (0.0, 0.07)}
"""The same of the motion behind its controls."""
_POSE: Final = ("position", "orientation", "yaw")
_SENSORS: Final = {"steer": "steering", "steer_angle": "steering", "throttle": "pedals", "brake": "pedals"}
"""Channels of a topic that are late together."""
_SLOW: Final = 0.4
"""Delay of the pose behind its controls that a slow vehicle may have [s]: a tractor, one with much load."""
_CLEAR: Final = 0.5
"""Correlation above which a pedal shows a delay, of its own effect."""
_SLIP: Final = (-0.025, 0.012, 0.06)
"""Time by which the heading is behind the course, over the speed, its spread [s^2/m], and the spread of the rest [s]:
a rear axle slips in proportion to its lateral acceleration, at 1 rad for some 40 m/s^2."""
_COURSE: Final = 0.03
"""Lateral velocity over speed times yaw rate, both RMS, below which the heading is the course, as a GPS says it [s]."""
_FAR: Final = 0.4
"""Delay of the heading's turning behind the course's that no slip makes, where they follow each other [s]: of 40
healthy drives none has more than 0.27, drifts included."""
_SIDEWAYS: Final = 0.35
"""Lateral speed over forward speed beyond which a vehicle drifts."""


@dataclass(frozen=True)
class Interval:
    """A measured time by which one channel is behind another [s].

    Attributes:
        usual, spread: mean and standard deviation of what healthy logs show, uncertainty of the measurement included.
    """

    behind: str
    other: str
    time: float
    usual: float
    spread: float

    def cost(self, late: frozenset[str], by: np.ndarray) -> np.ndarray:
        """Squared difference from what is usual, in standard deviations, if some channels are late by these times."""
        moved = by * (int(self.behind in late) - int(self.other in late))
        return np.asarray(((self.time - self.usual - moved) / self.spread) ** 2)


def check_late_poses(
    drive: Drive, path: DrivenPath, steering: Mapping[str, SteeringFit], pedals: Mapping[str, LagFit]
) -> list[Finding]:
    """A finding if the pose's stamps explain more than those of all other channels do."""
    measured = [*_intervals(drive, path, steering, pedals)]
    found, least, delay = None, float(_costs(measured, (), np.zeros(1), drive)[0]) - _ONE_MORE - 1, 0.0
    for late in _hypotheses(drive):
        costs = _costs(measured, late, _TRIED, drive)
        best = int(costs.argmin())
        if costs[best] < least and abs(_TRIED[best]) > _LATE:
            found, least, delay = late, float(costs[best]), float(_TRIED[best])
    if found is None or (0 < delay <= _SLOW and not _beside_controls(measured, found, delay, drive)):
        return []
    channels = drive.rig.channels
    cure = tuple(Edit(f"channels.{name}.delay", round(channels[name].delay + delay, 2)) for name in found)
    apart = ", ".join(f"{i.behind} {i.time - i.usual:+.2f} s behind {i.other}" for i in measured if _wrong(i))
    evidence = f"{apart}, apart from what is usual: {delay:+.2f} s of {' and '.join(found)} explain most"
    what = "is late" if delay > 0 else "is early"
    return [Finding("warning", found[0], what, evidence, ", ".join(map(str, cure)), 0.9, (cure,))]


def _beside_controls(measured: Sequence[Interval], late: Sequence[str], by: float, drive: Drive) -> bool:
    """Whether a delay explains enough also if all that controls show may be a vehicle that answers slowly."""
    before = _costs(measured, (), np.zeros(1), drive, slow=True)[0]
    after = _costs(measured, late, np.full(1, by), drive, slow=True)[0]
    return bool(after < before - _ONE_MORE - 1)


def _costs(
    measured: Sequence[Interval], late: Sequence[str], by: np.ndarray, drive: Drive, *, slow: bool = False
) -> np.ndarray:
    """Costs of all intervals if some channels are late; those of one sensor cost no more than that it is wrong.

    Args:
        slow: those of all controls cost no more than one thing, a vehicle that answers slowly.
    """
    sensors: dict[object, np.ndarray] = {}
    for one in measured:
        name = one.other if one.other not in _POSE else one.behind
        source = drive.rig.channels[name]
        sensor = ("", "controls") if slow and name in _SENSORS else (source.topic, _SENSORS.get(name, name))
        sensors[sensor] = sensors.get(sensor, np.zeros(len(by))) + one.cost(frozenset(late), by)
    return sum((np.minimum(cost, _ONE_MORE) for cost in sensors.values()), np.zeros(len(by)))


def _wrong(interval: Interval) -> bool:
    return bool(abs(interval.time - interval.usual) > max(2 * interval.spread, _LATE / 2))


def _hypotheses(drive: Drive) -> Iterator[tuple[str, ...]]:
    """Channels that may be late together: the heading, the position, both, and with them what shares their topic."""
    heading, channels = _heading(drive), drive.rig.channels
    topic = channels["position"].topic
    beside = [name for name in ("linear_velocity", "angular_velocity", "yaw_rate") if name in channels]
    beside = [name for name in beside if channels[name].topic == topic]
    yield (heading,)
    yield ("position",)
    yield ("position", heading)
    if beside:
        yield ("position", heading, *beside)


def _heading(drive: Drive) -> str:
    return "yaw" if "yaw" in drive.channels else "orientation"


def _intervals(
    drive: Drive, path: DrivenPath, steering: Mapping[str, SteeringFit], pedals: Mapping[str, LagFit]
) -> Iterator[Interval]:
    heading = _heading(drive)
    velocity = None
    if "linear_velocity" in drive.channels:
        velocity = fit_frames(drive, path).get(drive.rig.channels["linear_velocity"].frame)
    wheels = fit_wheel_speed(drive, path)
    for behind, other, recorded, usual in (
        (turn_rate_name(drive), heading, fit_turn_rate(drive, path), _SENSOR),
        ("linear_velocity", "position", velocity, _SENSOR),
        ("wheel_speed", "position", wheels, _of_wheels(wheels.misfit if wheels else 1.0)),
    ):
        if recorded is not None and recorded.misfit < _FOLLOWS:
            yield _interval(behind, other, recorded.delay, recorded.delay_sigma, usual)
    for name, fit in steering.items():
        if fit.has_effect:
            usual = _STEERING["steer_angle" if is_measured_steering(name, drive.rig) else "steer"]
            yield _interval(heading, name, *fit.dynamic.delay(fit.dynamic.best(sign=fit.sign)), usual)
    for name, pedal in pedals.items():
        best = pedal.best(sign=EFFECTS[name])  # a driver who looks ahead lets go before it is slower
        if EFFECTS[name] * pedal.r[best] > _CLEAR and 0 < best < len(pedal.lags) - 1:
            yield _interval("position", name, *pedal.delay(best), _PEDAL)
    yield from _behind_the_course(heading, path)


def _of_wheels(misfit: float) -> tuple[float, float]:
    """Time by which wheels are behind the vehicle, and its spread [s]: the better they fit, the less they spin.

    Wheels that roll show almost as surely as a velocity whether the pose is on time.
    """
    spin, (ahead, spread) = min(misfit / _ALL_SPIN, 1.0), _SPINNING
    return spin * ahead, float(np.hypot(_ROLLING, spin * spread))


def _interval(behind: str, other: str, time: float, sigma: float, usual: tuple[float, float]) -> Interval:
    return Interval(behind, other, time, usual[0], float(np.hypot(usual[1], sigma)))


def _behind_the_course(heading: str, path: DrivenPath) -> Iterator[Interval]:
    """With the heading late by h, lateral velocity = x * rate + h * speed * rate, x forward of the rear axle."""
    far = _far_behind(path)
    if far is not None:
        yield _interval(heading, "position", *far, _SENSOR)
        return
    forward, lateral = planar_body_from_world(path.velocity, path.yaw).T
    with np.errstate(invalid="ignore"):
        rows = moving_rows(path) & (np.abs(lateral) < _SIDEWAYS * np.abs(forward))
    turning = forward * path.yaw_rate
    fit = fit_lags(lateral, path.yaw_rate[:, None], turning[None], np.zeros(1), rows)
    if fit is not None:
        share, spread, rest = _SLIP
        if np.nanmean(lateral[rows] ** 2) < _COURSE**2 * np.nanmean(turning[rows] ** 2):
            share = spread = 0.0  # no tyre slips against a heading that is the course
        slip, scatter = share * path.cruise, float(np.hypot(spread * path.cruise, rest))
        yield _interval(heading, "position", float(fit.gain[0]), fit.gain_sigma(0), (slip, scatter))


def _far_behind(path: DrivenPath) -> tuple[float, float] | None:
    """Delay of the heading's turning behind the course's, and its uncertainty [s]; None where it is not surely large.

    A heading that is late by much points anywhere: its angle to the course says no longer by how much.
    """
    change = np.gradient(path.velocity, STEP, axis=0)
    with np.errstate(invalid="ignore", divide="ignore"):
        turning = (path.velocity[:, 0] * change[:, 1] - path.velocity[:, 1] * change[:, 0]) / path.speed**2
    turning = np.where(moving_rows(path), turning, np.nan)
    fit = fit_delayed("", path.yaw_rate[:, None], turning[:, None])
    if fit is None or fit.misfit > _FOLLOWS or abs(fit.delay) < _FAR + SURE * fit.delay_sigma:
        return None
    return fit.delay, max(fit.delay_sigma, _SLIP[2])
