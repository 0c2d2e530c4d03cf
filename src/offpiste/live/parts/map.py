"""Scans and codes to the map of the ground around the vehicle."""

import time

import numpy as np

from offpiste.live.packing import cloud_from, pack_layers, packed, unpacked
from offpiste.live.part import Part, TrackFeed, keep_loaded
from offpiste.live.parts.setup import NewestCourse, last_command, load_kernels, wait_for_sensors
from offpiste.live.session import Session
from offpiste.logs.measurements import Cloud
from offpiste.mapping.terrain_map import TerrainLayers
from offpiste.runtime.estimator import VehicleTrack
from offpiste.runtime.perception import OnlineMapper, Stopwatch
from offpiste.runtime.prediction import reachable

_SPARE = 4.0
"""The map reaches so much further than a plan from where the vehicle was when it was made [m]."""
_WITHOUT_COURSE = 3.0
"""Speed for whose plans the map is cut before there is a course, when it is only shown [m/s]."""


def map_ground(session: Session) -> None:
    """The process that maps."""
    part = Part("map", session)
    planner = part.settings.load_planner()
    load_kernels(part, planner)
    setup = wait_for_sensors(part, planner)
    if setup is None:
        return
    encoder = planner.dynamics.eval().requires_grad_(False).encoder
    feed, watch = TrackFeed(part, planner.dynamics.vehicle.actuators), Stopwatch(last=1)
    mapper = OnlineMapper(setup, encoder, feed.track, part.settings.runtime.replay, watch)
    mapper.dropped = part.dropped
    keep_loaded()
    scan_number, code_number, took = part.ring("scans").written, part.ring("codes").written, 0.0
    course, fastest = NewestCourse(part), _WITHOUT_COURSE
    while not part.ending:
        if (tracker := course.changed()) is not None:
            fastest = tracker.fastest
        if feed.update(part.now()):
            mapper.restart()
            part.hand_on("map", pack_layers(None))
        for entry in part.ring("codes").since(code_number):
            code_number, values = entry.number, unpacked(entry.data)
            mapper.coded(values["camera"], values["time"], values["codes"])
        before = mapper.scan_time
        newest: dict[str, Cloud] = {}
        for entry in part.ring("scans").since(scan_number):
            part.dropped["scans: overwritten"] += entry.number - scan_number - 1
            scan_number, cloud = entry.number, cloud_from(unpacked(entry.data))
            part.dropped["scans: replaced by a newer one"] += cloud.lidar in newest
            newest[cloud.lidar] = cloud
        began = time.monotonic()
        mapper.catch_up()
        for cloud in newest.values():
            if not feed.intake.ahead(cloud.lidar, cloud.time):
                mapper.scan(cloud)
        if mapper.scan_time > before:
            layers = _within_reach(mapper.layers(), feed.track, part, fastest)
            part.hand_on("map", pack_layers(layers, scan_time=mapper.scan_time, image_time=mapper.state.image_time))
            took = time.monotonic() - began
        state = mapper.state
        part.hand_on("map-state", packed({"scan_time": state.scan_time, "image_time": state.image_time}))
        part.beat("ready" if mapper.scan_time > -np.inf else "waits for a scan", map_ms=1e3 * took)
        if not newest:
            time.sleep(0.01)


def _within_reach(layers: TerrainLayers, track: VehicleTrack, part: Part, fastest: float) -> TerrainLayers:
    """What plans can reach until the next map comes.

    Args:
        fastest: speed of the course [m/s].
    """
    latest = track.latest
    assert latest is not None
    state, gear = track.rows(latest.time).state[-1], last_command(part).get("gear", 1.0)
    return reachable(layers, state, fastest, gear, part.settings.runtime.margin + _SPARE)
