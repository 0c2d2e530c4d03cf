"""Decoding limits of images, times of points, and usable points against plain NumPy."""

from io import BytesIO
from itertools import product

import numpy as np
import PIL.Image
import pytest
from scipy.spatial.transform import Rotation

from offpiste.core.errors import LogError
from offpiste.logs.log import RawCloud
from offpiste.logs.measurements import (
    Lidar,
    cloud_from_records,
    decoded_picture,
    misread_times,
    proposed_times,
    usable_points,
)
from offpiste.rig.sensors import LidarSource
from point_clocks import DRIVERS, SWEEP, PointClock


@pytest.mark.parametrize(("side", "is_read"), [(64, True), (12_000, False)])
def test_a_small_file_cannot_ask_for_a_picture_beyond_the_limit(side: int, is_read: bool) -> None:
    file = BytesIO()
    PIL.Image.new("1", (side, side)).save(file, "png")
    assert len(file.getvalue()) < 100_000
    picture = decoded_picture(np.frombuffer(file.getvalue(), np.uint8), 0)
    assert picture.shape == (side, side) if is_read else picture is None


STAMP = 1_750_000_000.25
XYZ = np.random.default_rng(0).uniform(1, 9, (400, 3))


def scan(clock: PointClock, stamp: float = STAMP) -> RawCloud:
    return RawCloud(stamp, "lidar", clock.fill(stamp, XYZ))


def source(clock: PointClock, **changed: str) -> LidarSource:
    return LidarSource(topic="/points", **(clock.entries | changed))


@pytest.mark.parametrize("stamp", [STAMP, 100.25])  # of a real drive, and of a simulated one
@pytest.mark.parametrize("name", DRIVERS)
def test_every_other_unit_and_origin_is_found_and_put_right(name: str, stamp: float) -> None:
    clock = DRIVERS[name]
    raw, right = scan(clock, stamp), (clock.unit, clock.origin)
    assert misread_times(raw, source(clock), SWEEP) is None
    assert proposed_times(raw, SWEEP) == clock.entries
    for unit, origin in set(product(("s", "ms", "us", "ns"), ("stamp", "epoch"))) - {right}:
        misread = misread_times(raw, source(clock, time_unit=unit, time_origin=origin), SWEEP)
        assert misread is not None
        assert clock.entries == clock.entries | {"time_unit": unit, "time_origin": origin} | misread.entries


def test_nanoseconds_read_as_microseconds_are_one_line() -> None:
    clock = DRIVERS["Ouster"]
    lidar = Lidar("top", np.eye(4), source(clock, time_unit="us"))
    with pytest.raises(LogError) as error:
        cloud_from_records(scan(clock), lidar)
    what = "'top': 't', read in us since the stamp, puts points 49.9 s from their scan's stamp"
    assert str(error.value) == f'{what}; lidars.top.time_unit = "ns"'
    right = cloud_from_records(scan(clock), Lidar("top", np.eye(4), source(clock)))
    assert right.offset is not None
    np.testing.assert_allclose(right.offset, np.linspace(0, SWEEP, 400, endpoint=False), atol=1e-8)


def test_microseconds_read_as_nanoseconds_are_found_by_the_time_between_scans() -> None:
    clock = DRIVERS["microseconds"]
    misread = misread_times(scan(clock), source(clock, time_unit="ns"), SWEEP)
    assert misread is not None
    assert misread.what == "'time_stamp', read in ns since the stamp, takes 9e-05 s for scans that come every 0.1 s"


@pytest.mark.parametrize("times", [np.zeros(400), np.linspace(0, 0.01, 400), np.linspace(0, 0.8, 400)])
def test_compensated_scans_sectors_slow_sweeps_and_thinned_scans_are_right(times: np.ndarray) -> None:
    clock = PointClock("t", "<f8", lambda _, since: times, "s", "stamp")
    assert misread_times(scan(clock), source(clock), SWEEP) is None
    for period in (0.0, 0.1, 0.5, 5.0):
        assert misread_times(scan(DRIVERS["Ouster"]), source(DRIVERS["Ouster"]), period) is None


def test_points_without_echo_say_nothing() -> None:
    """Drivers of organised clouds leave their times at zero, which is 1970."""
    clock = DRIVERS["Hesai"]
    raw = scan(clock)
    for fault, some in ((np.nan, slice(0, 200)), (0.0, slice(200, 320))):
        for field in raw.points.dtype.names or ():
            raw.points[field][some] = 0.0 if field == "timestamp" else fault
    assert misread_times(raw, source(clock), SWEEP) is None
    assert proposed_times(raw, SWEEP) == clock.entries


def test_single_points_far_from_the_stamp_are_dropped() -> None:
    clock = DRIVERS["Hesai"]
    raw = scan(clock)
    raw.points["timestamp"][:20] = (0.0, np.nan) * 10
    cloud = cloud_from_records(raw, Lidar("top", np.eye(4), source(clock)))
    assert len(cloud.points) == 380


def test_a_clock_of_its_own_has_no_unit_that_fits() -> None:
    clock = PointClock("timestamp", "<f8", lambda _, since: 4000.0 + since, "s", "epoch")
    misread = misread_times(scan(clock), source(clock), SWEEP)
    assert misread is not None
    assert misread.entries == {}
    assert "and no other unit or origin fits" in misread.what
    assert misread.remedy("top").startswith("remove lidars.top.time_field, or record with the LiDAR's clock")
    assert proposed_times(scan(clock), SWEEP) == {}
    assert len(cloud_from_records(scan(clock), Lidar("top", np.eye(4), source(clock))).points) == 0


BOX = ((-1.0, -2.0, -1.0), (3.0, 0.5, 2.0))


def plain(points: np.ndarray, lidar: Lidar) -> np.ndarray:
    source = lidar.source
    with np.errstate(invalid="ignore", over="ignore"):
        distance = np.linalg.norm(points, axis=1)
        keep = np.isfinite(distance) & (distance > 0) & (distance >= source.min_range) & (distance <= source.max_range)
        if source.own_body is not None:
            body = points @ lidar.body_from_lidar[:3, :3].T + lidar.body_from_lidar[:3, 3]
            keep &= ~((body >= source.own_body[0]) & (body <= source.own_body[1])).all(axis=1)
    return keep


def top(**options) -> Lidar:
    mounting = np.eye(4)
    mounting[:3, :3], mounting[:3, 3] = Rotation.random(random_state=3).as_matrix(), (0.1, 0.2, 1.9)
    return Lidar("top", mounting, LidarSource(topic="top", **options))


@pytest.mark.parametrize("count", [0, 3, 6000])
@pytest.mark.parametrize("options", [{}, {"own_body": BOX}, {"own_body": BOX, "min_range": 2.0, "max_range": 9.0}])
def test_usable_points_are_those_of_numpy(count: int, options: dict):
    rng = np.random.default_rng(count)
    points = rng.normal(size=(count, 3)) * 4
    for number, fault in enumerate((0.0, np.nan, np.inf, 1e300)):
        points[number::50] = fault
    points[4::50, 1] = np.nan
    lidar = top(**options)
    usable = usable_points(points, lidar)
    np.testing.assert_array_equal(usable, plain(points, lidar))
    if count > 100:
        assert 0 < usable.sum() < count


@pytest.mark.parametrize("kind", ["<f4", "<f8", "<i2"])
def test_records_of_any_number_become_points(kind: str):
    rng = np.random.default_rng(0)
    records = np.zeros(300, [("pad", "u1"), ("x", kind), ("y", kind), ("z", kind), ("intensity", "<f4")])
    for name in "xyz":
        records[name] = rng.integers(-30, 30, 300)
    records["intensity"] = np.arange(300)
    cloud = cloud_from_records(RawCloud(1.0, "top", records), top(own_body=BOX))
    points = np.stack([records[name] for name in "xyz"], axis=1).astype(np.float64)
    keep = plain(points, top(own_body=BOX))
    np.testing.assert_array_equal(cloud.points, points[keep])
    np.testing.assert_array_equal(cloud.intensity, records["intensity"][keep])
    assert cloud.offset is None
