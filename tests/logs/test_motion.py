"""Planar motion on known paths: circles, slopes, lever arms and frames."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from factories import RIG
from offpiste.logs.channel import Channel
from offpiste.logs.drive import Drive
from offpiste.logs.motion import driven_slope, estimate_motion
from offpiste.rig.rig import parse_rig

SPEED, RATE, AHEAD = 4.0, 0.5, 1.1  # of the rear axle [m/s, rad/s]; the pose point lies AHEAD of it [m]


def rates_toml(which: str, frame: str) -> str:
    return f'[channels.{which}_velocity]\ntopic = "odometry"\nfields = ["a", "b", "c"]\nframe = "{frame}"\n'


class Circle:
    """Vehicle on a circle, in a world tilted by `pitch` about y."""

    def __init__(self, *, rate: float = 100.0, seconds: float = 6.0, pitch: float = 0.0) -> None:
        self.time = np.arange(0, seconds, 1 / rate)
        turned = RATE * self.time
        axle = SPEED / RATE * np.stack((np.sin(turned), 1 - np.cos(turned), 0 * turned), axis=1)
        heading = np.stack((np.cos(turned), np.sin(turned), 0 * turned), axis=1)
        tilt = Rotation.from_euler("y", pitch)
        self.rotation = tilt * Rotation.from_euler("z", turned[:, None])
        self.place = tilt.apply(axle + AHEAD * heading)
        self.velocity_body = np.tile([SPEED, RATE * AHEAD, 0.0], (len(turned), 1))
        self.velocity_world = self.rotation.apply(self.velocity_body)
        self.gyro = np.tile([0.0, 0.0, RATE], (len(turned), 1))

    def state(self) -> np.ndarray:
        """The truth, by the definitions of docs/method.md."""
        forward = self.rotation.apply([1.0, 0.0, 0.0])
        yaw = np.unwrap(np.arctan2(forward[:, 1], forward[:, 0]))
        vx = self.velocity_world[:, 0] * np.cos(yaw) + self.velocity_world[:, 1] * np.sin(yaw)
        vy = self.velocity_world[:, 1] * np.cos(yaw) - self.velocity_world[:, 0] * np.sin(yaw)
        return np.column_stack((self.place[:, :2], yaw, vx, vy, np.gradient(yaw, self.time, edge_order=2)))

    def drive(self, velocity: str = "", gyro: bool = False, noise: float = 0.0) -> Drive:
        more = rates_toml("linear", velocity) if velocity else ""
        more += rates_toml("angular", "body") if gyro else ""
        place = self.place + np.random.default_rng(0).normal(0, noise, self.place.shape)
        values = {"position": place, "orientation": self.rotation.as_quat()}
        if velocity:
            values["linear_velocity"] = self.velocity_body if velocity == "body" else self.velocity_world
        if gyro:
            values["angular_velocity"] = self.gyro
        channels = {name: Channel(name, "", self.time, value) for name, value in values.items()}
        return Drive("circle", parse_rig(RIG + more, where="test"), channels)


SOURCES = [(velocity, gyro) for velocity in ("", "world", "body", "unknown") for gyro in (False, True)]


@pytest.mark.parametrize(("velocity", "gyro"), SOURCES)
@pytest.mark.parametrize("pitch", [0.0, np.deg2rad(20)])
def test_every_source_of_velocity_gives_the_same_known_motion(velocity, gyro, pitch):
    circle = Circle(pitch=pitch)
    rows = slice(50, -50)
    motion = estimate_motion(circle.drive(velocity, gyro), circle.time)
    wanted = circle.state()[rows]
    np.testing.assert_allclose(motion.state[rows], wanted, atol=4e-3)
    np.testing.assert_allclose(motion.state_causal[rows], wanted, atol=1.5e-2)


@pytest.mark.parametrize(("velocity", "gyro"), SOURCES)
@pytest.mark.parametrize("row", [120, 121, 200])
def test_the_causal_estimate_uses_the_past_only(velocity, gyro, row):
    circle = Circle()
    drive = circle.drive(velocity, gyro)
    at = circle.time[row : row + 1] + 0.004

    def changed(channel: Channel) -> Channel:
        values = np.where((channel.time > at)[:, None], np.roll(channel.values, 7, axis=0), channel.values)
        return replace(channel, values=values)

    # Orientation and the others are stamped apart, as they are in logs.
    orientation = drive.channels["orientation"]
    apart = drive.channels | {"orientation": replace(orientation, time=orientation.time + 0.007)}
    ours, others = (
        Drive("", drive.rig, channels) for channels in (apart, {name: changed(each) for name, each in apart.items()})
    )
    np.testing.assert_array_equal(estimate_motion(ours, at).state_causal, estimate_motion(others, at).state_causal)
    assert not np.array_equal(estimate_motion(ours, at).state, estimate_motion(others, at).state)


def test_the_causal_estimate_follows_a_changing_speed_within_a_few_hundredths_of_a_second():
    time = np.arange(0, 8, 0.02)
    speed = 4 + 2 * np.sin(1.5 * time)
    x = 4 * time + 2 / 1.5 * (1 - np.cos(1.5 * time))
    circle = Circle()
    circle.time, circle.place = time, np.stack((x, 0 * x, 0 * x), axis=1)
    circle.rotation = Rotation.from_euler("z", 0 * time[:, None])
    vx = estimate_motion(circle.drive(), time).state_causal[:, 3]
    rows = np.isfinite(vx)
    lags = np.arange(-0.1, 0.2, 0.005)
    misfit = [np.std(vx[rows] - np.interp(time[rows] - lag, time, speed)) for lag in lags]
    assert abs(lags[np.argmin(misfit)]) < 0.05


def test_in_a_gap_nothing_is_known():
    circle = Circle()
    drive = circle.drive()
    keep = (circle.time < 2) | (circle.time > 4)
    channels = {n: Channel(n, "", c.time[keep], c.values[keep]) for n, c in drive.channels.items()}
    motion = estimate_motion(Drive("gap", drive.rig, channels), circle.time)
    inside = (circle.time > 2.01) & (circle.time < 3.99)
    assert np.isnan(motion.state[inside]).all()
    # Whether a gap has begun shows only after max_gap.
    assert np.isnan(motion.state_causal[inside & (circle.time > 2.01 + drive.rig.clock.max_gap)]).all()
    assert np.isfinite(motion.state[(circle.time > 0.5) & (circle.time < 1.8)]).all()


def hill(speed: np.ndarray, grade: float, noise: float = 0.0) -> np.ndarray:
    """Return positions on a grade at given horizontal speeds."""
    along = np.cumsum(speed) * 0.02
    z = grade * along + np.random.default_rng(0).normal(0, noise, len(speed))
    return np.stack((along, 0 * along, z), axis=1)


@pytest.mark.parametrize("speed", [1.0, 5.0, 15.0])
@pytest.mark.parametrize("grade", [-0.3, 0.0, 0.15])
def test_the_driven_slope_is_the_grade_at_any_speed(speed, grade):
    speeds = np.full(1500, speed)
    slope = driven_slope(hill(speeds, grade), speeds, dt=0.02, length=6.0)
    np.testing.assert_allclose(slope[50:-50], grade, atol=0.01)


def test_braking_dips_of_the_body_hardly_show():
    speeds = np.full(1000, 5.0)
    place = hill(speeds, 0.0)
    place[500:510, 2] -= 0.05
    slope = driven_slope(place, speeds, dt=0.02, length=6.0)
    assert np.abs(slope).max() < 0.025


@pytest.mark.parametrize("causal", [False, True])
def test_standing_still_and_reversing_leave_the_slope_along_the_heading_as_it_was(causal):
    speeds = np.concatenate((np.full(300, 3.0), np.zeros(200), np.full(300, 3.0), np.full(400, -3.0)))
    slope = driven_slope(hill(speeds, 0.2, noise=0.002), speeds, dt=0.02, length=6.0, causal=causal)
    np.testing.assert_allclose(slope[60:-20], 0.2, atol=0.02)


@pytest.mark.parametrize("direction", [1, -1])
def test_the_slope_behind_is_the_grade_after_two_metres_and_never_reads_a_later_row(direction):
    speeds = np.full(600, direction * 3.0)
    speeds[200:260] = 0.0
    place = hill(speeds, 0.2, noise=0.002)
    slope = driven_slope(place, speeds, dt=0.02, length=6.0, causal=True)
    assert (slope[:20] == 0).all()
    np.testing.assert_allclose(slope[60:], 0.2, atol=0.02)
    for row in (90, 230, 400):
        later, faster = place.copy(), speeds.copy()
        later[row + 1 :], faster[row + 1 :] = 7.0, -5.0
        again = driven_slope(later, faster, dt=0.02, length=6.0, causal=True)
        np.testing.assert_array_equal(again[: row + 1], slope[: row + 1])
    assert not np.array_equal(again, slope)


def test_a_gap_between_two_heights_is_no_cliff():
    speeds = np.full(1000, 3.0)
    place = hill(speeds, 0.1)
    place[500:] += (0, 0, 10)
    place[480:500] = np.nan
    slope = driven_slope(place, speeds, dt=0.02, length=6.0)
    assert np.isnan(slope[480:500]).all()
    known = np.isfinite(slope)
    assert known.sum() == 980
    np.testing.assert_allclose(slope[known], 0.1, atol=0.02)


def test_a_speed_beyond_reason_does_not_decide_on_the_size_of_anything():
    time = np.arange(0, 3, 0.02)
    place = np.column_stack((4 * time, 0 * time, 0.1 * 4 * time))
    speed = np.full(len(time), 4.0)
    speed[100:] = 1e15  # a grid of the path would take 27 PiB
    slope = driven_slope(place, speed, dt=0.02, length=2.0)
    assert np.isfinite(slope).all()
    np.testing.assert_allclose(slope[10:60], 0.1, atol=1e-3)
