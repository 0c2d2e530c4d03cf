"""Checks of images and clouds without geometry: stamps, spans, repeats."""

from collections.abc import Sequence
from dataclasses import replace
from itertools import islice, pairwise
from typing import Final

import msgspec
import numpy as np

from offpiste.core.errors import OffpisteError
from offpiste.inspection.findings import Finding, Severity
from offpiste.inspection.recorded_log import Recorded
from offpiste.inspection.sensor_samples import Grey
from offpiste.inspection.several_clocks import ORIGINS
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
"""Topic of a sensor or of the pose, and the delay of its stamps."""

_PAUSE: Final = 1.0
"""A sensor is silent for longer than this in a gap [s]; images come at some Hz, and are not interpolated."""
_DRIFT: Final = 0.1
"""A clock that moves this much against the pose's within a log drifts [s]."""
_APART: Final = 0.5
"""A clock that is off by this much is another one [s]; no sensor takes so long to send."""
_STAMPS: Final = 50
"""Fewer messages than this do not show a drift."""
_FROZEN: Final = 0.1
_SCANS: Final = 5
"""First scans whose points' times are checked."""
_HALF: Final = 0.5
"""A sensor that misses less of the drive than this is a note."""


def check_sensor_stamps(log: Log, sensors: SensorLog) -> list[Finding]:
    """Gaps, losses, repeats, steps back, spans and clocks of all cameras and LiDARs; reads all stamps of the log.

    Nothing here is fatal, as channels can be trained on without sensors, and nothing has a cure: entries of the rig's
    clock hold for all topics, and sensors are not read again to try one.
    """
    rig, place = sensors.rig, sensors.rig.channels["position"]
    clock = msgspec.structs.replace(rig.clock, max_gap=max(_PAUSE, rig.clock.max_gap))
    sources: dict[str, Source] = {f"cameras.{name}": camera.source for name, camera in sensors.cameras.items()}
    sources |= {f"lidars.{name}": lidar.source for name, lidar in sensors.lidars.items()}
    pose = _recorded(log, place, rig)
    recorded = {source.topic: _recorded(log, source, rig) for source in sources.values()}
    several = {topic: r for topic, r in recorded.items() if len(r.time) > 2}
    findings = [f for f in check_stamps(several, clock, used=set(several)) if not _is_of_channels(f)]
    result = [_in_words(finding) for finding in findings]
    unordered = {finding.where for finding in findings if finding.severity == "fatal"}
    named = {source.topic: key for key, source in sources.items() if source.topic not in unordered}
    clocks = [f for topic, key in named.items() for f in _clock(key, sources[key], recorded[topic], pose, rig)]
    apart = unordered | {finding.where for finding in clocks}  # whose spans say nothing
    spans = {place.topic: pose} | {topic: r for topic, r in recorded.items() if topic not in apart}
    for finding in check_spans(spans, place.topic, rig.clock, used=True):
        # Where a sensor is silent, rows lack visual features and no more: as long as half of the drive has them.
        severity: Severity = "note" if finding.score < _HALF else "warning"
        result.append(replace(finding, severity=severity))
        if finding.severity == "fatal":
            remedy = f"fix {named[finding.where]}.delay, or remove the sensor from the rig"
            remedy = f"{finding.remedy}; or remove the sensor from the rig" if "origins" in finding.what else remedy
            result[-1] = replace(result[-1], remedy=remedy, cures=())
    return result + clocks


def _is_of_channels(finding: Finding) -> bool:
    """Whether it is about the pace of channels: images come as seldom as they like, and are not interpolated."""
    return any(edit.key in ("clock.unit", "clock.max_gap") for cure in finding.cures for edit in cure)


def _in_words(finding: Finding) -> Finding:
    """The finding on the order of a sensor's stamps, with what becomes of its messages instead of a cure."""
    remedy = "nothing where the rest is enough: messages whose stamps repeat or go back are dropped on reading"
    if any(edit.key == "clock.stamps" for cure in finding.cures for edit in cure):
        remedy += '; or clock.stamps = "receive", by which all topics are read then'
    severity: Severity = "note" if finding.severity == "note" else "warning"
    return replace(finding, severity=severity, remedy=remedy if finding.cures else finding.remedy, cures=())


def untimed_points(sensors: SensorLog) -> dict[str, str]:
    """Rig lines that read the times of points, by the name of the LiDAR, where the rig does not name their field."""
    result: dict[str, str] = {}
    for name, lidar in sensors.lidars.items():
        first = None if lidar.source.time_field else next(sensors.raw_clouds(name), None)
        entries = {} if first is None else proposed_times(first, sensors.period(name))
        if entries:
            result[name] = lines(name, entries)
    return result


def check_point_times(sensors: SensorLog) -> list[Finding]:
    """Findings for LiDARs whose points, by their own times, are not measured within a sweep of the scan's stamp.

    A finding has no cure where no unit and origin of these times explain them.
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
    """Stamps of a topic as the rig reads them, and by the other clock."""
    topic, stamps = source.topic, rig.clock.stamps
    other = "receive" if stamps == "header" else "header"
    time, arrivals = log.stamps(topic, stamps=stamps), log.stamps(topic, stamps=other) if log.has_arrivals else None
    return Recorded(log.topics[topic], time - source.delay, arrivals, (), np.zeros((len(time), 0)))


def _clock(key: str, source: Source, sensor: Recorded, pose: Recorded, rig: Rig) -> list[Finding]:
    """Messages that arrive ever later or earlier after their header than the poses' do, or all of them by far."""
    if rig.clock.stamps != "header" or sensor.other is None or pose.other is None:
        return []
    result = clock_difference(sensor.time, sensor.other, pose.time, pose.other)
    if result is None or abs(result.offset) > ORIGINS:
        return []
    offset, drift = result
    if abs(drift) > _DRIFT and min(len(sensor.time), len(pose.time)) >= _STAMPS:
        what, score = "its clock drifts", min(1.0, abs(drift))
        evidence = f"from start to end, arrival moves by {drift:+.2f} s against the header's stamp, compared with the"
        remedy = 'synchronise its clock; or clock.stamps = "receive"'
    elif abs(offset) > _APART:
        what, score = "its header's clock is apart from the pose's", 0.6
        evidence = f"its messages arrive {abs(offset):.2f} s {'later' if offset > 0 else 'earlier'} after it than the"
        remedy = f"{Edit(f'{key}.delay', round(source.delay - offset, 2))}, unless it is sent late; or "
        remedy += 'clock.stamps = "receive"'
    else:
        return []
    return [Finding("warning", sensor.topic.name, what, f"{evidence} pose", remedy, score)]


def check_repeated_images(name: str, images: Sequence[Grey]) -> list[Finding]:
    """Finding if images repeat, bit for bit."""
    if len(images) < 10:
        return []
    same = [np.array_equal(a.pixels, b.pixels) for a, b in pairwise(images)]
    share = float(np.mean(same))
    if share < _FROZEN:
        return []
    evidence = f"{sum(same)} of {len(same)} images are those before them, bit for bit"
    return [Finding("warning", name, "repeats images", evidence, "record it again: its driver hangs", share)]


def refused(error: OffpisteError, where: str) -> Finding:
    """Finding for sensors that cannot be read."""
    return Finding(
        "warning", where, error.what, f"on reading it{f': {error.where}' if error.where else ''}", error.how, 1.0
    )
