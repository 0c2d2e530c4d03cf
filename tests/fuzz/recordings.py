"""A short drive as tables, and its writers for every log format."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pyarrow as pa
import pyarrow.csv as pa_csv
import pyarrow.parquet as pq

from bag_files import converted
from factories import HEAD
from offpiste.logs.ros.writer import McapWriter, header, make
from sensor_bags import odometry_of, twist_of
from tests.fuzz.mutations import Generator, mutate_values

RATE = 25.0
"""Samples a second [1/s]."""
SECONDS = 24.0
START = 1_700_000_000.0
"""First stamp [s]."""
POSE = ("x", "y", "z", "qx", "qy", "qz", "qw")
COMMANDS = ("throttle", "brake", "steer")


@dataclass(frozen=True)
class Table:
    """Samples of one topic: stamps [s] and a column a name."""

    time: np.ndarray
    names: tuple[str, ...]
    values: np.ndarray


Recording = dict[str, Table]


def driven() -> Recording:
    """Bends of changing radius over gentle hills, with pedals and steering that fit."""
    time = np.arange(0, SECONDS, 1 / RATE)
    speed = 4 + 2 * np.sin(0.5 * time)
    steer = 0.4 * np.sin(0.7 * time)
    yaw_rate = speed * np.tan(0.4 * steer) / 2.2
    yaw = np.cumsum(yaw_rate) / RATE
    x, y = np.cumsum(speed * np.cos(yaw)) / RATE, np.cumsum(speed * np.sin(yaw)) / RATE
    zero = np.zeros_like(time)
    pose = np.column_stack((x, y, 0.5 * np.sin(x / 20), zero, zero, np.sin(yaw / 2), np.cos(yaw / 2)))
    rise = np.gradient(speed) * RATE
    pedals = np.column_stack((np.clip(0.3 + 0.3 * rise, 0, 1), np.clip(-0.5 * rise - 0.2, 0, 1), steer))
    return {"odom": Table(START + time, POSE, pose), "commands": Table(START + time + 0.004, COMMANDS, pedals)}


def absurd(recording: Recording, rng: Generator) -> tuple[Recording, str]:
    """Return the recording with absurd stamps or values in one topic."""
    topic = str(rng.choice(sorted(recording)))
    table = recording[topic]
    if rng.random() < 0.3:
        time, how = mutate_values(table.time, rng)
        return recording | {topic: replace(table, time=time)}, f"{topic} stamps {how}"
    values, how = mutate_values(table.values, rng)
    return recording | {topic: replace(table, values=values)}, f"{topic} values {how}"


def write_csv(recording: Recording, path: Path) -> None:
    pa_csv.write_csv(_one_table(recording), path)


def write_parquet(recording: Recording, path: Path) -> None:
    pq.write_table(_one_table(recording), path)


def _one_table(recording: Recording) -> pa.Table:
    columns = {"time": recording["odom"].time}
    for table in recording.values():
        columns |= dict(zip(table.names, table.values.T, strict=True))
    return pa.table({name: np.ascontiguousarray(values) for name, values in columns.items()})


def write_tartandrive(recording: Recording, path: Path) -> None:
    for topic, table in recording.items():
        (path / topic).mkdir(parents=True)
        np.save(path / topic / "data.npy", table.values)
        np.savetxt(path / topic / "timestamps.txt", table.time)


def write_bag(recording: Recording, path: Path, storage: str = "") -> None:
    """Write a ROS 1 bag, or the folder of a ROS 2 bag with this storage."""
    rows = [
        (START + number / RATE, topic, number)
        for topic, table in recording.items()
        for number in range(len(table.time))
    ]
    with TemporaryDirectory() as folder:
        log = Path(folder) / "drive.mcap"
        with McapWriter(log) as writer:
            for arrival, topic, number in sorted(rows):
                stamp = float(np.clip(np.nan_to_num(recording[topic].time[number]), 0, 2**31 - 1))
                message = MESSAGES[topic](header(int(stamp * 1e9), "map"), recording[topic].values[number])
                writer.write(f"/{topic}", message, int(arrival * 1e9))
        converted(log, path, storage)


def _command(head: object, values: np.ndarray) -> object:
    return make("geometry_msgs/TwistStamped", header=head, twist=twist_of((*values[:2], 0), (0, 0, values[2])))


MESSAGES = {"odom": lambda head, values: odometry_of(head, values[:3], values[3:]), "commands": _command}
write_ros1, write_mcap, write_db3 = write_bag, partial(write_bag, storage="mcap"), partial(write_bag, storage="sqlite3")


@dataclass(frozen=True)
class Container:
    """A format: its writer, the name of what it writes, and its topics and fields by those of a recording."""

    name: str
    write: Callable[[Recording, Path], None]
    topics: dict[str, str]
    fields: dict[str, str]


_COLUMNS = {name: name for name in (*POSE, *COMMANDS)}
_NUMBERS = {name: str(number) for names in (POSE, COMMANDS) for number, name in enumerate(names)}
_PATHS = {name: f"pose.pose.position.{name}" for name in "xyz"}
_PATHS |= {f"q{name}": f"pose.pose.orientation.{name}" for name in "xyzw"}
_PATHS |= {"throttle": "twist.linear.x", "brake": "twist.linear.y", "steer": "twist.angular.z"}
_TABLE, _FOLDERS = {"odom": "", "commands": ""}, {"odom": "odom", "commands": "commands"}
_TOPICS = {"odom": "/odom", "commands": "/commands"}
CONTAINERS = {
    "csv": Container("drive.csv", write_csv, _TABLE, _COLUMNS),
    "parquet": Container("drive.parquet", write_parquet, _TABLE, _COLUMNS),
    "tartandrive": Container("drive", write_tartandrive, _FOLDERS, _NUMBERS),
    "ros1": Container("drive.bag", write_ros1, _TOPICS, _PATHS),
    "mcap": Container("drive", write_mcap, _TOPICS, _PATHS),
    "db3": Container("drive", write_db3, _TOPICS, _PATHS),
}
"""Formats by name; what each writes is called `name`."""

VEHICLE = HEAD + "[clock]\nmax_gap = 0.5\n[motion]\nwindow = 0.3\nslope_length = 6.0\n"


def rig_text(kind: str) -> str:
    """A rig that reads a container."""
    container, text = CONTAINERS[kind], VEHICLE
    for channel, topic, names in (
        ("position", "odom", POSE[:3]),
        ("orientation", "odom", POSE[3:]),
        *((name, "commands", (name,)) for name in COMMANDS),
    ):
        fields = ", ".join(f'"{container.fields[name]}"' for name in names)
        text += f'[channels.{channel}]\ntopic = "{container.topics[topic]}"\nfields = [{fields}]\nscale = 1.0\n'
    return text
