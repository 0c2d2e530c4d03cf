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
    """Drive a vehicle that runs ROS 2, or watch what would be commanded: the default (needs the extra `live`)."""

    rig: Annotated[tyro.conf.Positional[str], tyro.conf.arg(metavar="RIG")]
    """Rig of the vehicle, with [outputs]: a .toml file, or a preset's name."""
    run_folder: Annotated[str, tyro.conf.arg(name="run", metavar="RUN")] = RUN
    """A folder that `train` wrote, or `pretrained:NAME`."""
    pca: Path | None = None
    """For runs with visual features: the file that their dataset was extracted with; shipped models have theirs."""
    course: Path | None = None
    """Course: a table (.csv) with the columns x, y, in the frame of the poses, or lat, lon; and speed, if need be."""
    course_topic: str = ""
    """Course: a topic with a nav_msgs/Path; another one replaces it."""
    goal: tuple[float, float] | None = None
    """Course: straight to x, y [m]."""
    speed: float = 3.0
    """Wanted where the course gives none [m/s]."""
    drive: bool = False
    """Send the commands to the vehicle. Without it, shadow mode: nothing is sent to it."""
    latency: float = PERCEPTION_LATENCY
    """From the data of a plan to its first control [s]."""
    risk: str = "none"
    """What counts in plans beside the prediction: none, spread:TIMES or cvar:SHARE, which need a spread (models that
    ship have one, others by `offpiste calibrate`)."""
    clock: Literal["system", "clock", "stamps"] = "system"
    """What stamps are compared with: this computer's clock, /clock, or the newest stamp of the vehicle's readings."""
    novelty: Literal["ignored", "missing"] = "ignored"
    """What novel ground, unlike any in training, is to the model; missing needs features of training's (shipped with
    models that see the ground, for others by `offpiste calibrate`)."""
    device: str = "cpu"
    """Device on which images are encoded and plans are made: cpu, or cuda (needs the extra `cuda`)."""
    seed: int = 0
    """Seed of the sampled controls."""
    seconds: float = float("inf")
    """End after this time."""
    lockstep: bool = False
    """A command for every 0.02 s on /clock, however long it takes, in one process: for tests and `play --lockstep`."""
    replay: Path | None = None
    """Take the messages from a log instead, without a robot: what would have been commanded."""
    commands: Path | None = None
    """Write each command to this table (.csv), of --lockstep and --replay."""
    record: Path | None = None
    """Record all that the rig names, and what is sent, as a log (.mcap)."""
    record_free: float = 2.0
    """Stop recording, but not driving, where less space is free on the disk [GB]."""
    record_size: float = float("inf")
    """Begin a new, numbered file where one has become larger [GB]."""
    record_seconds: float = float("inf")
    """Begin a new, numbered file where one has become longer [s]."""
    status: Path | None = None
    """Write how all processes are, twice a second, to this table (.csv)."""
    view: str = ""
    """Show the drive: in foxglove or rerun (needs the extra `view`)."""
    view_at: str = ""
    """Where the viewer listens, HOST:PORT; on the loopback unless given. For rerun also a file to write (.rrd)."""
    robot: Annotated[RobotOptions, tyro.conf.OmitArgPrefixes] = field(default_factory=RobotOptions)

    def run(self) -> int:
        """Load, connect, drive."""
        return self.run_on(self.robot.settings())

    def run_on(self, robot: "RobotSettings") -> int:
        """The same over another transport, without the options of `robot`."""
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
