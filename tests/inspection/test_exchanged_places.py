"""Latitude and longitude, or east and north, that the rig reads in the wrong order."""

import numpy as np
import pytest
from simulated import MemoryLog, drive_log, rig, severe

from offpiste.inspection.inspect import inspect_log
from offpiste.rig.edits import Edit, edited
from offpiste.rig.rig import Rig

COMPASS = {"topic": "odom", "fields": ["heading"], "unit": "deg", "sign": -1, "offset": -90.0}
AS_IT_STANDS = {"topic": "odom", "fields": ["heading"], "unit": "deg"}
LAT_LON, EAST_NORTH = ("lat", "lon"), ("east", "north")


def located(latitude: float, longitude: float) -> MemoryLog:
    """A drive there, with a compass and a yaw rate to the left beside its places."""
    log = drive_log(seconds=60)
    time, odom = log.data["odom"]
    east, north = odom["x"], odom["y"]
    yaw = np.unwrap(2 * np.arctan2(odom["qz"], odom["qw"]))
    columns = odom | {
        "lat": latitude + north / 111_200,
        "lon": longitude + east / (111_320 * np.cos(np.radians(latitude))),
        "east": east,
        "north": north,
        "heading": np.degrees(np.pi / 2 - yaw) % 360,
        "yaw_rate": odom["wz"],
    }
    return MemoryLog({**log.data, "odom": (time, columns)})


def read_by(fields: tuple[str, str], heading: dict[str, object]) -> Rig:
    """A rig that reads these places, and the heading so."""
    places = {"topic": "odom", "fields": list(fields)} | ({"unit": "lat lon"} if "lat" in fields else {})
    gone = [Edit(f"channels.{name}", None) for name in ("orientation", "angular_velocity", "linear_velocity")]
    rate = Edit("channels.yaw_rate", {"topic": "odom", "fields": ["yaw_rate"]})
    return edited(rig(), [*gone, rate, Edit("channels.yaw", heading), Edit("channels.position", places)])


@pytest.mark.parametrize("fields", [LAT_LON, EAST_NORTH], ids=" ".join)
def test_a_rig_that_reads_north_before_east_is_cured_by_the_exchange_alone(fields: tuple[str, str]) -> None:
    log = located(50.0, 8.0)
    turned = read_by((fields[1], fields[0]), COMPASS)
    assert inspect_log(log, turned).cure == (Edit("channels.position.fields", list(fields)),)
    assert severe(log, read_by(fields, COMPASS)) == []


@pytest.mark.parametrize("fields", [LAT_LON, EAST_NORTH], ids=" ".join)
@pytest.mark.parametrize("rate", [False, True])
def test_what_counts_to_the_right_beside_places_that_are_right_is_no_exchange(
    fields: tuple[str, str], rate: bool
) -> None:
    log = located(50.0, 8.0).change("steering", "command", np.negative).change("steering", "angle", np.negative)
    log = log.change("odom", "yaw_rate", np.negative) if rate else log
    for heading in (COMPASS, AS_IT_STANDS):
        given = read_by(fields, heading)
        cure = inspect_log(log, given).cure
        assert "channels.position.fields" not in {edit.key for edit in cure}
        assert severe(log, edited(given, cure)) == []
