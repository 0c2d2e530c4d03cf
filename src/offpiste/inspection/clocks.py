"""Check for clocks that drift against the pose's clock, by wheel speeds."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from offpiste.core.channels import control_of
from offpiste.inspection.driven_path import DrivenPath
from offpiste.inspection.findings import Finding, Severity
from offpiste.inspection.recorded_log import Recorded
from offpiste.inspection.signals import field_in_words
from offpiste.logs.channel import Channel
from offpiste.logs.clock_drift import estimate_lag
from offpiste.rig.edits import Edit, rounded
from offpiste.rig.rig import Rig

_FOLLOWS = 0.97
"""Minimum correlation of a wheel speed field with the speed."""
_MAX_LAG = 4.0
_LATE = 0.15
"""Minimum reported lag [s]."""
_LEADS = -2.0
"""Lower limit of a commanded speed's lag; vehicles respond faster than this [s]."""
_SLIP = (-0.6, _LATE)
"""Lags explained by wheels that spin or lock [s]."""
_CHANGE = 0.3
"""Minimum change between the 5th and 95th percentile of the lag that counts as drift [s]."""


@dataclass(frozen=True)
class WheelSpeed:
    """A field proportional to the speed: speed = scale * value [m/s]."""

    topic: str
    field: str
    scale: float
    correlation: float
    samples: Channel


def find_wheel_speeds(recorded: dict[str, Recorded], path: DrivenPath, *, besides: set[str]) -> list[WheelSpeed]:
    """Return fields of non-pose topics that are proportional to the speed, with lags up to two seconds."""
    result = []
    for topic, r in recorded.items():
        if topic in besides or len(r.time) < 200:
            continue
        keep = np.append(True, r.time[1:] > r.time[:-1]) & np.isfinite(r.values).all(axis=1) & np.isfinite(r.time)
        for field, values in zip(r.fields, r.values[keep].T, strict=True):
            wheel = _proportional(path, topic, field, r.time[keep], values)
            if wheel is not None:
                result.append(wheel)
    return result


def check_clocks(recorded: dict[str, Recorded], path: DrivenPath, rig: Rig, *, besides: set[str]) -> list[Finding]:
    """Return a finding for each clock of the rig's channels that is late or drifts, one per group of equal stamps."""
    known = set(rig.alignment.topics) if rig.alignment else set()
    # If the throttle commands the motor speed, the vehicle's speed follows later: a response, not a clock error.
    controls = [source for name, source in rig.channels.items() if control_of(name) is not None]
    commanded = {(source.topic, field) for source in controls for field in source.fields}
    findings: list[Finding] = []
    checked: set[str] = set()
    for wheel in sorted(find_wheel_speeds(recorded, path, besides=besides | known), key=lambda w: -w.correlation):
        if wheel.topic in checked or (wheel.topic, wheel.field) in commanded:
            continue
        together = {t for t, r in recorded.items() if np.array_equal(r.time, recorded[wheel.topic].time)}
        shared = [topic for topic in recorded if topic in together - besides]
        checked |= together
        if not any(source.topic in shared for source in rig.channels.values()):
            continue
        speed = np.isfinite(path.speed)
        reference = Channel("speed", "m/s", path.time[speed], path.speed[speed, None])
        lag = estimate_lag(reference, wheel.samples, max_lag=_MAX_LAG).lag
        low, middle, high = np.percentile(lag, (5, 50, 95))
        field = field_in_words(wheel.topic, wheel.field)
        source = {"topic": wheel.topic, "fields": [wheel.field], "scale": rounded(wheel.scale)}
        readers = {name for name, source in rig.channels.items() if source.topic in shared}
        if all(map(control_of, readers)) and _LEADS < low <= high < _LATE:
            continue  # a commanded speed, followed by the vehicle's
        slips = _SLIP[0] < low <= high < _SLIP[1]
        if together & besides:  # a clock is not ahead of itself, however far wheels run ahead
            slips = low < -_LATE or high < _SLIP[1]
        if high - low > _CHANGE and slips:
            continue
        evidence = f"{field} follows the speed (correlation {wheel.correlation:.2f}), "
        evidence += f"{low:+.2f} to {high:+.2f} s late (5 to 95 %)"
        if high - low > _CHANGE:
            edit = Edit("alignment", {"topics": shared, "speed": source, "max_lag": _MAX_LAG})
            where, what = ", ".join(shared), "has a clock that drifts"
            findings.append(Finding(_severity(shared, rig), where, what, evidence, str(edit), 0.9, ((edit,),)))
        else:
            findings += _constant(shared, float(middle), evidence, rig)
    return findings


def _constant(topics: list[str], lag: float, evidence: str, rig: Rig) -> list[Finding]:
    """Return a finding for a constant lag not yet covered by the delays of the rig's channels."""
    sources = {name: source for name, source in rig.channels.items() if source.topic in topics}
    readers = [name for name, source in sources.items() if abs(lag - source.delay) > _LATE]
    if abs(lag) <= _LATE or not readers:
        return []
    cure = tuple(Edit(f"channels.{name}.delay", round(lag, 2)) for name in readers)
    what = "is late" if lag > 0 else "is early"
    return [Finding(_severity(topics, rig), ", ".join(topics), what, evidence, ", ".join(map(str, cure)), 0.8, (cure,))]


def _severity(topics: list[str], rig: Rig) -> Severity:
    """Return the severity; leads caused by wheel slip are harmless if no model reads channels of that clock."""
    readers = {name for name, source in rig.channels.items() if source.topic in topics}
    return "warning" if readers - {"wheel_speed"} else "note"


def _proportional(
    path: DrivenPath, topic: str, field: str, time: Float[np.ndarray, " n"], values: Float[np.ndarray, " n"]
) -> WheelSpeed | None:
    speed = np.nan_to_num(path.speed)
    if len(values) < 200 or np.ptp(values) == 0 or speed.std() < 0.1 * speed.mean():
        return None
    best, scale = 0.0, 0.0
    fast = speed > min(0.5, 0.5 * path.cruise)
    for lag in np.arange(-_MAX_LAG / 2, _MAX_LAG / 2 + 0.01, 0.25):
        value = np.abs(np.interp(path.time + lag, time, values))
        if value.std() == 0:
            continue
        correlation = float(np.corrcoef(value, speed)[0, 1])
        if correlation > best:
            best, scale = correlation, float(np.median(speed[fast]) / max(np.median(value[fast]), 1e-9))
    if best < _FOLLOWS:
        return None
    # Proportional, not only correlated: a gear or a throttle may rise with the speed, too.
    value = np.abs(np.interp(path.time, time, values)) * scale
    if np.sqrt(np.mean((value - speed) ** 2)) > 0.3 * np.sqrt(np.mean(speed**2)):
        return None
    return WheelSpeed(topic, field, scale, best, Channel("wheel_speed", "m/s", time, np.abs(values)[:, None] * scale))
