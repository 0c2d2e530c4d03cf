"""Check for incorrectly stamped poses: the common delay that best explains all measured time differences.

A late pose makes yaw rate, velocity and steering appear early. Each measured delay between two channels is compared
with usual values, as stamped and with the heading, the position or both delayed. Any other sensor may also be wrong,
at a fixed cost that limits its contribution.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from offpiste.core.geometry import planar_body_from_world
from offpiste.inspection.driven_path import STEP, DrivenPath, fit_delayed, heading_name
from offpiste.inspection.findings import Finding, found
from offpiste.inspection.lags import SURE, LagFit, fit_lags
from offpiste.inspection.response import PRIORS, SteeringFit, moving_rows, prior
from offpiste.inspection.velocity import fit_frames, fit_turn_rate, fit_wheel_speed, turn_rate_name
from offpiste.logs.drive import Drive
from offpiste.rig.edits import Edit

_LATE: Final = 0.12
"""Minimum reported delay [s]."""
_ONE_MORE: Final = 9.0
"""Cost of one faulty sensor: a difference of three standard deviations."""
_TRIED: Final = np.arange(-1.6, 1.61, 0.01)
"""Candidate delays [s]."""
_SENSOR: Final = (0.0, 0.03)
"""Usual delay between two sensors of the same motion, and its standard deviation [s]."""
_FOLLOWS: Final = 0.4
"""Maximum RMS difference to the pose's derivative over its RMS for a sensor of the same motion."""
_SPINNING: Final = (-0.1, 0.2)
"""Usual delay and standard deviation for wheels that spin up before the vehicle moves [s]."""
_ROLLING: Final = 0.06
"""Standard deviation for rolling wheels [s]."""
_ALL_SPIN: Final = 0.2
"""Misfit of the wheel speed above which the wheels count as spinning."""
_POSE: Final = ("position", "orientation", "yaw")
_SENSORS: Final = {"steer": "steering", "steer_angle": "steering", "throttle": "pedals", "brake": "pedals"}
"""Groups of channels delayed together."""
_SLOW: Final = 0.4
"""Maximum delay of the pose behind its controls for a slow vehicle, such as a tractor or a loaded one [s]."""
_CLEAR: Final = 0.5
"""Minimum correlation for a pedal to determine a delay."""
_SLIP: Final = (-0.025, 0.012, 0.06)
"""Delay of the heading behind the course over the speed, its standard deviation [s^2/m], and that of the remainder [s]:
a rear axle slips in proportion to its lateral acceleration, by 1 rad at about 40 m/s^2."""
_COURSE: Final = 0.03
"""Maximum RMS lateral velocity over RMS speed times yaw rate for a heading from the course, e.g. by GNSS [s]."""
_FAR: Final = 0.4
"""Minimum delay of the heading's turning behind the course's that slip cannot explain [s]: the maximum of 40 sound
drives is 0.27, drifts included."""
_SIDEWAYS: Final = 0.35
"""Ratio of lateral to forward speed above which a vehicle drifts."""


@dataclass(frozen=True)
class Interval:
    """Measured delay of one channel behind another [s].

    Attributes:
        usual, spread: mean and standard deviation in sound logs, including measurement uncertainty.
    """

    behind: str
    other: str
    time: float
    usual: float
    spread: float

    def cost(self, late: frozenset[str], by: np.ndarray) -> np.ndarray:
        """Return the squared deviation from the usual delay, in sigmas, with some channels late by these times."""
        moved = by * (int(self.behind in late) - int(self.other in late))
        return np.asarray(((self.time - self.usual - moved) / self.spread) ** 2)


def check_late_poses(
    drive: Drive, path: DrivenPath, steering: Mapping[str, SteeringFit], pedals: Mapping[str, LagFit]
) -> list[Finding]:
    """Return a finding if a pose delay explains the measurements better than delays of all other channels."""
    measured = [*_intervals(drive, path, steering, pedals)]
    late: tuple[str, ...] = ()
    least, delay = float(_costs(measured, (), np.zeros(1), drive)[0]) - _ONE_MORE - 1, 0.0
    for channels in _hypotheses(drive):
        costs = _costs(measured, channels, _TRIED, drive)
        best = int(costs.argmin())
        if costs[best] < least and abs(_TRIED[best]) > _LATE:
            late, least, delay = channels, float(costs[best]), float(_TRIED[best])
    if not late or (0 < delay <= _SLOW and not _beside_controls(measured, late, delay, drive)):
        return []
    sources = drive.rig.channels
    cure = tuple(Edit(f"channels.{name}.delay", round(sources[name].delay + delay, 2)) for name in late)
    wrong = [i for i in measured if abs(i.time - i.usual) > max(2 * i.spread, _LATE / 2)]
    apart = ", ".join(f"{i.behind} {i.time - i.usual:+.2f} s behind {i.other}" for i in wrong)
    about = {"apart": apart, "delay": delay, "together": " and ".join(late)}
    return [found("pose_late" if delay > 0 else "pose_early", late[0], about, cure)]


def _beside_controls(measured: Sequence[Interval], late: Sequence[str], by: float, drive: Drive) -> bool:
    """Return True if a delay still explains enough when all control delays may be due to a slow vehicle."""
    before = _costs(measured, (), np.zeros(1), drive, slow=True)[0]
    after = _costs(measured, late, np.full(1, by), drive, slow=True)[0]
    return bool(after < before - _ONE_MORE - 1)


def _costs(
    measured: Sequence[Interval], late: Sequence[str], by: np.ndarray, drive: Drive, *, slow: bool = False
) -> np.ndarray:
    """Return the total cost of all intervals for delayed channels; each sensor's cost is capped at that of a fault.

    Args:
        slow: cap the cost of all controls at that of one fault, a slow vehicle.
    """
    sensors: dict[object, np.ndarray] = {}
    for one in measured:
        name = one.other if one.other not in _POSE else one.behind
        source = drive.rig.channels[name]
        sensor = ("", "controls") if slow and name in _SENSORS else (source.topic, _SENSORS.get(name, name))
        sensors[sensor] = sensors.get(sensor, np.zeros(len(by))) + one.cost(frozenset(late), by)
    return sum((np.minimum(cost, _ONE_MORE) for cost in sensors.values()), np.zeros(len(by)))


def _hypotheses(drive: Drive) -> Iterator[tuple[str, ...]]:
    """Yield channels that may be late together: heading, position, both, or both with channels of their topic."""
    heading, channels = heading_name(drive), drive.rig.channels
    topic = channels["position"].topic
    beside = [name for name in ("linear_velocity", "angular_velocity", "yaw_rate") if name in channels]
    beside = [name for name in beside if channels[name].topic == topic]
    yield (heading,)
    yield ("position",)
    yield ("position", heading)
    if beside:
        yield ("position", heading, *beside)


def _intervals(
    drive: Drive, path: DrivenPath, steering: Mapping[str, SteeringFit], pedals: Mapping[str, LagFit]
) -> Iterator[Interval]:
    heading = heading_name(drive)
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
            own = prior(name, drive.rig)
            yield _interval(heading, name, *fit.dynamic.delay(fit.dynamic.best(sign=fit.sign)), (own.usual, own.spread))
    for name, pedal in pedals.items():
        own = PRIORS[name]
        best = pedal.best(sign=own.sign)  # drivers may lift off in anticipation before the vehicle slows
        if own.sign * pedal.r[best] > _CLEAR and 0 < best < len(pedal.lags) - 1:
            yield _interval("position", name, *pedal.delay(best), (own.usual, own.spread))
    yield from _behind_the_course(heading, path)


def _of_wheels(misfit: float) -> tuple[float, float]:
    """Return the usual delay of wheels behind the vehicle, and its standard deviation [s]: better fits have less spin.

    Rolling wheels determine a pose delay almost as well as a velocity.
    """
    spin, (ahead, spread) = min(misfit / _ALL_SPIN, 1.0), _SPINNING
    return spin * ahead, float(np.hypot(_ROLLING, spin * spread))


def _interval(behind: str, other: str, time: float, sigma: float, usual: tuple[float, float]) -> Interval:
    return Interval(behind, other, time, usual[0], float(np.hypot(usual[1], sigma)))


def _behind_the_course(heading: str, path: DrivenPath) -> Iterator[Interval]:
    """Yield the heading's delay h from lateral velocity = x * rate + h * speed * rate, x forward of the rear axle."""
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
            share = spread = 0.0  # no tyre slip in a heading derived from the course
        slip, scatter = share * path.cruise, float(np.hypot(spread * path.cruise, rest))
        yield _interval(heading, "position", float(fit.gain[0]), fit.gain_sigma(0), (slip, scatter))


def _far_behind(path: DrivenPath) -> tuple[float, float] | None:
    """Return the delay of the heading's turning behind the course's and its uncertainty [s]; None if not clearly large.

    For long delays, the angle between heading and course no longer measures the delay.
    """
    change = np.gradient(path.velocity, STEP, axis=0)
    with np.errstate(invalid="ignore", divide="ignore"):
        turning = (path.velocity[:, 0] * change[:, 1] - path.velocity[:, 1] * change[:, 0]) / path.speed**2
    turning = np.where(moving_rows(path), turning, np.nan)
    fit = fit_delayed("", path.yaw_rate[:, None], turning[:, None])
    if fit is None or fit.misfit > _FOLLOWS or abs(fit.delay) < _FAR + SURE * fit.delay_sigma:
        return None
    return fit.delay, max(fit.delay_sigma, _SLIP[2])
