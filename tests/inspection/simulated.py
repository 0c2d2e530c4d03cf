"""Log in memory of a bicycle with known speed, steering and pedals, for tests that plant one fault at a time."""

from collections.abc import Callable
from functools import cache

import numpy as np
from scipy.interpolate import CubicSpline

import factories
from offpiste.inspection.driven_path import DrivenPath, driven_path
from offpiste.inspection.findings import Finding
from offpiste.inspection.inspect import inspect_log
from offpiste.logs.channel import to_z_up
from offpiste.logs.drive import Drive, drive_from_log
from offpiste.rig.channels import ChannelSource
from offpiste.rig.edits import Edit, edited
from offpiste.rig.rig import Rig, parse_rig

WHEELBASE, MAX_STEER = 2.5, 0.4
START = 1.7e9

RIG = f"""
name = "bicycle"
absent = ["brake_pressure", "steer_rate", "engine_rpm"]
[vehicle]
mass = 900.0
max_steer = {MAX_STEER}
pose_point = "rear axle"
wheel_positions = [[2.5, 0.6], [2.5, -0.6], [0.0, 0.6], [0.0, -0.6]]
[channels.position]
topic = "odom"
fields = ["x", "y", "z"]
[channels.orientation]
topic = "odom"
fields = ["qx", "qy", "qz", "qw"]
[channels.linear_velocity]
topic = "odom"
fields = ["vx", "vy", "vz"]
frame = "body"
[channels.angular_velocity]
topic = "odom"
fields = ["wx", "wy", "wz"]
frame = "body"
[channels.throttle]
topic = "pedals"
fields = ["throttle"]
[channels.brake]
topic = "pedals"
fields = ["brake"]
[channels.steer]
topic = "steering"
fields = ["command"]
[channels.steer_angle]
topic = "steering"
fields = ["angle"]
"""


class MemoryLog(factories.MemoryLog):
    """Topics given as (stamps, columns by field), of which tests change one at a time."""

    def __init__(self, topics: dict[str, tuple[np.ndarray, dict[str, np.ndarray]]]) -> None:
        super().__init__(**topics)

    def change(self, topic: str, fields: str, how: Callable[[np.ndarray], np.ndarray]) -> "MemoryLog":
        """The same log with one field changed, or with several whose names are separated by spaces."""
        time, columns = self.data[topic]
        names = [fields] if fields in columns else fields.split()
        return MemoryLog({**self.data, topic: (time, columns | {name: how(columns[name].copy()) for name in names})})

    def put(self, topic: str, **columns: np.ndarray) -> "MemoryLog":
        """The same log with columns of one topic replaced or added."""
        time, before = self.data[topic]
        return MemoryLog({**self.data, topic: (time, before | columns)})

    def restamp(self, topic: str, how: Callable[[np.ndarray], np.ndarray]) -> "MemoryLog":
        """The same log with the stamps of one topic changed."""
        time, columns = self.data[topic]
        return MemoryLog({**self.data, topic: (how(time.copy()), columns)})

    def keep(self, topic: str, rows: np.ndarray) -> "MemoryLog":
        """The same log with only some samples of one topic."""
        time, columns = self.data[topic]
        return MemoryLog({**self.data, topic: (time[rows], {f: c[rows] for f, c in columns.items()})})

    def part(self, rows: dict[str, slice]) -> "MemoryLog":
        """The same log with a slice of each topic."""
        log = self
        for topic, keep in rows.items():
            log = log.keep(topic, np.arange(len(self.data[topic][0]))[keep])
        return log


def rig(*changes: tuple[str, str]) -> Rig:
    """The right rig, with pieces of its text replaced."""
    text = RIG
    for old, new in changes:
        assert old in text
        text = text.replace(old, new)
    return parse_rig(text, where="test")


@cache
def drive_log(seconds: float = 90.0, seed: int = 0, *, braking: float = 5.0) -> MemoryLog:
    """A bicycle with its pose point at the rear axle: yaw rate = v tan(angle) / wheelbase, and a little noise.

    Args:
        braking: what full brakes do [m/s^2].
    """
    random = np.random.default_rng(seed)
    dt = 0.01
    time = np.arange(0, seconds, dt)
    throttle = np.clip(_wander(random, time, 4.0) * 0.6 + 0.3, 0, 1)
    brake = np.where(throttle < 0.02, np.clip(_wander(random, time, 3.0), 0, 1), 0.0)
    steer = np.clip(0.5 * _wander(random, time, 2.5), -1, 1)
    angle = MAX_STEER * steer

    v = np.zeros(len(time))
    for i in range(1, len(time)):
        v[i] = max(v[i - 1] + dt * (3.0 * throttle[i - 1] - braking * brake[i - 1] - 0.15 * v[i - 1]), 0.0)
    yaw_rate = v * np.tan(angle) / WHEELBASE
    yaw = 0.3 + np.cumsum(yaw_rate) * dt
    x, y = np.cumsum(v * np.cos(yaw)) * dt, np.cumsum(v * np.sin(yaw)) * dt
    noise = lambda size: size * random.standard_normal(len(time[::2]))  # noqa: E731
    zero = np.zeros(len(time[::2]))
    odom = {
        "x": x[::2] + noise(0.005),
        "y": y[::2] + noise(0.005),
        "z": 0.5 * np.sin(x[::2] / 40) + noise(0.005),
        "qx": zero,
        "qy": zero,
        "qz": np.sin(yaw[::2] / 2),
        "qw": np.cos(yaw[::2] / 2),
        "vx": v[::2] + noise(0.02),
        "vy": noise(0.02),
        "vz": noise(0.02),
        "wx": noise(0.01),
        "wy": noise(0.01),
        "wz": yaw_rate[::2] + noise(0.01),
    }
    stamps = START + time
    return MemoryLog(
        {
            "odom": (stamps[::2], odom),
            "pedals": (stamps[1::2], {"throttle": throttle[1::2], "brake": brake[1::2]}),
            "steering": (stamps[::4] + 0.003, {"command": steer[::4], "angle": angle[::4]}),
            "wheels": (stamps[::2], {"rear": v[::2] / 0.04 + 2 * random.standard_normal(len(v[::2]))}),
        }
    )


def checked(check: Callable[[Drive, DrivenPath], list[Finding]], log: MemoryLog, *changes: tuple[str, str]) -> list:
    """Findings of one check on a log, read by the right rig with changes."""
    drive = drive_from_log(log, rig(*changes))
    return check(drive, driven_path(drive))


def severe(log: MemoryLog, now: Rig | None = None) -> list[Finding]:
    """Findings of a whole inspection but for notes; by the right rig unless another one is given."""
    return [finding for finding in inspect_log(log, now or rig()).findings if finding.severity != "note"]


def pointing(log: MemoryLog, axes: str) -> tuple[MemoryLog, Rig]:
    """The log as a vehicle with these axes would have recorded it, and the right rig for it.

    The pose has a field `yaw` and the rates a field `yaw_rate`, which the rig reads instead of vectors and quaternions.
    """
    time, odom = log.data["odom"]
    odom = odom | {"yaw": np.unwrap(2 * np.arctan2(odom["qz"], odom["qw"])), "yaw_rate": odom["wz"]}
    vectors = ("qx", "qy", "qz", "qw"), ("x", "y", "z"), ("vx", "vy", "vz"), ("yaw",), ("yaw_rate",)
    for name, fields in zip(("orientation", "position", "linear_velocity", "yaw", "yaw_rate"), vectors, strict=True):
        source = ChannelSource(fields=fields, frame="body")
        # Half a turn undoes itself.
        turned = to_z_up(name, source, np.stack([odom[field] for field in fields], axis=1), axes)
        odom |= dict(zip(fields, turned.T, strict=True))
    edits = [Edit(f"channels.{name}", None) for name in ("orientation", "angular_velocity")]
    edits += [Edit(f"channels.{name}", {"topic": "odom", "fields": [name]}) for name in ("yaw", "yaw_rate")]
    return MemoryLog({**log.data, "odom": (time, odom)}), edited(rig(), [Edit("motion.axes", axes), *edits])


def _wander(random: np.random.Generator, time: np.ndarray, period: float) -> np.ndarray:
    """A smooth random signal of unit spread."""
    knots = np.arange(time[0], time[-1] + 2 * period, period / 2)
    values = random.standard_normal(len(knots))
    return CubicSpline(knots, values)(time)
