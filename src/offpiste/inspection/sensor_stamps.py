"""Checks of image and point cloud stamps, and of point times."""

from dataclasses import replace
from itertools import islice
from typing import Final

import msgspec
import numpy as np

from offpiste.inspection.clocks import APART, DRIFT, ORIGINS
from offpiste.inspection.findings import Finding, Severity
from offpiste.inspection.recorded_log import Recorded
from offpiste.inspection.stamps import check_spans, check_stamps
from offpiste.logs.clock_drift import clock_difference
from offpiste.logs.log import Log
from offpiste.logs.measurements import lines, misread_times, proposed_times
from offpiste.logs.sensor_log import SensorLog
from offpiste.rig.channels import ChannelSource
from offpiste.rig.edits import Edit
from offpiste.rig.rig import Rig
from offpiste.rig.sensors import CameraSource, LidarSource

Source = CameraSource | LidarSource | ChannelSource
"""Topic and delay of a sensor or the pose."""

_PAUSE: Final = 1.0
"""Minimum gap of a sensor [s]; images are infrequent and not interpolated."""
_STAMPS: Final = 50
"""Minimum number of messages for detecting a drift."""
_SCANS: Final = 5
"""Number of scans whose point times are checked."""
_HALF: Final = 0.5
"""Maximum share of the drive without a sensor for a note instead of a warning."""


def check_sensor_stamps(log: Log, sensors: SensorLog) -> list[Finding]:
    """Check gaps, losses, repeats, backward steps, spans and clocks of all cameras and LiDARs from all stamps.

    No finding is fatal, as training works without sensors, and none has an automatic fix: the rig's clock settings
    apply to all topics, and sensors are not read again to test a fix.
    """
    rig, place = sensors.rig, sensors.rig.channels["position"]
    clock = msgspec.structs.replace(rig.clock, max_gap=max(_PAUSE, rig.clock.max_gap))
    sources: dict[str, Source] = {f"cameras.{name}": camera.source for name, camera in sensors.cameras.items()}
    sources |= {f"lidars.{name}": lidar.source for name, lidar in sensors.lidars.items()}
    pose = _recorded(log, place, rig)
    recorded = {source.topic: _recorded(log, source, rig) for source in sources.values()}
    several = {topic: r for topic, r in recorded.items() if len(r.time) > 2}
    # The unit and the longest gap of a clock are those of channels, and do not apply to images.
    of_channels = {"clock.unit", "clock.max_gap"}
    findings = [f for f in check_stamps(several, clock, used=set(several)) if not of_channels & _edited(f)]
    result = [_in_words(finding) for finding in findings]
    unordered = {finding.where for finding in findings if finding.severity == "fatal"}
    named = {source.topic: key for key, source in sources.items() if source.topic not in unordered}
    clocks = [f for topic, key in named.items() for f in _clock(key, sources[key], recorded[topic], pose, rig)]
    apart = unordered | {finding.where for finding in clocks}  # their spans are meaningless
    spans = {place.topic: pose} | {topic: r for topic, r in recorded.items() if topic not in apart}
    for finding in check_spans(spans, place.topic, rig.clock, used=True):
        # Without a sensor, rows lack only visual features, which is acceptable for less than half of the drive.
        severity: Severity = "note" if finding.score < _HALF else "warning"
        result.append(replace(finding, severity=severity))
        if finding.severity == "fatal":
            remedy = f"fix {named[finding.where]}.delay, or remove the sensor from the rig"
            remedy = f"{finding.remedy}; or remove the sensor from the rig" if "origins" in finding.what else remedy
            result[-1] = replace(result[-1], remedy=remedy, cures=())
    return result + clocks


def _edited(finding: Finding) -> set[str]:
    """Return the entries of the rig that fixes of a finding edit."""
    return {edit.key for cure in finding.cures for edit in cure}


def _in_words(finding: Finding) -> Finding:
    """Return a finding on a sensor's stamp order, with the effect on its messages as remedy instead of a fix."""
    severity: Severity = "note" if finding.severity == "note" else "warning"
    if not finding.cures:
        return replace(finding, severity=severity)
    remedy = "no action needed if enough data remains: messages whose stamps repeat or go back are dropped on reading"
    if "clock.stamps" in _edited(finding):
        remedy += '; or clock.stamps = "receive", by which all topics are read then'
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


def _recorded(log: Log, source: Source, rig: Rig) -> Recorded:
    """Return the stamps of a topic as read by the rig and by the other clock."""
    topic, stamps = source.topic, rig.clock.stamps
    other = "receive" if stamps == "header" else "header"
    time, arrivals = log.stamps(topic, stamps=stamps), log.stamps(topic, stamps=other) if log.has_arrivals else None
    return Recorded(log.topics[topic], time - source.delay, arrivals, (), np.zeros((len(time), 0)))


def _clock(key: str, source: Source, sensor: Recorded, pose: Recorded, rig: Rig) -> list[Finding]:
    """Return a finding if a sensor's clock drifts or is offset relative to the pose's clock, by arrival times."""
    if rig.clock.stamps != "header" or sensor.other is None or pose.other is None:
        return []
    result = clock_difference(sensor.time, sensor.other, pose.time, pose.other)
    if result is None or abs(result.offset) > ORIGINS:
        return []
    offset, drift = result
    if abs(drift) > DRIFT and min(len(sensor.time), len(pose.time)) >= _STAMPS:
        what, score = "its clock drifts", min(1.0, abs(drift))
        evidence = f"from start to end, arrival moves by {drift:+.2f} s against the header's stamp, compared with the"
        remedy = 'synchronise its clock; or clock.stamps = "receive"'
    elif abs(offset) > APART:
        what, score = "its header's clock is apart from the pose's", 0.6
        evidence = f"its messages arrive {abs(offset):.2f} s {'later' if offset > 0 else 'earlier'} after it than the"
        remedy = f"{Edit(f'{key}.delay', round(source.delay - offset, 2))}, unless it is sent late; or "
        remedy += 'clock.stamps = "receive"'
    else:
        return []
    return [Finding("warning", sensor.topic.name, what, f"{evidence} pose", remedy, score)]
