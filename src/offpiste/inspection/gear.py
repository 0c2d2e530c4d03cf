"""The gear: what recorded letters, switches and positions of a selector stand for, and checks against the motion."""

import re
from collections.abc import Mapping
from typing import Any, Final

import numpy as np
from jaxtyping import Bool, Float
from msgspec.structs import replace

from offpiste.core.conventions import GRAVITY
from offpiste.core.errors import OffpisteError
from offpiste.inspection.channel_guesses import Guess
from offpiste.inspection.driven_path import MOVING, STEP, DrivenPath, driven_path
from offpiste.inspection.findings import Finding
from offpiste.inspection.lags import LAGS, SURE, fit_lags, lagged, sampled
from offpiste.inspection.recorded_log import Recorded
from offpiste.inspection.usual_ranges import rests_between, scaled_to_unit
from offpiste.logs.channel import increasing
from offpiste.logs.drive import Drive, drive_from_log
from offpiste.logs.log import Log
from offpiste.rig.channels import unit_factor
from offpiste.rig.edits import Edit, absent, rounded
from offpiste.rig.rig import Rig

_LASTS: Final = 2.0
"""Shortest stretch of reversing that is reported [s]: rolling back before driving off is shorter."""
_PRESSED: Final = 0.08
"""Throttle above which a vehicle drives, and does not roll."""
_SHARE: Final = 0.1
"""Share of the motion against the gear from which the gear is wrong; vehicles roll back now and then."""
_LEAST_AGAINST: Final = 3.0
"""The same in time [s]."""
_MOSTLY: Final = 0.7
"""Share of the motion with one recorded value from which it is wrong, however seldom it is engaged."""
MOST_GEARS: Final = 16
"""A field with more values is no gear."""
_REVERSE: Final = re.compile(r"reverse", re.IGNORECASE)
_SELECTOR: Final = re.compile(r"prnd", re.IGNORECASE)
_LETTERS: Final = {"P": 0, "R": -1, "N": 0, "D": 1}
"""Positions of a selector, in its order, and the gear of each."""
_BACKWARDS: Final = 0.2
"""Share of the driving backwards for which a pedal that reverses the vehicle is below zero, at least."""
_DRIVES: Final = -0.3
"""Correlation of acceleration and pedal, with speed and slope taken out, below which it drives backwards."""
_OWN_DELAY: Final = (0.0, 0.8)
"""Delays of the acceleration behind the pedal that are the vehicle's own [s]."""
_DEAD_BAND: Final = 0.02
"""Size of a pedal whose sign is the direction, from which it counts."""
DIRECTION: Final = 0.5 / _DEAD_BAND
"""Scale of such a pedal, 1 at most, by which it is a gear: rounded, it is its sign."""
_HALFWAY: Final = (0.2, 0.8)
"""Where a throttle that goes both ways is released, if its whole range is read as 0 to 1."""
_BRAKES: Final = 0.25
"""Share of the motion with a pedal below zero that leads forwards, from which it is also the brake."""
_CODES: Final = frozenset(map(float, range(ord("A"), ord("Z") + 1)))
"""Character codes of letters."""


def gear_values(guess: Guess, values: Float[np.ndarray, " n"]) -> tuple[str, ...]:
    """What recorded gears stand for, where they are letters, a switch for reverse, or a selector's positions."""
    there = {float(value) for value in np.unique(values)}
    named = (guess.topic, *guess.fields)
    numbers = {value for value in there if abs(value) <= MOST_GEARS}
    letters = {chr(int(value)) for value in there - numbers if value in _CODES}
    if letters & set(_LETTERS) and len(letters) == len(there - numbers):
        forward = dict.fromkeys(sorted(letters - set(_LETTERS)), 1)  # S, L, M: ways to drive forwards
        meanings = _LETTERS | forward | {f"{number:g}": int(np.sign(number)) for number in sorted(numbers)}
    elif there <= {0.0, 1.0} and any(map(_REVERSE.search, named)):
        meanings = {"0": 1, "1": -1}
    elif there <= {0.0, 1.0, 2.0, 3.0} and any(map(_SELECTOR.search, named)):
        meanings = {str(position): gear for position, gear in enumerate(_LETTERS.values())}
    else:
        return ()
    return ("values = { " + ", ".join(f"{key} = {gear}" for key, gear in meanings.items()) + " }",)


def check_gear(drive: Drive, path: DrivenPath, recorded: Mapping[str, Recorded]) -> list[Finding]:
    """A note if the vehicle reverses and the rig has no gear; a warning if the gear is another than the motion's.

    Before them, a warning on a throttle that goes both ways and is read as a pedal.
    """
    halfway = _released_halfway(drive, path)
    if halfway is not None and ("gear" not in drive.channels or drive.rig.reads_alike("throttle", "gear")):
        return [halfway]  # what it drives backwards shows once it is read around its rest
    found = [halfway] if halfway is not None else []
    if "gear" not in drive.channels:
        below = _below_zero(drive, path, recorded)
        return [_reverse_pedal(drive.rig)] if pedal_reverses(drive, path) else _hidden_reverse(drive, path, below)
    moving = _moving(path)
    gear = drive.channels["gear"].hold(path.time, max_gap=drive.rig.clock.max_gap)[:, 0]
    if drive.rig.reads_alike("throttle", "gear") and (finding := _braking_reverse(gear, moving, path)):
        return [finding]
    with np.errstate(invalid="ignore"):
        driven_back = (gear == 0) & (path.forward < 0) & _pressed(drive, path)
        against = moving & ((gear * path.forward < 0) | driven_back)
        if drive.rig.reads_alike("throttle", "gear"):  # such a pedal against the motion brakes
            against &= gear * path.acceleration < 0
    share = float(against.sum() / max(moving.sum(), 1))
    raw = _raw(drive, path, recorded)
    if against.sum() * STEP < _LEAST_AGAINST or (share < _SHARE and not _one_is_wrong(raw, against, moving)):
        return found
    cure = _meanings(drive, path, moving, raw)
    evidence = f"the vehicle moves against it for {against.sum() * STEP:.1f} s, {share:.0%} of its motion"
    how = ", ".join(map(str, cure)) or "give `values` for what is recorded, or leave the channel out"
    return [
        *found,
        Finding("warning", "gear", "does not go with the motion", evidence, how, share, (cure,) if cure else ()),
    ]


def pedal_reverses(drive: Drive, path: DrivenPath) -> bool:
    """Whether the brake is the side below zero of the throttle's field, and drives the vehicle backwards."""
    if not drive.rig.reads_alike("throttle", "brake") or not {"throttle", "brake"} <= set(drive.channels):
        return False
    moving = _moving(path)
    with np.errstate(invalid="ignore"):
        backwards = moving & (path.forward < 0)
        below = backwards & (sampled(drive.channels["brake"], path.time, drive.rig) > _DEAD_BAND)
    seconds = STEP * below.sum()
    # A vehicle that moves backwards most of the time has a heading that is turned.
    if seconds < _LASTS or below.sum() < _BACKWARDS * backwards.sum() or backwards.sum() > 0.5 * moving.sum():
        return False
    base = np.stack([np.ones(len(path.time)), path.forward, path.slope], axis=1)
    fit = fit_lags(path.acceleration, base, lagged(drive.channels["brake"], path.time, drive.rig), LAGS, backwards)
    if fit is None:
        return False
    best = fit.best(*_OWN_DELAY)
    return float(fit.r[best]) < min(_DRIVES, -SURE * fit.r_sigma(best))


def reverses_by_pedal(log: Log, rig: Rig) -> bool:
    """Whether what is below zero of a rig's throttle is reverse (`pedal_reverses`), as a log shows it.

    A brake of its own does not change that.
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


def _released_halfway(drive: Drive, path: DrivenPath) -> Finding | None:
    """A finding on a throttle that is at one value above zero at standstills, and goes both ways, but not to brake."""
    throttle = drive.channels.get("throttle")
    if throttle is None:
        return None
    at = sampled(throttle, path.time, drive.rig)
    with np.errstate(invalid="ignore"):
        there = at[(path.speed < MOVING) & np.isfinite(at)]
    if len(there) * STEP < _LASTS:
        return None
    rest = float(np.median(there))
    stays = float(np.mean(np.abs(there - rest) < _DEAD_BAND / 2)) > 0.5  # a slow ramp through it is no rest
    braked = _pressed(drive, path, "brake") & np.isfinite(at) & (not drive.rig.reads_alike("throttle", "brake"))
    let_go = braked.any() and np.median(at[braked]) < rest / 2  # what was held open while it stood
    if not (_HALFWAY[0] < rest < _HALFWAY[1] and stays and rests_between(throttle.values[:, 0], rest)) or let_go:
        return None
    source = drive.rig.channels["throttle"]
    cure = (*scaled_to_unit("throttle", source, (rest, 1.0)), Edit("channels.throttle.clip", [0.0, 1.0]))
    how = f"{', '.join(map(str, cure))}; what is below brakes, or drives backwards (docs/rig.md)"
    evidence = f"it is {rest:.2g} at standstills, and goes both ways from there"
    return Finding("warning", "throttle", "never comes back to zero", evidence, how, 1.0, (cure,))


def _braking_reverse(gear: Float[np.ndarray, " n"], moving: Bool[np.ndarray, " n"], path: DrivenPath) -> Finding | None:
    """A finding on a pedal whose side below zero brakes while the vehicle rolls, and reverses from a standstill.

    Speed controllers of model cars and rovers do so; where it reverses at once, it is soon over.
    """
    with np.errstate(invalid="ignore"):
        back, forward = (moving & (gear < 0) & (way * path.forward > 0) for way in (-1, 1))
    share = float(forward.sum() / max(forward.sum() + back.sum(), 1))
    if STEP * forward.sum() < _LEAST_AGAINST or share < _BRAKES:
        return None
    evidence = f"it moves forwards for {STEP * forward.sum():.1f} s, {share:.0%} of its motion with gear -1"
    how = (
        "where a gear or a brake is recorded on its own, read that; else read below zero as the brake (sign = -1,"
        " clip = [0, 1]), and leave out the drives in reverse"
    )
    return Finding("warning", "gear", "brakes while the vehicle rolls, and is no reverse then", evidence, how, share)


def _reverse_pedal(rig: Rig) -> Finding:
    """The finding that what is read as the brake is reverse, and the edits that make it throttle and gear."""
    source = rig.channels["throttle"]
    each = DIRECTION * unit_factor("throttle", source.unit)
    gear: dict[str, Any] = {"topic": source.topic, "fields": list(source.fields), "scale": rounded(each * source.scale)}
    gear |= {"offset": rounded(each * source.offset)} if source.offset else {}
    gear |= {"sign": -1} if source.sign < 0 else {}
    cure = (Edit("channels.throttle.absolute", True), Edit("channels.gear", gear), *absent("brake", rig))
    how = ", ".join(map(str, cure))
    evidence = f"below zero '{source.fields[0]}' drives the vehicle backwards, and does not brake it"
    return Finding("warning", "brake", "is reverse, and no brake", evidence, how, 1.0, (cure,))


def _below_zero(drive: Drive, path: DrivenPath, recorded: Mapping[str, Recorded]) -> Bool[np.ndarray, " n"]:
    """Where a throttle that a rig clips at zero is below, and pushes backwards: a brake does not."""
    source = drive.rig.channels.get("throttle")
    if source is None or source.clip is None:
        return np.zeros(len(path.time), bool)
    raw = _raw(drive, path, recorded, "throttle")
    with np.errstate(invalid="ignore"):
        below = source.sign * (raw * source.scale + source.offset) * unit_factor("throttle", source.unit) < -_PRESSED
        return np.asarray(below & (GRAVITY * path.slope > path.acceleration))


def _hidden_reverse(drive: Drive, path: DrivenPath, below: Bool[np.ndarray, " n"]) -> list[Finding]:
    """A note on stretches of reversing that no channel shows.

    Args:
        below: where the throttle is below zero and drives backwards.
    """
    if not _moving(path).any():
        return []
    with np.errstate(invalid="ignore"):
        backwards = _moving(path) & (path.forward < 0)
        driven = backwards & (_pressed(drive, path) | below)
    edges = np.flatnonzero(np.diff(np.concatenate(([False], backwards, [False]))))
    stretches = [
        (first, last)
        for first, last in zip(edges[::2], edges[1::2], strict=True)
        if driven[first:last].sum() * STEP >= _LASTS
    ]
    if not stretches:
        return []
    seconds = sum(last - first for first, last in stretches) * STEP
    times = "once" if len(stretches) == 1 else f"{len(stretches)} times"
    evidence = f"{times}, {seconds:.1f} s in all, from {path.time[stretches[0][0]] - path.time[0]:.1f} s on, "
    negative = bool((driven & below).any())
    evidence += "with the throttle below zero" if negative else "with the throttle pressed"
    how = "add [channels.gear] where the log has one (docs/rig.md); without it, models expect "
    how += "below zero to brake" if negative else "throttle to drive forwards"
    return [Finding("note", "gear", "is not read, and the vehicle reverses", evidence, how, 0.4)]


def _pressed(drive: Drive, path: DrivenPath, pedal: str = "throttle") -> Bool[np.ndarray, " n"]:
    """Where a pedal is pressed; nowhere where it is not known."""
    if pedal not in drive.channels:
        return np.zeros(len(path.time), bool)
    with np.errstate(invalid="ignore"):
        return np.asarray(sampled(drive.channels[pedal], path.time, drive.rig) > _PRESSED)


def _moving(path: DrivenPath) -> Bool[np.ndarray, " n"]:
    with np.errstate(invalid="ignore"):
        return np.asarray(np.abs(path.forward) > max(MOVING, 0.1 * path.cruise))


def _one_is_wrong(
    raw: Float[np.ndarray, " n"], against: Bool[np.ndarray, " n"], moving: Bool[np.ndarray, " n"]
) -> bool:
    """Whether the vehicle mostly moves against one of the recorded values: reverse, counted as the first gear."""
    shares = ((np.sum(against & (raw == value)), np.sum(moving & (raw == value))) for value in _gears(raw))
    return any(STEP * wrong >= _LEAST_AGAINST and wrong > _MOSTLY * moved for wrong, moved in shares)


def _meanings(
    drive: Drive, path: DrivenPath, moving: Bool[np.ndarray, " n"], raw: Float[np.ndarray, " n"]
) -> tuple[Edit, ...]:
    """The edit that gives each recorded value the gear in which the vehicle moves meanwhile; empty where none fits."""
    source = drive.rig.channels["gear"]
    there = _gears(raw)
    if len(there) < 2 or (source.scale, source.offset) != (1.0, 0.0):
        return ()
    values = {f"{value:g}": source.sign * _way(path.forward[moving & (raw == value)]) for value in there}
    return (Edit("channels.gear.values", values),) if len(set(values.values())) > 1 else ()


def _raw(
    drive: Drive, path: DrivenPath, recorded: Mapping[str, Recorded], name: str = "gear"
) -> Float[np.ndarray, " n"]:
    """A channel as recorded, held from each sample on; NaN before the first, and where the log lacks it."""
    source = drive.rig.channels[name]
    r = recorded.get(source.topic)
    if r is None or source.fields[0] not in r.fields:
        return np.full(len(path.time), np.nan)
    kept = increasing(r.time)
    time, value = r.time[kept], r.values[kept, r.fields.index(source.fields[0])]
    return np.append(np.nan, value)[np.searchsorted(time, path.time + source.delay, side="right")]


def _gears(raw: Float[np.ndarray, " n"]) -> Float[np.ndarray, " g"]:
    """The values there are; none where they are too many for gears."""
    there = np.unique(raw[np.isfinite(raw)])
    return there if len(there) <= MOST_GEARS else there[:0]


def _way(forward: Float[np.ndarray, " n"]) -> float:
    """1 where it moves forwards most of the time, -1 backwards, 0 where neither, or where it hardly moves."""
    if len(forward) * STEP < 1.0:
        return 0.0
    mean = float(np.mean(np.sign(forward)))
    return float(np.sign(mean)) if abs(mean) > 0.5 else 0.0
