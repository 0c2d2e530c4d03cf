"""Meaning of recorded gears (letters, switches, selector positions), and checks of the gear against the motion."""

import re
from collections.abc import Mapping
from typing import Any, Final

import numpy as np
from jaxtyping import Bool, Float
from msgspec.structs import replace

from offpiste.core.errors import OffpisteError
from offpiste.inspection.driven_path import MOVING, STEP, DrivenPath, driven_path
from offpiste.inspection.findings import Finding, found, times
from offpiste.inspection.lags import LAGS, SURE, fit_lags, lagged, sampled
from offpiste.inspection.naming import Guess
from offpiste.inspection.recorded_log import Recorded
from offpiste.logs.channel import increasing
from offpiste.logs.drive import Drive, drive_from_log
from offpiste.logs.log import Log
from offpiste.rig.channels import unit_factor
from offpiste.rig.edits import Edit, absent, rounded
from offpiste.rig.rig import Rig

_LASTS: Final = 2.0
"""Minimum reported duration of reversing [s]; rolling back before driving off is shorter."""
_PRESSED: Final = 0.08
"""Minimum throttle of a driving, not rolling, vehicle."""
_SHARE: Final = 0.1
"""Minimum share of the motion against the gear for a wrong gear; vehicles roll back occasionally."""
_LEAST_AGAINST: Final = 3.0
"""Minimum time of motion against the gear [s]."""
_MOSTLY: Final = 0.7
"""Minimum share of the motion at one recorded value that contradicts the gear, however rare the value."""
MOST_GEARS: Final = 16
"""Maximum number of values of a gear."""
_REVERSE: Final = re.compile(r"reverse", re.IGNORECASE)
_SELECTOR: Final = re.compile(r"prnd", re.IGNORECASE)
_LETTERS: Final = {"P": 0, "R": -1, "N": 0, "D": 1}
"""Selector positions in order, and their gears."""
_BACKWARDS: Final = 0.2
"""Minimum share of backward driving at negative values of a pedal that reverses the vehicle."""
_DRIVES: Final = -0.3
"""Maximum correlation of acceleration and pedal, corrected for speed and slope, for driving backwards."""
_OWN_DELAY: Final = (0.0, 0.8)
"""Plausible delays of the acceleration after the pedal [s]."""
_DEAD_BAND: Final = 0.02
"""Dead band of a pedal whose sign is the direction."""
DIRECTION: Final = 0.5 / _DEAD_BAND
"""Scale at which such a pedal, 1 at most, rounds to its sign and serves as a gear."""
_CODES: Final = frozenset(map(float, range(ord("A"), ord("Z") + 1)))
"""Character codes of letters."""


def gear_values(guess: Guess, values: Float[np.ndarray, " n"]) -> dict[str, Any]:
    """Return `values`, the meaning of recorded gears that are letters, a reverse switch or selector positions."""
    there = {float(value) for value in np.unique(values)}
    named = (guess.topic, *guess.fields)
    numbers = {value for value in there if abs(value) <= MOST_GEARS}
    letters = {chr(int(value)) for value in there - numbers if value in _CODES}
    if letters & set(_LETTERS) and len(letters) == len(there - numbers):
        forward = dict.fromkeys(sorted(letters - set(_LETTERS)), 1)  # S, L, M: forward modes
        meanings = _LETTERS | forward | {f"{number:g}": int(np.sign(number)) for number in sorted(numbers)}
    elif there <= {0.0, 1.0} and any(map(_REVERSE.search, named)):
        meanings = {"0": 1, "1": -1}
    elif there <= {0.0, 1.0, 2.0, 3.0} and any(map(_SELECTOR.search, named)):
        meanings = {str(position): gear for position, gear in enumerate(_LETTERS.values())}
    else:
        return {}
    return {"values": meanings}


def check_gear(drive: Drive, path: DrivenPath, recorded: Mapping[str, Recorded]) -> list[Finding]:
    """Return a note if the vehicle reverses without a gear in the rig; a warning if the gear contradicts the motion."""
    if "gear" not in drive.channels:
        return [_reverse_pedal(drive.rig)] if pedal_reverses(drive, path) else _hidden_reverse(drive, path)
    moving = _moving(path)
    gear = drive.channels["gear"].hold(path.time, max_gap=drive.rig.clock.max_gap)[:, 0]
    with np.errstate(invalid="ignore"):
        driven_back = (gear == 0) & (path.forward < 0) & _pressed(drive, path)
        against = moving & ((gear * path.forward < 0) | driven_back)
        if drive.rig.reads_alike("throttle", "gear"):  # such a pedal brakes against the motion
            against &= gear * path.acceleration < 0
    share = float(against.sum() / max(moving.sum(), 1))
    raw = _raw(drive, path, recorded)
    # Reverse may be recorded as first gear: then the motion contradicts one value, however rare.
    at_values = [(np.sum(against & (raw == value)), np.sum(moving & (raw == value))) for value in _gears(raw)]
    one_wrong = any(STEP * wrong >= _LEAST_AGAINST and wrong > _MOSTLY * moved for wrong, moved in at_values)
    if against.sum() * STEP < _LEAST_AGAINST or (share < _SHARE and not one_wrong):
        return []
    cure = _meanings(drive, path, moving, raw)
    return [found("gear_against_motion", "gear", {"seconds": against.sum() * STEP}, cure, score=share)]


def pedal_reverses(drive: Drive, path: DrivenPath) -> bool:
    """Return True if the brake is the negative side of the throttle's field and drives the vehicle backwards."""
    if not drive.rig.reads_alike("throttle", "brake") or not {"throttle", "brake"} <= set(drive.channels):
        return False
    moving = _moving(path)
    with np.errstate(invalid="ignore"):
        backwards = moving & (path.forward < 0)
        below = backwards & (sampled(drive.channels["brake"], path.time, drive.rig) > _DEAD_BAND)
    seconds = STEP * below.sum()
    # A vehicle that mostly moves backwards has a reversed heading.
    if seconds < _LASTS or below.sum() < _BACKWARDS * backwards.sum() or backwards.sum() > 0.5 * moving.sum():
        return False
    base = np.stack([np.ones(len(path.time)), path.forward, path.slope], axis=1)
    fit = fit_lags(path.acceleration, base, lagged(drive.channels["brake"], path.time, drive.rig), LAGS, backwards)
    if fit is None:
        return False
    best = fit.best(*_OWN_DELAY)
    return float(fit.r[best]) < min(_DRIVES, -SURE * fit.r_sigma(best))


def reverses_by_pedal(log: Log, rig: Rig) -> bool:
    """Return True if negative throttle values are reverse (`pedal_reverses`) in this log.

    A separate brake does not change this.
    """
    throttle = rig.channels.get("throttle")
    if throttle is None or throttle.clip != (0.0, 1.0) or "gear" in rig.channels:
        return False
    below = replace(throttle, sign=-throttle.sign)
    absent = tuple(name for name in rig.absent if name != "brake")
    try:
        trial = replace(rig, channels={**rig.channels, "brake": below}, absent=absent)
        return pedal_reverses(drive := drive_from_log(log, trial), driven_path(drive))
    except OffpisteError:
        return False


def _reverse_pedal(rig: Rig) -> Finding:
    """Return a finding that the brake is reverse, with the edits that convert it to throttle and gear."""
    source = rig.channels["throttle"]
    each = DIRECTION * unit_factor("throttle", source.unit)
    gear: dict[str, Any] = {"topic": source.topic, "fields": list(source.fields), "scale": rounded(each * source.scale)}
    gear |= {"offset": rounded(each * source.offset)} if source.offset else {}
    gear |= {"sign": -1} if source.sign < 0 else {}
    cure = (Edit("channels.throttle.absolute", True), Edit("channels.gear", gear), *absent("brake", rig))
    return found("pedal_is_reverse", "brake", {"field": source.fields[0]}, cure)


def _hidden_reverse(drive: Drive, path: DrivenPath) -> list[Finding]:
    """Return a note on reversing with the throttle pressed that no channel records."""
    with np.errstate(invalid="ignore"):
        backwards = _moving(path) & (path.forward < 0)
    driven = backwards & _pressed(drive, path)
    edges = np.flatnonzero(np.diff(backwards.astype(int), prepend=0, append=0)).reshape(-1, 2)
    stretches = [(first, last) for first, last in edges if driven[first:last].sum() * STEP >= _LASTS]
    if not stretches:
        return []
    about = {
        "times": times(len(stretches)),
        "seconds": sum(last - first for first, last in stretches) * STEP,
        "since": path.time[stretches[0][0]] - path.time[0],
    }
    return [found("gear_unread", "gear", about)]


def _pressed(drive: Drive, path: DrivenPath) -> Bool[np.ndarray, " n"]:
    """Return the rows in which the throttle is pressed; none if it is unknown."""
    if "throttle" not in drive.channels:
        return np.zeros(len(path.time), bool)
    with np.errstate(invalid="ignore"):
        return np.asarray(sampled(drive.channels["throttle"], path.time, drive.rig) > _PRESSED)


def _moving(path: DrivenPath) -> Bool[np.ndarray, " n"]:
    with np.errstate(invalid="ignore"):
        return np.asarray(np.abs(path.forward) > max(MOVING, 0.1 * path.cruise))


def _meanings(
    drive: Drive, path: DrivenPath, moving: Bool[np.ndarray, " n"], raw: Float[np.ndarray, " n"]
) -> tuple[Edit, ...]:
    """Return the edit that maps each recorded value to the gear of the simultaneous motion; empty if none fits."""
    source = drive.rig.channels["gear"]
    there = _gears(raw)
    if len(there) < 2 or (source.scale, source.offset) != (1.0, 0.0):
        return ()
    values = {f"{value:g}": source.sign * _way(path.forward[moving & (raw == value)]) for value in there}
    return (Edit("channels.gear.values", values),) if len(set(values.values())) > 1 else ()


def _raw(drive: Drive, path: DrivenPath, recorded: Mapping[str, Recorded]) -> Float[np.ndarray, " n"]:
    """Return the gear as recorded with zero-order hold; NaN before the first sample and if missing."""
    source = drive.rig.channels["gear"]
    r = recorded.get(source.topic)
    if r is None or source.fields[0] not in r.fields:
        return np.full(len(path.time), np.nan)
    kept = increasing(r.time)
    time, value = r.time[kept], r.values[kept, r.fields.index(source.fields[0])]
    return np.append(np.nan, value)[np.searchsorted(time, path.time + source.delay, side="right")]


def _gears(raw: Float[np.ndarray, " n"]) -> Float[np.ndarray, " g"]:
    """Return the distinct values; none if there are too many for gears."""
    there = np.unique(raw[np.isfinite(raw)])
    return there if len(there) <= MOST_GEARS else there[:0]


def _way(forward: Float[np.ndarray, " n"]) -> float:
    """Return 1 for mostly forward motion, -1 for backward, 0 if ambiguous or nearly at rest."""
    if len(forward) * STEP < 1.0:
        return 0.0
    mean = float(np.mean(np.sign(forward)))
    return float(np.sign(mean)) if abs(mean) > 0.5 else 0.0
