"""Time travel: nothing that a model is given for a window changes when the log is changed after the window's start."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.csv
import pyarrow.parquet
import pytest
import torch
from msgspec import structs
from scipy.spatial.transform import Rotation

from bag_files import converted
from factories import HEAD
from offpiste.dataset.columns import COLUMNS
from offpiste.dataset.resample import Rows, extract_rows
from offpiste.dataset.splits import parse_split
from offpiste.dataset.store import Dataset, StoredDrive
from offpiste.dataset.windows import Windows
from offpiste.logs.drive import drive_from_log, read_drive
from offpiste.logs.log import Log, Samples, Topic, open_log
from offpiste.logs.ros.writer import McapWriter, header, make
from offpiste.rig.rig import Rig, load_rig, parse_rig
from sensor_bags import odometry_of, twist_of

START = 1_300_000_000.0
CHANGE = START + 6.0051
"""Samples stamped later are changed; it lies between two stamps of every topic [s]."""
Topics = dict[str, tuple[np.ndarray, np.ndarray]]
"""Stamps, and one column for each of `FIELDS`."""
FIELDS = {
    "odom": ("x", "y", "z", "qx", "qy", "qz", "qw"),
    "pedals": ("throttle", "brake", "pressure", "rpm"),
    "steering": ("command", "angle"),
}
CHANNELS = {
    "position": ("odom", "x", "y", "z"),
    "orientation": ("odom", "qx", "qy", "qz", "qw"),
    "throttle": ("pedals", "throttle"),
    "brake": ("pedals", "brake"),
    "brake_pressure": ("pedals", "pressure"),
    "engine_rpm": ("pedals", "rpm"),
    "steer": ("steering", "command"),
    "steer_angle": ("steering", "angle"),
}
POSE = [f"pose.pose.position.{axis}" for axis in "xyz"] + [f"pose.pose.orientation.{axis}" for axis in "xyzw"]
TWIST = [f"twist.{part}.{axis}" for part in ("linear", "angular") for axis in "xyz"]


def driven(change: str = "") -> Topics:
    """Twelve seconds of a vehicle that turns on rising ground; its commands and motion differ after `CHANGE`.

    Args:
        change: "motion" commands otherwise, "values" is noise, "stamps" drops and moves samples, "gap" drops a second.
    """
    time, rng = np.arange(0, 12, 0.01), np.random.default_rng(5)
    late = START + time > CHANGE
    throttle, angle = 0.5 + 0.2 * np.sin(1.3 * time), 0.2 * np.sin(0.9 * time)
    if change:
        throttle[late], angle[late] = 0.2, angle[late] + 0.1 * np.sin(2 * (START + time[late] - CHANGE))
    speed = 2.0 + np.cumsum(4 * throttle - 1.5) * 0.01
    yaw = np.cumsum(speed * np.tan(angle) / 2.2) * 0.01
    place = np.cumsum(speed * np.stack((np.cos(yaw), np.sin(yaw), 0.1 * np.sin(time))), axis=1) * 0.01
    whole = {
        "odom": np.column_stack((*place, Rotation.from_euler("z", yaw[:, None]).as_quat())),
        "pedals": np.column_stack((throttle, 0.1 * (throttle < 0.4), 0.1 * throttle, 3000 * throttle)),
        "steering": np.column_stack((angle / 0.4, angle)),
    }
    topics = {}
    for (name, values), every, offset in zip(whole.items(), (1, 2, 4), (0.0, 0.003, 0.007), strict=True):
        stamps, rows = START + time[::every] + offset, values[::every].copy()
        late = stamps > CHANGE
        if change in ("values", "stamps"):
            rows[late] += rng.normal(0, 30.0 if change == "values" else 1e-3, rows[late].shape)
        if change == "stamps":
            stamps[late] += rng.uniform(0, 0.004, late.sum())
            late &= rng.random(len(late)) < 0.2
        kept = ~late if change == "stamps" else (stamps < CHANGE) | (stamps > CHANGE + 1) | (change != "gap")
        topics[name] = stamps[kept], rows[kept]
    return topics


def message_of(topic: str, ns: int, values: np.ndarray) -> object:
    """A ROS message with a number for each field of a topic."""
    head = header(ns, "map")
    if topic == "odom":
        return odometry_of(head, values[:3], values[3:])
    six = np.pad(values, (0, 6 - len(values)))
    return make("geometry_msgs/TwistStamped", header=head, twist=twist_of(six[:3], six[3:]))


def bag(path: Path, topics: Topics, storage: str = "") -> None:
    """Write a ROS 1 bag, or the folder of a ROS 2 bag with this storage."""
    log = path.with_name("written.mcap")
    with McapWriter(log) as writer:
        for at, topic, row in sorted((t, name, i) for name, (time, _) in topics.items() for i, t in enumerate(time)):
            ns = round(at * 1e9)
            writer.write(f"/{topic}", message_of(topic, ns, topics[topic][1][row]), ns)
    converted(log, path, storage)


def tartandrive(path: Path, topics: Topics) -> None:
    for name, (time, values) in topics.items():
        (path / name).mkdir(parents=True)
        np.save(path / name / "data.npy", values)
        np.savetxt(path / name / "timestamps.txt", time, "%.9f")


def table(write: Callable[[pa.Table, Path], None]) -> Callable[[Path, Topics], None]:
    """Return a writer of one row per stamp, with empty cells for topics that have no sample at that stamp."""

    def whole(path: Path, topics: Topics) -> None:
        time = np.unique(np.concatenate([stamps for stamps, _ in topics.values()]))
        columns = {"time": pa.array(time)}
        for name, (stamps, values) in topics.items():
            for field, column in zip(FIELDS[name], values.T, strict=True):
                cells = np.full(len(time), np.nan)
                cells[np.searchsorted(time, stamps)] = column
                columns[field] = pa.array(cells, mask=np.isnan(cells))
        write(pa.table(columns), path)

    return whole


def kitti(path: Path, topics: Topics) -> None:
    """Poses alone, as latitudes and longitudes."""
    (path / "oxts" / "data").mkdir(parents=True)
    time, (x, y, z, *quaternion) = topics["odom"][0], topics["odom"][1].T
    stamps = np.round(time * 1e9).astype(np.int64).astype("datetime64[ns]")
    (path / "oxts" / "timestamps.txt").write_text("\n".join(str(stamp).replace("T", " ") for stamp in stamps))
    euler = np.unwrap(2 * np.arctan2(quaternion[2], quaternion[3]))
    degrees = np.rad2deg(1 / 6378137.0)
    rates = np.diff(np.stack((y, x, z, euler)), axis=1, prepend=0.0) / np.diff(time, prepend=0.0)
    for row in range(len(time)):
        values = [y[row] * degrees, x[row] * degrees, z[row], 0.0, 0.0, euler[row], *24 * [0.0]]
        values[6:8], values[10], values[19] = rates[:2, row].tolist(), rates[2, row], rates[3, row]
        (path / "oxts" / "data" / f"{row:010}.txt").write_text(" ".join(map(repr, map(float, values))))


def rig_of(name: Callable[[str, str], str], topic: str = 'topic = "{}"\n') -> Rig:
    """A rig for a format, by how it names a topic's fields."""
    text = "\n".join(line for line in HEAD.split("\n") if not line.startswith("absent"))
    for channel, (of, *fields) in CHANNELS.items():
        unit = 'unit = "rev/min"\n' if channel == "engine_rpm" else ""
        text += f"[channels.{channel}]\n{topic.format(of)}fields = {[name(of, f) for f in fields]}\n{unit}"
    return parse_rig(text, where="test")


ROS = rig_of(lambda topic, field: (POSE if topic == "odom" else TWIST)[FIELDS[topic].index(field)], 'topic = "/{}"\n')
NUMBERED = rig_of(lambda topic, field: str(FIELDS[topic].index(field)))
NAMED = rig_of(lambda topic, field: field, "")
FORMATS: dict[str, tuple[str, Rig, Callable[[Path, Topics], None]]] = {
    "mcap": ("drive", ROS, partial(bag, storage="mcap")),
    "db3": ("drive", ROS, partial(bag, storage="sqlite3")),
    "bag": ("drive.bag", ROS, bag),
    "kitti": ("drive_sync", load_rig("kitti"), kitti),
    "tartandrive": ("drive", NUMBERED, tartandrive),
    "csv": ("drive.csv", NAMED, table(pa.csv.write_csv)),
    "parquet": ("drive.parquet", NAMED, table(pa.parquet.write_table)),
}


def windows_of(rows: Rows, rig: Rig, until: float) -> Windows:
    """Windows of one second that start until a moment [s]."""
    split = parse_split("blocks:1,0,0")
    drives = (StoredDrive("drive", rows, np.zeros(len(rows.time), int), ()),)
    windows = Windows(Dataset(Path("memory"), rig, split, drives), "train", min_speed=0.5, horizon=50)
    return windows[np.flatnonzero(rows.time[windows.rows] <= until)]


def given(rows: Rows, windows: Windows, until: float) -> dict[str, np.ndarray]:
    """Return a model's inputs from rows until a time and from windows by name, and the targets, which it never gets."""
    known = rows.time <= until
    read = {name for name, column in COLUMNS.items() if {"past", "start"} & set(column.segments)} - {"normal"}
    batch = windows.gather(np.arange(len(windows)))
    past = batch.history
    return {name: rows.column(name)[known] for name in read} | {
        "time": rows.time[known],
        "origin": rows.origin,
        "start": torch.cat((batch.state, batch.actuators), dim=1).numpy(),
        "history": torch.cat((past.state, past.actuators, past.control), dim=2).numpy(),
        "history normals": past.terrain.normal.numpy(),
        "targets": batch.target.numpy(),
    }


def differing(ours: Rows, others: Rows, rig: Rig, until: float = CHANGE) -> set[str]:
    """Return the names of inputs that differ in any bit between rows, or between windows that both have."""
    windows = windows_of(ours, rig, until), windows_of(others, rig, until)
    shared = np.intersect1d(windows[0].rows, windows[1].rows, return_indices=True)[1:]
    assert len(shared[0]) > 50
    one, other = (
        given(rows, of[index], until) for rows, of, index in zip((ours, others), windows, shared, strict=True)
    )
    return {name for name, values in one.items() if not np.array_equal(values, other[name], equal_nan=True)}


def extracted(format_name: str, folder: Path, change: str = "") -> Rows:
    name, rig, write = FORMATS[format_name]
    folder = folder / (change or "as it was")
    folder.mkdir()
    write(folder / name, driven(change))
    return extract_rows(read_drive(folder / name, rig))


@pytest.mark.parametrize("format_name", FORMATS)
def test_what_a_model_is_given_does_not_depend_on_later_samples(format_name: str, tmp_path: Path) -> None:
    rows, rig = extracted(format_name, tmp_path), FORMATS[format_name][1]
    assert rows.time[0] < CHANGE - 5
    for change in ("motion", "stamps", "values", "gap"):
        changed = differing(rows, extracted(format_name, tmp_path, change), rig)
        # No window reaches across noise or a gap, so that there may be no target to differ.
        assert changed == {"targets"} or (not changed and change in ("values", "gap")), change


@pytest.mark.parametrize("name", ["actuators", "control", "state"])
def test_a_column_that_reads_a_later_sample_is_found(name: str, monkeypatch, tmp_path: Path) -> None:
    monkeypatch.setattr(COLUMNS, "_entries", dict(COLUMNS.items()))
    COLUMNS._entries[f"{name}_causal"] = replace(COLUMNS[f"{name}_causal"], read=COLUMNS[name].read)
    rows, others = (extracted("parquet", tmp_path, change) for change in ("", "stamps"))
    assert differing(rows, others, FORMATS["parquet"][1]) >= {f"{name}_causal", "targets"}


class ChangedLog(Log):
    """The first seconds of a log, with noise in what is stamped after a moment.

    Args:
        until: last stamp that is kept as it is [s]; None changes nothing.
    """

    def __init__(self, log: Log, end: float, until: float | None = None) -> None:
        self.path, self._log, self._end, self._until = log.path, log, end, until

    @property
    def topics(self) -> dict[str, Topic]:
        """Topics of the log."""
        return self._log.topics

    def _read(self, topic: Topic, fields: Sequence[str], stamps: str) -> Samples:
        samples = self._log.read(topic.name, fields, stamps=stamps)
        time, values = samples.time[samples.time < self._end], samples.values[samples.time < self._end].copy()
        if self._until is not None:
            late = time > self._until
            values[late] += np.random.default_rng(0).normal(0, values.std(axis=0) + 0.1, values[late].shape)
        return Samples(time, values)


@pytest.mark.parametrize(
    ("name", "preset"),
    [
        ("tartandrive2/drives/2023-10-26-14-42-35_turnpike_afternoon_fall", "tartandrive2"),
        ("dart/83_16_april_2025_slippery_floor/2025-04-16-15-51-18.csv", "dart"),
        ("kitti_raw/2011_09_26/2011_09_26_drive_0013_sync", "kitti"),
    ],
)
def test_recorded_drives(data_folder: Path, name: str, preset: str) -> None:
    rig = structs.replace(load_rig(preset), alignment=None)
    log = open_log(data_folder / name, clock=rig.clock)
    place = rig.channels["position"]
    began = float(log.read(place.topic, place.fields).time[0])
    late = began + (8.0 if preset == "kitti" else 40.0)
    rows, others = (extract_rows(drive_from_log(ChangedLog(log, late + 6, at), rig)) for at in (None, late))
    assert differing(rows, others, rig, late) <= {"targets"}
    assert not np.array_equal(rows.state[rows.time > late], others.state[others.time > late], equal_nan=True)
