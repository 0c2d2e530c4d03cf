"""`offpiste live`."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import tyro

from offpiste.cli.entry import COMMANDS
from offpiste.cli.robot_options import RUN, RobotOptions
from offpiste.core.conventions import PERCEPTION_LATENCY

if TYPE_CHECKING:
    from offpiste.transport.interface import RobotSettings


@COMMANDS.register("live")
@dataclass(frozen=True)
class Live:
    """Drive a vehicle that runs ROS 2; without --drive only compute commands (needs the extra `live`)."""

    rig: Annotated[tyro.conf.Positional[str], tyro.conf.arg(metavar="RIG")]
    """Rig of the vehicle with [outputs]: a .toml file or the name of a preset."""
    run_folder: Annotated[str, tyro.conf.arg(name="run", metavar="RUN")] = RUN
    """Folder written by `train`, or `pretrained:NAME`."""
    pca: Path | None = None
    """PCA file of the run's dataset, for models with visual features; pretrained models have their own."""
    course: Path | None = None
    """Course as a table (.csv) with columns x, y (in the frame of the poses) or lat, lon, and optionally speed."""
    course_topic: str = ""
    """Course as a topic of nav_msgs/Path; a new message replaces it."""
    goal: tuple[float, float] | None = None
    """Course as a straight line to x, y [m]."""
    speed: float = 3.0
    """Target speed if the course has none [m/s]."""
    drive: bool = False
    """Send the commands to the vehicle. Without it (shadow mode) nothing is sent."""
    latency: float = PERCEPTION_LATENCY
    """Time from the data of a plan to its first control [s]."""
    risk: str = "none"
    """Treatment of uncertainty in plans: none, spread:TIMES or cvar:SHARE. The latter need a spread: of a pretrained
    model, or by `offpiste calibrate`."""
    clock: Literal["system", "clock", "stamps"] = "system"
    """Reference of stamps: the clock of this computer, /clock, or the newest stamp of the vehicle."""
    novelty: Literal["ignored", "missing"] = "ignored"
    """Treatment of ground unlike any in training; missing hides its features from the model, and needs a memory bank:
    that of a pretrained model, or by `offpiste calibrate`."""
    device: str = "cpu"
    """Device for encoding images and planning: cpu, or cuda (needs the extra `cuda`)."""
    seed: int = 0
    """Seed of the sampled controls."""
    seconds: float = float("inf")
    """Duration of the drive [s]."""
    lockstep: bool = False
    """Compute a command for every 0.02 s on /clock in one process, however long it takes (with `play --lockstep`)."""
    replay: Path | None = None
    """Log whose messages replace the robot."""
    commands: Path | None = None
    """Table (.csv) of all commands of --lockstep or --replay."""
    record: Path | None = None
    """Log (.mcap) of all topics of the rig and all sent messages."""
    record_free: float = 2.0
    """Free disk space below which recording stops but driving continues [GB]."""
    record_size: float = float("inf")
    """Size at which recording continues in a new, numbered file [GB]."""
    record_seconds: float = float("inf")
    """Duration after which recording continues in a new, numbered file [s]."""
    status: Path | None = None
    """Table (.csv) of the status of all processes, twice a second."""
    view: str = ""
    """Viewer of the drive: foxglove or rerun (needs the extra `view`)."""
    view_at: str = ""
    """HOST:PORT at which the viewer listens, by default on the loopback; for rerun also a file to write (.rrd)."""
    robot: Annotated[RobotOptions, tyro.conf.OmitArgPrefixes] = field(default_factory=RobotOptions)

    def run(self) -> int:
        """Drive over zenoh."""
        return self.run_on(self.robot.settings())

    def run_on(self, robot: "RobotSettings") -> int:
        """Drive over another transport, without the options of `robot`."""
        from offpiste.core.errors import LiveError
        from offpiste.live.commands import run_live
        from offpiste.live.reception import CourseRequest
        from offpiste.live.session import LiveSettings, RecordSettings, ViewSettings
        from offpiste.planning.caution import risk_of
        from offpiste.runtime.settings import RuntimeSettings

        if self.view_at and not self.view:
            raise LiveError(f"{self.view_at} would show nothing", where="--view-at", how="give --view, too")
        of_records = (self.record_free, self.record_size, self.record_seconds)
        if self.record is None and of_records != (Live.record_free, Live.record_size, Live.record_seconds):
            raise LiveError("nothing is recorded", where="--record-free, -size and -seconds", how="give --record, too")
        run_live(
            LiveSettings(
                self.rig,
                self.run_folder,
                self.pca,
                CourseRequest(self.course, self.course_topic, self.goal, self.speed),
                RuntimeSettings(latency=self.latency, risk=risk_of(self.risk), device=self.device),
                robot,
                drive=self.drive,
                clock=self.clock,
                seed=self.seed,
                seconds=self.seconds,
                record=None if self.record is None else RecordSettings(self.record, *of_records),
                status=self.status,
                view=ViewSettings(self.view, self.view_at) if self.view else None,
                novelty=self.novelty,
            ),
            lockstep=self.lockstep,
            replay=self.replay,
            commands=self.commands,
        )
        return 0
