"""Checks of the steering response: sign, delay and scale (`steering_fit.py`).

A pose with z down is mirrored, so that its steering sign appears inverted; gravity distinguishes this from a wrong
steering sign.
"""

import re
from collections.abc import Collection, Mapping
from typing import Final

import numpy as np
from jaxtyping import Float

from offpiste.core.conventions import GRAVITY
from offpiste.core.geometry import rotation_from_quaternion
from offpiste.inspection.course import under_way
from offpiste.inspection.driven_path import STEP, DrivenPath, on_path
from offpiste.inspection.findings import Cure, Finding
from offpiste.inspection.lags import LAGS, SURE, delay_cures, fit_lags, sampled
from offpiste.inspection.recorded_log import Recorded
from offpiste.inspection.steering_agreement import agreement
from offpiste.inspection.steering_delays import changing_delay, uneven_delay, window_delays
from offpiste.inspection.steering_fit import DYNAMIC_EFFECT, SteeringFit
from offpiste.inspection.steering_scale import check_scale, scale_note
from offpiste.logs.drive import Drive
from offpiste.rig.channels import unit_factor
from offpiste.rig.edits import Edit, absent, rounded
from offpiste.rig.labels import is_measured_steering, parse_label
from offpiste.rig.rig import Rig

_STEADY_OWN: Final = (-0.08, 0.5)
_DYNAMIC_OWN: Final = (-0.12, 0.4)
"""Ranges of delays that the vehicle itself causes in the steady and the dynamic fit [s]."""
_USUAL: Final = {"steer": 0.1, "steer_angle": 0.0}
"""Typical delay of fault-free vehicles in the dynamic fit, kept by remedies [s]."""
_TOGETHER: Final = 0.5
"""Maximum difference between the time offsets at start and end of a topic with a constant clock offset [s]."""
_CLEAR: Final = 0.7
"""Minimum correlation of the steady fit for checking the centre and changes of the delay."""
_LEAST_TURNING: Final = 10.0
"""Minimum time in motion for checking the turning [s]."""
_UNSIGNED: Final = 0.85
"""Minimum correlation with the magnitude of the yaw rate of a steering channel that has lost its sign."""
_CENTRED: Final = {"steer": 0.05, "steer_angle": 0.01}
"""Maximum steering at which fault-free vehicles drive straight due to trim or camber; [rad] for angles."""

_LEANS: Final = 0.4
"""Minimum correlation of inward lean that is sufficient evidence against a pose."""
_ON_SLOPES: Final = (0.5, 1.6)
"""Range of accelerations caused by gravity, as a multiple of gravity times slope, for either sign."""
_PUSHED_AFTER: Final = 0.1
"""Delay of the pedals' effect [s]."""
_VERTICAL: Final = 0.8
"""Minimum share of gravity on the z axis of a level accelerometer."""
_ONE_MOTION: Final = 0.5
"""Minimum correlation of two sensors that measure the same motion."""
_ACCELERATION: Final = re.compile(r"(?<![a-z])((lin(ear)?_?)?acc(el(eration|erometer)?)?s?[._ ]?|a[._ ]?)([xyz])$")
_TURN: Final = re.compile(r"(?<![a-z])(angular_vel(ocity)?|gyro(scope)?s?|omega|g|w)[._ ]?(z)$")
"""Names of IMU fields, without units."""


def check_steering(
    fits: Mapping[str, SteeringFit], drive: Drive, path: DrivenPath, *, measured: bool, cut: Collection[str] = ()
) -> list[Finding]:
    """Return findings on `steer` and `steer_angle`.

    Args:
        fits: result of `steering_fits`.
        measured: whether wheelbase and `max_steer` were measured, not drafted.
        cut: clipped channels, whose scale cannot be estimated.
    """
    findings: list[Finding] = []
    unsigned = set[str]()
    for name, fit in fits.items():
        without_sign = _without_sign(name, drive, path) if fit.steady.strength < _CLEAR else []
        if without_sign:
            findings += without_sign
            unsigned.add(name)
            continue
        if not fit.has_effect:
            findings.append(_without_effect(name, fit, drive))
            continue
        findings += _sign(name, fit, drive, path)
        read_as_angle = "steer_angle" in fits and drive.rig.reads_alike("steer", "steer_angle")
        if name != "steer" or not read_as_angle:
            delays = window_delays(drive.channels[name], path, drive.rig)
            findings += changing_delay(name, delays) or _delay(name, fit, drive.rig) or uneven_delay(name, delays)
        findings += _centre(name, fit, drive.rig)
    acting = {name: fit for name, fit in fits.items() if fit.has_effect and name not in {*cut, *unsigned}}
    turning = {name: fit for name, fit in acting.items() if drive.rig.channels[name].turns}
    if measured:
        findings += [scale_note(name, fit, drive.rig) for name, fit in turning.items()]
        others = {name: fit for name, fit in acting.items() if name not in turning}
        return findings + check_scale(others, None if cut or turning else agreement(drive, path), drive)
    return findings + [scale_note(name, fit, drive.rig) for name, fit in acting.items()]


def _without_sign(name: str, drive: Drive, path: DrivenPath) -> list[Finding]:
    """Return a finding if the magnitude of the yaw rate follows the steering but its sign does not."""
    steering = on_path(path, drive.channels[name])[:, 0]
    rows = under_way(path) & np.isfinite(steering) & np.isfinite(path.yaw_rate)
    if rows.sum() * STEP < _LEAST_TURNING:
        return []
    size = path.speed[rows] * (steering[rows] - steering[rows].min())
    follows = float(np.corrcoef(np.abs(path.yaw_rate[rows]), size)[0, 1]) if np.ptp(size) > 0 else 0.0
    if follows < _UNSIGNED:
        return []
    evidence = f"correlation of the size of the yaw rate with speed times {name} above its least value: {follows:.2f}"
    how = "its sign may be in a column of its own, as on CAN buses of VW (_VZ_, _sign): write both into one column"
    return [Finding("warning", name, "has no sign", evidence, how, 1.0)]


def _without_effect(name: str, fit: SteeringFit, drive: Drive) -> Finding:
    steady, dynamic = fit.steady, fit.dynamic
    evidence = f"correlation of the yaw rate with speed times {name}: {steady.r[steady.best()]:.2f} at best, "
    evidence += f"{dynamic.r[dynamic.best()]:.2f} with the change of the yaw rate, within 1.5 s"
    other = "look for another field; no model can do without steering"
    cures = _other_clocks(name, drive)
    if name != "steer":
        other = f'look for another field, or absent = ["{name}"]'
        cures = (*cures, absent(name, drive.rig))
    return Finding("warning", name, "does not turn the vehicle", evidence, other, 1.0, cures)


def _other_clocks(name: str, drive: Drive) -> tuple[Cure, ...]:
    """Return delays that align the steering topic with the pose or vice versa, e.g. for 18 s between GPS and UTC."""
    own, pose = drive.channels[name].time, drive.channels["position"].time
    begin, end = own[0] - pose[0], own[-1] - pose[-1]
    if abs(begin - end) > _TOGETHER or abs(begin) < LAGS[-1]:
        return ()
    late = (begin + end) / 2
    topics = {drive.rig.channels[name].topic: late, drive.rig.channels["position"].topic: -late}
    return tuple(
        tuple(
            Edit(f"channels.{channel}.delay", round(source.delay + float(by), 2))
            for channel, source in drive.rig.channels.items()
            if source.topic == topic
        )
        for topic, by in topics.items()
    )


def _sign(name: str, fit: SteeringFit, drive: Drive, path: DrivenPath) -> list[Finding]:
    if fit.sign >= 0:
        return []
    steady, dynamic = fit.steady, fit.dynamic
    evidence = f"correlation of the yaw rate (+ left) with speed times {name}: {steady.r[steady.best()]:+.2f}, "
    evidence += f"of its change {dynamic.r[dynamic.best()]:+.2f}"
    cures = [(Edit(f"channels.{name}.sign", -drive.rig.channels[name].sign),)]
    # A pose with z down is mirrored; lean distinguishes it from a steering channel that is positive to the right.
    if leans_inward(drive, path):
        cures.insert(0, (Edit("motion.axes", "ned" if drive.rig.motion.axes == "z up" else "z up"),))
    remedy = str(cures[0][0])
    return [Finding("warning", name, "is positive to the right", evidence, remedy, 1.0, tuple(cures))]


def leans_inward(drive: Drive, path: DrivenPath, least: float = 0.2) -> bool:
    """Return whether the body clearly leans into turns, which indicates z down for four-wheeled vehicles."""
    if "orientation" not in drive.channels:
        return False
    orientation = drive.channels["orientation"].linear(path.time, max_gap=np.inf)
    rotation = rotation_from_quaternion(np.nan_to_num(orientation, nan=0.5))
    roll = np.arctan2(rotation[:, 2, 1], rotation[:, 2, 2])
    aside = (path.forward * path.yaw_rate)[None]
    fit = fit_lags(roll, np.ones((len(roll), 1)), aside, np.zeros(1), under_way(path))
    return fit is not None and float(fit.r[0]) < -max(least, SURE * fit.r_sigma(0))


def check_upside_down(
    fits: Mapping[str, SteeringFit], drive: Drive, path: DrivenPath, recorded: Mapping[str, Recorded]
) -> list[Finding]:
    """Return a finding if gravity indicates that a pose read as z up has z down, without contrary evidence."""
    hills, imu = _rises(drive, path), _turns_as_pose(path, recorded)
    lean = leans_inward(drive, path, _LEANS)
    if max(hills, imu) > 0 or not (lean or min(hills, imu) < 0) or drive.rig.motion.axes != "z up":
        return []
    seen = ["the body leans into its curves"] * lean + ["it gains speed where its path rises"] * (hills < 0)
    seen += ["gyroscope and accelerometer turn the other way than it"] * (imu < 0)
    # Without mirroring, signs change from positive left to positive right.
    signs = (
        Edit(f"channels.{name}.sign", -drive.rig.channels[name].sign) for name, fit in fits.items() if fit.sign > 0
    )
    cure = (Edit("motion.axes", "ned"), *signs)
    what, remedy = "its z axis points down: the world is seen in a mirror", ", ".join(map(str, cure))
    pose = "orientation" if "orientation" in drive.channels else "yaw"
    return [Finding("warning", pose, what, ", ".join(seen), remedy, 1.0, (cure,), sure=False)]


def _rises(drive: Drive, path: DrivenPath) -> int:
    """Return 1 if the vehicle loses speed where its path rises, -1 if it gains speed, and 0 if unclear."""
    pedals = [name for name in ("throttle", "brake") if name in drive.channels]
    if "throttle" not in pedals:
        return 0
    pushed = [sampled(drive.channels[name], path.time - _PUSHED_AFTER, drive.rig) for name in pedals]
    base = np.stack((np.ones(len(path.time)), path.forward, path.forward**2, *pushed), axis=1)
    ahead = under_way(path) & (path.forward > 0)
    fit = fit_lags(path.acceleration, base, GRAVITY * path.slope[None], np.zeros(1), ahead)
    if fit is None or abs(fit.gain[0]) < _ON_SLOPES[0] + SURE * fit.gain_sigma(0) or abs(fit.gain[0]) > _ON_SLOPES[1]:
        return 0
    return int(-np.sign(fit.gain[0]))


def _turns_as_pose(path: DrivenPath, recorded: Mapping[str, Recorded]) -> int:
    """Return 1 if an IMU turns about the vertical like the pose, -1 if opposite, and 0 if unclear.

    The accelerometer gives the vertical, even if it is mounted upside down.
    """
    for topic in recorded.values():
        names = [parse_label(field).name for field in topic.fields]
        forces = {found[6]: row for row, name in enumerate(names) if (found := _ACCELERATION.search(name))}
        turns = [row for row, name in enumerate(names) if _TURN.search(name)]
        if set(forces) != {"x", "y", "z"} or not turns or len(topic.rising) < len(topic.time):
            continue
        x, y, z, turn = (
            np.interp(path.time, topic.time, topic.values[:, row]) for row in (*map(forces.get, "xyz"), turns[0])
        )
        up, size = float(np.nanmedian(z)), float(np.nanmedian(np.sqrt(x**2 + y**2 + z**2)))
        turned, pushed = (_correlation(*pair) for pair in ((turn, path.yaw_rate), (x, path.acceleration)))
        # Phones may report gravity with the opposite sign, which then also applies to the vehicle's acceleration.
        if abs(up) > _VERTICAL * size and abs(turned) > _ONE_MOTION and pushed > _ONE_MOTION:
            return int(np.sign(up) * np.sign(turned))
    return 0


def _correlation(one: Float[np.ndarray, " n"], other: Float[np.ndarray, " n"]) -> float:
    known = np.isfinite(one) & np.isfinite(other)
    varies = known.sum() > 1 and np.ptp(one[known]) > 0 and np.ptp(other[known]) > 0
    return float(np.corrcoef(one[known], other[known])[0, 1]) if varies else 0.0


def _delay(name: str, fit: SteeringFit, rig: Rig) -> list[Finding]:
    """Return a finding if both fits show a delay that the vehicle cannot cause."""
    lags = []
    for part, own, clear in ((fit.steady, _STEADY_OWN, _CLEAR), (fit.dynamic, _DYNAMIC_OWN, DYNAMIC_EFFECT)):
        best = part.best(sign=fit.sign)
        if best in (0, len(LAGS) - 1) or abs(part.r[best]) < clear:
            return []
        lag, sigma = part.delay(best)
        if max(own[0] - lag, lag - own[1]) < SURE * sigma:
            return []
        lags.append((lag, sigma))
    (steady, _), (dynamic, sigma) = lags
    if steady * dynamic < 0:
        return []
    when = "before" if dynamic < 0 else "after"
    evidence = f"the turning comes {abs(dynamic):.2f} ± {sigma:.2f} s {when} it"
    what = "is stamped after the motion that it causes" if dynamic < 0 else "comes long before the motion"
    usual = _USUAL["steer_angle" if is_measured_steering(name, rig) else "steer"]
    cures = delay_cures(name, dynamic, _DYNAMIC_OWN, rig, usual=usual)
    if name == "steer_angle" and rig.reads_alike("steer", "steer_angle"):
        cures = tuple((*cure, Edit("channels.steer.delay", cure[0].value)) for cure in cures)
    copied = "; if it is called a command, it is a copy of a measurement"
    remedy = ", ".join(map(str, cures[0])) + (copied if dynamic < 0 and not is_measured_steering(name, rig) else "")
    return [Finding("warning", name, what, evidence, remedy, min(abs(dynamic), 1.0), cures)]


def _centre(name: str, fit: SteeringFit, rig: Rig) -> list[Finding]:
    """Return a finding if the vehicle clearly drives straight at a non-zero steering value."""
    off_centre = abs(fit.centre) > _CENTRED[name] + SURE * fit.centre_sigma
    source = rig.channels[name]
    if fit.gripping.strength < _CLEAR or not off_centre or source.turns:
        return []
    per_unit = source.sign * unit_factor(name, source.unit, rig.vehicle.max_steer)
    edit = Edit(f"channels.{name}.offset", rounded(source.offset - fit.centre / per_unit))
    evidence = f"the vehicle goes straight at {fit.centre:.3f} ± {fit.centre_sigma:.3f}"
    return [Finding("warning", name, "is not zero straight ahead", evidence, str(edit), 0.5, ((edit,),))]
