"""`offpiste inspect` on a long log with a camera and a LiDAR: seconds and peak memory of the command.

`python benchmarks/inspect_log.py DRIVE.mcap [--minutes 60] [--scratch long.mcap]`: writes a log of that length by
repeating a simulated drive (`offpiste simulate --sensors light`), each time with later stamps and with poses that go on
where the last ones ended; then runs the command on it in a process of its own.
"""

import resource
import subprocess
import sys
import time
from operator import itemgetter
from pathlib import Path
from typing import Any

import numpy as np
import tyro
from scipy.spatial.transform import Rotation

from offpiste.logs import open_log
from offpiste.logs.ros.writer import McapWriter, header, make, quaternion, vector

_POSE = "/odometry"


def repeated(drive: Path, out: Path, minutes: float) -> None:
    """Write a drive several times, one after the other."""
    log = open_log(drive)
    found = ((stamp, topic, message) for topic in log.topics for stamp, message in log.messages(topic))
    messages = sorted(found, key=itemgetter(0))
    period = round(1e9 * (messages[-1][0] - messages[0][0])) + 20_000_000
    poses = [_matrix(message.pose.pose) for _, topic, message in messages if topic == _POSE]
    step = poses[-1] @ np.linalg.inv(poses[0])
    step[:3, :3] = Rotation.from_euler("z", np.arctan2(step[1, 0], step[0, 0])).as_matrix()
    step[:3, 3] = poses[-1][:3, 3] - step[:3, :3] @ poses[0][:3, 3]
    with McapWriter(out) as writer:
        for number in range(round(minutes * 60e9 / period)):
            for stamp, topic, message in messages:
                writer.write(topic, message, round(1e9 * stamp) + number * period)
                if hasattr(message, "header"):
                    _delay(message, period)
                if topic == _POSE:
                    message.pose.pose = _pose(step @ _matrix(message.pose.pose))


def _delay(message: Any, shift: int) -> None:
    """Stamp a message later [ns]."""
    stamp = message.header.stamp
    message.header = header(stamp.sec * 10**9 + stamp.nanosec + shift, message.header.frame_id)


def _matrix(pose: Any) -> np.ndarray:
    place, turn, matrix = pose.position, pose.orientation, np.eye(4)
    matrix[:3, :3] = Rotation.from_quat((turn.x, turn.y, turn.z, turn.w)).as_matrix()
    matrix[:3, 3] = place.x, place.y, place.z
    return matrix


def _pose(matrix: np.ndarray) -> Any:
    orientation = quaternion(Rotation.from_matrix(matrix[:3, :3]).as_quat())
    position = vector(matrix[:3, 3], "geometry_msgs/Point")
    return make("geometry_msgs/Pose", position=position, orientation=orientation)


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
