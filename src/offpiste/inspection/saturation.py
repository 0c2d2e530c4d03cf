"""Check for channels that are clipped although the vehicle turns further."""

from typing import Final

import numpy as np
from jaxtyping import Float

from offpiste.inspection.driven_path import TURNING, DrivenPath
from offpiste.inspection.findings import Finding
from offpiste.inspection.lags import LAGS, SURE, fit_lags, lagged
from offpiste.inspection.steering_fit import moving_rows
from offpiste.logs.channel import Channel
from offpiste.logs.drive import Drive
from offpiste.rig.rig import Rig

_PILED: Final = 0.04
"""Minimum share of samples exactly at one of the two ends."""
_NEAR: Final = 0.98
"""Minimum share of the maximum for a sample at the end."""
_FURTHER: Final = 0.1
"""Minimum excess of turning at the ends over the prediction; at full lock, slip reduces the turning."""
_FURTHER_AT_LOCK: Final = 0.5
"""The same for a command that ends at 1; slow actuators turn furthest while it is held there."""


def check_saturation(drive: Drive, path: DrivenPath) -> list[Finding]:
    """Return a finding for each clipped channel among `steer`, `steer_angle` and `yaw_rate`."""
    if np.nanstd(path.yaw_rate) < TURNING:
        return []
    findings = []
    for name in ("steer", "steer_angle", "yaw_rate"):
        channel = drive.channels.get(name)
        if channel is None or drive.rig.channels[name].turns:  # turning on the spot exceeds any steering lock
            continue
        size = np.abs(channel.values[:, 0])
        piled = float(np.mean(size >= size.max() * (1 - 1e-6)))
        if piled < _PILED or size.max() == 0:
            continue
        further, sigma = _further(channel, path, drive.rig)
        at_lock = name == "steer" and np.isclose(size.max(), 1.0, rtol=1e-3)
        if further < (_FURTHER_AT_LOCK if at_lock else _FURTHER) + SURE * sigma:
            continue
        evidence = f"{piled:.0%} of its samples are {size.max():.3g}, and there the vehicle turns {1 + further:.1f} ± "
        evidence += f"{sigma:.1f} times as much as its other samples foretell"
        how = "no rig line fixes it: record its whole range, or take another field"
        findings.append(Finding("warning", name, "is cut off at its largest value", evidence, how, min(piled, 1.0)))
    return findings


def _further(channel: Channel, path: DrivenPath, rig: Rig) -> tuple[float, float]:
    """Return the relative excess of turning at the ends over the prediction, and its standard deviation.

    For steering, understeer has its own term. Returns (0, inf) if the data do not show the excess.
    """
    value = lagged(channel, path.time, rig)
    rows = moving_rows(path)
    if channel.name == "yaw_rate":
        base, turning = np.ones((len(path.time), 1)), value
    else:
        wheel = np.tan(np.clip(value, -1.4, 1.4)) if channel.name == "steer_angle" else value
        base, turning = path.forward[:, None], path.forward * wheel
    best = fit_lags(path.yaw_rate, base, turning, LAGS, rows)
    if best is None:
        return 0.0, np.inf
    at: Float[np.ndarray, " n"] = turning[best.best()]
    with np.errstate(invalid="ignore"):
        ends = np.abs(value[best.best()]) >= _NEAR * np.abs(channel.values[:, 0]).max()
    slower = [] if channel.name == "yaw_rate" else [path.forward**2 * at]
    inside = fit_lags(path.yaw_rate, base, at[None], np.zeros(1), rows & ~ends)
    more = fit_lags(path.yaw_rate, np.column_stack((base, at, *slower)), (ends * at)[None], np.zeros(1), rows)
    if inside is None or more is None:
        return 0.0, np.inf
    usual = float(inside.gain[0])
    return float(more.gain[0]) / usual, more.gain_sigma(0) / abs(usual)
