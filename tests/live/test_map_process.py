"""The process that maps: what it hands over holds all that plans can reach until the next map comes."""

import numpy as np
import pytest

from live.made_up_robot import small_settings, write_course, write_rig
from live.test_supervisor import RUN
from offpiste.live.packing import packed
from offpiste.live.part import Part
from offpiste.live.parts.map import _within_reach
from offpiste.live.reception import CourseRequest
from offpiste.live.session import LiveSettings, new_session
from offpiste.mapping.terrain_map import TerrainLayers
from offpiste.runtime.estimator import VehicleReading, VehicleTrack
from offpiste.runtime.prediction import reachable

SIDE = 240
FLAT = np.zeros((SIDE, SIDE))
LAYERS = TerrainLayers(
    np.array((-60.0, -60.0)), 0.5, FLAT, np.zeros((SIDE, SIDE, 3)), FLAT, FLAT, FLAT, np.zeros((SIDE, SIDE, 2)), FLAT,
    FLAT == 0, FLAT == 0, FLAT != 0,
)  # fmt: skip


def corners(layers):
    """Lowest and highest x, y of a map."""
    ny, nx = layers.known.shape
    return layers.origin, layers.origin + layers.resolution * np.array((nx - 1, ny - 1))


@pytest.mark.parametrize("gear", [1.0, -1.0])
def test_a_standing_vehicle_gets_the_map_that_it_reaches_at_the_speed_of_its_course(tmp_path, gear):
    course = CourseRequest(write_course(tmp_path))
    with new_session(LiveSettings(write_rig(tmp_path), RUN, None, course, small_settings())) as session:
        part, track = Part("map", session), VehicleTrack()
        for time in (0.0, 0.02):
            track.add(VehicleReading(time, np.zeros(3), np.array((0, 0, 0, 1.0)), np.zeros(3), 0.0, np.zeros(4)))
        if gear < 0:
            part.ring("commands").write(packed({"time": 0.02, "gear": gear}))
        (low, high), margin = corners(_within_reach(LAYERS, track, part, 8.0)), part.settings.runtime.margin
        for ahead in (0.0, 1.5):  # driven since
            state = np.array((gear * ahead, 0.0, 0.0, 0.0, 0.0, 0.0))
            wanted = corners(reachable(LAYERS, state, 8.0, gear, margin))
            assert (low <= wanted[0]).all()
            assert (high >= wanted[1]).all()
        assert max(gear * low[0], gear * high[0]) >= 8 * 5, "as far as it comes in five seconds"
