"""`offpiste inspect` on a long log with a camera and a LiDAR: seconds and peak memory of the command.

`python benchmarks/inspect_log.py DRIVE.mcap [--minutes 60] [--scratch long.mcap]`: writes a log of that length by
repeating a simulated drive (`offpiste simulate --sensors light`), each time with later stamps and with poses that go on
where the last ones ended; then runs the command on it in a process of its own.
"""

import resource
import struct
import subprocess
import sys
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import tyro
from mcap.reader import make_reader
from mcap.writer import CompressionType, Writer
from scipy.spatial.transform import Rotation

_POSE = "/odometry"


@dataclass(frozen=True)
class Record:
    """A message of the drive, its time since the first [ns]."""

    channel: int
    time: int
    data: bytes


def repeated(drive: Path, out: Path, minutes: float) -> None:
    """Write a drive several times, one after the other."""
    with drive.open("rb") as file, out.open("wb") as target:
        reader = make_reader(file)
        summary = reader.get_summary()
        assert summary is not None
        writer = Writer(target, chunk_size=4 << 20, compression=CompressionType.LZ4)
        writer.start(profile="ros2", library="offpiste")
        schemas = {k: writer.register_schema(s.name, s.encoding, s.data) for k, s in summary.schemas.items()}
        channels = {
            k: writer.register_channel(c.topic, c.message_encoding, schemas[c.schema_id])
            for k, c in summary.channels.items()
        }
        pose = next(k for k, c in summary.channels.items() if c.topic == _POSE)
        messages = [Record(c.id, m.log_time, m.data) for _, c, m in reader.iter_messages()]
        first, last = messages[0].time, messages[-1].time
        period, place = last - first + 20_000_000, np.eye(4)
        poses = [_matrix(m.data) for m in messages if m.channel == pose]
        step = poses[-1] @ np.linalg.inv(poses[0])
        step[:3, :3] = Rotation.from_euler("z", np.arctan2(step[1, 0], step[0, 0])).as_matrix()
        step[:3, 3] = poses[-1][:3, 3] - step[:3, :3] @ poses[0][:3, 3]
        for k in range(round(minutes * 60e9 / period)):
            for m in messages:
                data = _later(m.data, k * period)
                data = _moved(data, place) if m.channel == pose else data
                writer.add_message(channels[m.channel], m.time + k * period, data, m.time + k * period)
            place = place @ step
        writer.finish()


def _later(data: bytes, shift: int) -> bytes:
    """CDR of a message with a header, stamped later; one without is left as it is."""
    seconds, rest = struct.unpack_from("<iI", data, 4) if len(data) >= 12 else (0, 0)
    if not 1_600_000_000 < seconds < 2_000_000_000:
        return data
    seconds, rest = divmod(seconds * 10**9 + rest + shift, 10**9)
    return data[:4] + struct.pack("<iI", seconds, rest) + data[12:]


def _place(data: bytes) -> int:
    """Where the pose of a nav_msgs/Odometry begins, after its header and child frame."""
    at = 12
    for _ in range(2):
        at += -(at - 4) % 4
        at += 4 + struct.unpack_from("<I", data, at)[0]
    return at + -(at - 4) % 8


def _matrix(data: bytes) -> np.ndarray:
    values = struct.unpack_from("<7d", data, _place(data))
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = Rotation.from_quat(values[3:]).as_matrix(), values[:3]
    return matrix


def _moved(data: bytes, place: np.ndarray) -> bytes:
    matrix, at = place @ _matrix(data), _place(data)
    pose = (*matrix[:3, 3], *Rotation.from_matrix(matrix[:3, :3]).as_quat())
    return data[:at] + struct.pack("<7d", *pose) + data[at + 56 :]


def main(
    drive: tyro.conf.Positional[Path],
    minutes: float = 60.0,
    rig: str = "proving_ground",
    scratch: Path = Path("long.mcap"),
    smoke: bool = False,
) -> None:
    """Make the long log if it is not there yet, and inspect it.

    Args:
        smoke: a log of some seconds, to try it.
    """
    if smoke:
        minutes = 0.2
    if not scratch.exists():
        repeated(drive, scratch, minutes)
    began = time.perf_counter()
    command = [sys.executable, "-m", "offpiste", "inspect", str(scratch), "--rig", rig]
    result = subprocess.run(command, check=False, capture_output=True, text=True)
    seconds = time.perf_counter() - began
    usage = resource.getrusage(resource.RUSAGE_CHILDREN)
    print("\n".join(result.stdout.splitlines()[-40:]), result.stderr[-2000:])
    print(f"{scratch.stat().st_size / 1e9:.1f} GB, exit code {result.returncode}: {seconds:.1f} s ", end="")
    cpu = usage.ru_utime + usage.ru_stime
    print(f"({cpu:.1f} s of processor time), {usage.ru_maxrss / 2**20:.2f} GiB at most")


if __name__ == "__main__":
    tyro.cli(main)
