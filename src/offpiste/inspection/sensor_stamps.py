"""Checks of images and clouds without geometry: stamps, spans, repeats."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import pairwise
from typing import Final

import msgspec
import numpy as np

from offpiste.errors import OffpisteError
from offpiste.inspection.findings import Finding
from offpiste.inspection.recorded_log import Recorded
from offpiste.inspection.sensor_samples import Grey
from offpiste.inspection.stamps import check_spans, check_stamps
from offpiste.logs.clock_drift import clock_difference
from offpiste.logs.log import Log
from offpiste.logs.measurements import Lidar
from offpiste.logs.sensor_log import SensorLog
from offpiste.rig.rig import Rig
from offpiste.rig.sensors import TIME_FIELDS

_PAUSE: Final = 1.0
"""A sensor is silent for longer than this in a gap [s]; images come at some Hz, and are not interpolated."""
_DRIFT: Final = 0.1
"""A clock that moves this much against the pose's within a log drifts [s]."""
_STAMPS: Final = 50
"""Fewer messages than this do not show a drift."""
_FROZEN: Final = 0.1
_HALF: Final = 0.5
"""A sensor that misses less of the drive than this is a note."""


def check_sensor_stamps(log: Log, sensors: SensorLog) -> list[Finding]:
    """Gaps, losses, repeats, steps back, spans and clocks of all cameras and LiDARs; reads all stamps of the log."""
    rig = sensors.rig
    pose = rig.channels["position"].topic
    clock = msgspec.structs.replace(rig.clock, max_gap=max(_PAUSE, rig.clock.max_gap))
    topics = [camera.source.topic for camera in sensors.cameras.values()]
    topics += [lidar.source.topic for lidar in sensors.lidars.values()]
    recorded = {topic: _recorded(log, topic, rig) for topic in (pose, *topics)}
    several = {t: r for t, r in recorded.items() if t != pose and len(r.time) > 2}
    findings = check_stamps(several, clock, used=set(topics))
    # Where a sensor is silent, rows lack visual features and no more: as long as half of the drive has them.
    for finding in check_spans(recorded, pose, used=True):
        findings.append(replace(finding, severity="note" if finding.score < _HALF else "warning"))
    return [*findings, *(f for topic in topics for f in _drift(recorded[topic], recorded[pose], rig.clock.stamps))]


def untimed_points(log: Log, lidars: Mapping[str, Lidar]) -> dict[str, str]:
    """LiDARs whose points have a field of times that the rig does not name: from the LiDAR's name to the field's."""
    result: dict[str, str] = {}
    for name, lidar in lidars.items():
        first = None if lidar.source.time_field else next(log.clouds(lidar.source.topic), None)
        times = [field for field in TIME_FIELDS if first is not None and field in (first.points.dtype.names or ())]
        if times:
            result[name] = times[0]
    return result


def _recorded(log: Log, topic: str, rig: Rig) -> Recorded:
    stamps = rig.clock.stamps
    other = "receive" if stamps == "header" else "header"
    time, arrivals = log.stamps(topic, stamps=stamps), log.stamps(topic, stamps=other) if log.has_arrivals else None
    return Recorded(log.topics[topic], time, arrivals, (), np.zeros((len(time), 0)))


def _drift(sensor: Recorded, pose: Recorded, stamps: str) -> list[Finding]:
    """Messages that arrive ever later, or ever earlier, after their header than the poses' do."""
    if sensor.other is None or pose.other is None or min(len(sensor.time), len(pose.time)) < _STAMPS:
        return []
    clocks = (sensor.time, sensor.other), (pose.time, pose.other)
    own, poses = clocks if stamps == "header" else ((arrived, header) for header, arrived in clocks)
    result = clock_difference(*own, *poses)
    if result is None or not abs(result.drift) > _DRIFT:
        return []
    evidence = (
        f"from start to end, arrival moves by {result.drift:+.2f} s against the header's stamp, compared with the pose"
    )
    remedy = 'synchronise its clock; or clock.stamps = "receive"'
    return [Finding("warning", sensor.topic.name, "its clock drifts", evidence, remedy, min(1.0, abs(result.drift)))]


def check_frozen(name: str, images: Sequence[Grey]) -> list[Finding]:
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
