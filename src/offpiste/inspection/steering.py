"""Checks of the steering: effect, sign, delay, centre and scale (`response.py`)."""

from collections.abc import Collection, Mapping
from typing import Final

import numpy as np

from offpiste.inspection.delays import changing_delay, check_delay, drifting_delay, window_delays
from offpiste.inspection.driven_path import DrivenPath
from offpiste.inspection.findings import Cure, Finding, found
from offpiste.inspection.lags import LAGS, SURE, fit_lags, lagged
from offpiste.inspection.response import SteeringFit, moving_rows
from offpiste.inspection.steering_scale import check_scale, scale_note
from offpiste.logs.drive import Drive
from offpiste.rig.channels import unit_factor
from offpiste.rig.edits import Edit, absent, rounded
from offpiste.rig.rig import Rig

_TOGETHER: Final = 0.5
"""Maximum difference between the time offsets at start and end of a topic with a constant clock offset [s]."""
_CLEAR: Final = 0.7
"""Minimum correlation of the settled fit for estimating the centre."""
_UNSIGNED: Final = 0.85
"""Minimum correlation with the magnitude of the yaw rate of a steering channel that has lost its sign."""
_CENTRED: Final = {"steer": 0.05, "steer_angle": 0.01}
"""Maximum steering at which fault-free vehicles drive straight due to trim or camber; [rad] for angles."""


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
    scaled = dict[str, SteeringFit]()
    for name, fit in fits.items():
        if unsigned := _without_sign(name, fit, drive, path):
            findings += unsigned
        elif not fit.has_effect:
            findings.append(_without_effect(name, fit, drive))
        else:
            findings += _sign(name, fit, drive.rig) + _centre(name, fit, drive.rig)
            if name != "steer" or not ("steer_angle" in fits and drive.rig.reads_alike("steer", "steer_angle")):
                delays = window_delays(drive.channels[name], path, drive.rig)
                constant = check_delay(name, fit.dynamic, drive.rig, sign=fit.sign, steady=fit.steady)
                findings += drifting_delay(name, delays) or constant or changing_delay(name, delays)
            if name not in cut:
                scaled[name] = fit
    noted = [name for name in scaled if not measured or drive.rig.channels[name].turns]
    findings += [scale_note(name, scaled[name], drive.rig) for name in noted]
    return findings + check_scale({name: fit for name, fit in scaled.items() if name not in noted}, drive, path)


def _without_sign(name: str, fit: SteeringFit, drive: Drive, path: DrivenPath) -> list[Finding]:
    """Return a finding if the magnitude of the yaw rate follows the steering but its sign does not."""
    if fit.steady.strength >= _CLEAR:
        return []
    asked = path.speed * lagged(drive.channels[name], path.time, drive.rig)
    size = fit_lags(np.abs(path.yaw_rate), path.speed[:, None], asked, LAGS, moving_rows(path))
    if size is None or size.strength < _UNSIGNED:
        return []
    return [found("steering_unsigned", name, {"size": size.strength, "signed": fit.steady.strength})]


def _without_effect(name: str, fit: SteeringFit, drive: Drive) -> Finding:
    cures = _other_clocks(name, drive)
    if name != "steer":
        cures = (*cures, absent(name, drive.rig))
    return found("steering_without_effect", name, _correlations(fit), *cures, remedy=name, fixed=name)


def _correlations(fit: SteeringFit) -> dict[str, float]:
    return {"steady": fit.steady.r[fit.steady.best()], "dynamic": fit.dynamic.r[fit.dynamic.best()]}


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


def _sign(name: str, fit: SteeringFit, rig: Rig) -> list[Finding]:
    if fit.sign >= 0:
        return []
    edit = Edit(f"channels.{name}.sign", -rig.channels[name].sign)
    return [found("steering_sign", name, _correlations(fit), (edit,))]


def _centre(name: str, fit: SteeringFit, rig: Rig) -> list[Finding]:
    """Return a finding if the vehicle clearly drives straight at a non-zero steering value."""
    off_centre = abs(fit.centre) > _CENTRED[name] + SURE * fit.centre_sigma
    source = rig.channels[name]
    if fit.settled.strength < _CLEAR or not off_centre or source.turns:
        return []
    per_unit = source.sign * unit_factor(name, source.unit, rig.vehicle.max_steer)
    edit = Edit(f"channels.{name}.offset", rounded(source.offset - fit.centre / per_unit))
    return [found("steering_centre", name, {"centre": fit.centre, "sigma": fit.centre_sigma}, (edit,))]
