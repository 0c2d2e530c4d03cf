"""Defects of image and point cloud stamps, and of point times."""

from dataclasses import replace
from itertools import islice
from typing import Final

import msgspec

from offpiste.inspection.clocks import APART, DRIFT, ORIGINS
from offpiste.inspection.findings import MESSAGES, Finding, Severity, found
from offpiste.inspection.recorded_log import Recorded, without_values
from offpiste.inspection.stamps import check_spans, check_stamps
from offpiste.logs.clock_drift import clock_difference
from offpiste.logs.log import Log
from offpiste.logs.measurements import lines, misread_times, proposed_times
from offpiste.logs.sensor_log import SensorLog
from offpiste.rig.edits import Edit
from offpiste.rig.sensors import CameraSource, LidarSource

_PAUSE: Final = 1.0
"""Minimum gap of a sensor [s]; images are infrequent and not interpolated."""
_STAMPS: Final = 50
"""Minimum number of messages for detecting a drift."""
_SCANS: Final = 5
"""Number of scans whose point times are checked."""
_HALF: Final = 0.5
"""Maximum share of the drive without a sensor for a note instead of a warning."""
_OF_CHANNELS: Final = {"clock.unit", "clock.max_gap"}
"""Entries that state the unit and longest gap of channels, not of images."""


def check_sensor_stamps(log: Log, sensors: SensorLog) -> list[Finding]:
    """Check gaps, losses, repeats, backward steps, spans and clocks of all cameras and LiDARs from all stamps.

    No finding is fatal, as training works without sensors, and none has an automatic fix: the rig's clock settings
    apply to all topics, and sensors are not read again to test a fix.
    """
    rig, place = sensors.rig, sensors.rig.channels["position"]
    sources: dict[str, CameraSource | LidarSource] = {f"cameras.{n}": c.source for n, c in sensors.cameras.items()}
    sources |= {f"lidars.{name}": lidar.source for name, lidar in sensors.lidars.items()}
    pose, *others = (
        without_values(log, source.topic, stamps=rig.clock.stamps, delay=source.delay)
        for source in (place, *sources.values())
    )
    recorded = {topic.topic.name: topic for topic in others}
    several = {name: topic for name, topic in recorded.items() if len(topic.time) > 2}
    clock = msgspec.structs.replace(rig.clock, max_gap=max(_PAUSE, rig.clock.max_gap))
    findings = [f for f in check_stamps(several, clock, used=set(several)) if not _OF_CHANNELS & _edited(f)]
    result = [_in_words(finding) for finding in findings]
    unordered = {finding.where for finding in findings if finding.severity == "fatal"}
    named = {source.topic: key for key, source in sources.items() if source.topic not in unordered}
    clocks = [f for topic, key in named.items() for f in _clock(key, sources[key], recorded[topic], pose)]
    apart = unordered | {finding.where for finding in clocks}  # their spans are meaningless
    spans = {place.topic: pose} | {topic: r for topic, r in recorded.items() if topic not in apart}
    for finding in check_spans(spans, place.topic, used=True):
        # Without a sensor, rows lack only visual features, which is acceptable for less than half of the drive.
        severity: Severity = "note" if finding.score < _HALF else "warning"
        remedy = finding.remedy
        if finding.severity == "fatal":
            how = f"{finding.remedy};" if "origins" in finding.what else f"fix {named[finding.where]}.delay,"
            remedy = f"{how} or remove the sensor from the rig"
        result.append(replace(finding, severity=severity, remedy=remedy, cures=()))
    return result + clocks


def _edited(finding: Finding) -> set[str]:
    """Return the entries of the rig that fixes of a finding edit."""
    return {edit.key for cure in finding.cures for edit in cure}


def _in_words(finding: Finding) -> Finding:
    """Return a finding on a sensor's stamp order, with the effect on its messages as remedy instead of a fix."""
    severity: Severity = "note" if finding.severity == "note" else "warning"
    if not finding.cures:
        return replace(finding, severity=severity)
    remedy = MESSAGES["sensors"]["receive" if "clock.stamps" in _edited(finding) else "dropped"]
    return replace(finding, severity=severity, remedy=remedy, cures=())


def untimed_points(sensors: SensorLog) -> dict[str, str]:
    """Return the rig lines that read point times, by LiDAR, for LiDARs without a time field in the rig."""
    result: dict[str, str] = {}
    for name, lidar in sensors.lidars.items():
        first = None if lidar.source.time_field else next(sensors.raw_clouds(name), None)
        entries = {} if first is None else proposed_times(first, sensors.period(name))
        if entries:
            result[name] = lines(name, entries)
    return result


def check_point_times(sensors: SensorLog) -> list[Finding]:
    """Return findings for LiDARs with point times outside a sweep around the scan's stamp.

    A finding has no fix if no unit and origin explain these times.
    """
    result = []
    for name, lidar in sensors.lidars.items():
        first = islice(sensors.raw_clouds(name), _SCANS) if lidar.source.time_field else ()
        read = [misread_times(raw, lidar.source, sensors.period(name)) for raw in first]
        misread = [one for one in read if one is not None]
        if 2 * len(misread) <= len(read):
            continue
        fault, edits = misread[-1], tuple(Edit(f"lidars.{name}.{k}", v) for k, v in misread[-1].entries.items())
        remedy = fault.remedy(name)
        if sensors.rig.clock.stamps == "receive" and "epoch" in fault.entries.values():
            edits, remedy = (), f'{remedy}, with clock.stamps = "header"; or remove lidars.{name}.time_field'
        evidence = f"{len(misread)} of its first {len(read)} scans"
        result.append(Finding("warning", name, fault.what, evidence, remedy, 1.0, (edits,) if edits else ()))
    return result


def _clock(key: str, source: CameraSource | LidarSource, sensor: Recorded, pose: Recorded) -> list[Finding]:
    """Return a finding if a sensor's clock drifts or is offset relative to the pose's clock, by arrival times."""
    if sensor.arrived is None and pose.arrived is None:
        return []
    result = clock_difference(sensor.time, sensor.arrival, pose.time, pose.arrival)
    if result is None or abs(result.offset) > ORIGINS:
        return []
    offset, drift = result
    if abs(drift) > DRIFT and min(len(sensor.time), len(pose.time)) >= _STAMPS:
        return [found("sensor_drifts", sensor.topic.name, {"drift": drift}, score=min(1.0, abs(drift)))]
    if abs(offset) > APART:
        delay = Edit(f"{key}.delay", round(source.delay - offset, 2))
        values = {"apart": abs(offset), "side": "later" if offset > 0 else "earlier", "delay": delay}
        return [found("sensor_apart", sensor.topic.name, values)]
    return []
