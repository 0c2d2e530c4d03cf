"""`offpiste live`, `offpiste play` and `offpiste doctor`, and the connection to a robot."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Final, Literal

import tyro

from offpiste.cli.entry import COMMANDS
from offpiste.cli.next_steps import next_line
from offpiste.core.command_line import options
from offpiste.core.conventions import PERCEPTION_LATENCY
from offpiste.core.errors import LiveError
from offpiste.core.progress import show

if TYPE_CHECKING:
    from offpiste.transport.zenoh_transport import ZenohSettings


RUN: Final = "pretrained:proving-ground/b"
"""Default run of `live` and `doctor`."""


@dataclass(frozen=True)
class RobotOptions:
    """Connection to the robot over zenoh."""

    endpoint: str = ""
    """Address of the zenoh router; by default tcp/127.0.0.1:7447, the address of rmw_zenohd."""
    router: bool = False
    """Act as the router if no rmw_zenohd runs."""
    keys: Literal["rmw_zenoh", "bridge"] = "rmw_zenoh"
    """Key format: rmw_zenoh, or that of zenoh-bridge-ros2dds for robots on Fast DDS or Cyclone DDS."""
    domain: int = 0
    """ROS_DOMAIN_ID of rmw_zenoh."""
    namespace: str = ""
    """Namespace of the bridge."""
    zenoh_config: Path | None = None
    """Configuration file of zenoh, e.g. with TLS certificates."""

    def settings(self) -> "ZenohSettings":
        """Return the settings of the transport."""
        from offpiste.transport.zenoh_transport import ZenohSettings

        return ZenohSettings(
            endpoint=self.endpoint,
            mode="router" if self.router else "client",
            keys=self.keys,
            domain=self.domain,
            namespace=self.namespace,
            config=str(self.zenoh_config or ""),
        )


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
    replay: Path | None = None
    """Log whose messages replace the robot."""
    commands: Path | None = None
    """Table (.csv) of all commands of --replay."""
    record: Path | None = None
    """Log (.mcap) of all topics of the rig and all sent messages."""
    record_free: float = 2.0
    """Free disk space below which recording stops but driving continues [GB]."""
    record_size: float = float("inf")
    """Size at which recording continues in a new, numbered file [GB]."""
    record_seconds: float = float("inf")
    """Duration after which recording continues in a new, numbered file [s]."""
    view: str = ""
    """Viewer of the drive: foxglove or rerun (needs the extra `view`)."""
    view_at: str = ""
    """HOST:PORT at which the viewer listens, by default on the loopback; for rerun also a file to write (.rrd)."""
    robot: Annotated[RobotOptions, tyro.conf.OmitArgPrefixes] = field(default_factory=RobotOptions)

    def run(self) -> int:
        """Drive, or replay a log."""
        from offpiste.live.commands import run_live
        from offpiste.live.reception import CourseRequest
        from offpiste.live.session import LiveSettings, RecordSettings
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
                self.robot.settings(),
                drive=self.drive,
                clock=self.clock,
                seed=self.seed,
                seconds=self.seconds,
                record=None if self.record is None else RecordSettings(self.record, *of_records),
                view=self.view,
                view_at=self.view_at,
                novelty=self.novelty,
            ),
            replay=self.replay,
            commands=self.commands,
        )
        return 0


@COMMANDS.register("play")
@dataclass(frozen=True)
class Play:
    """Play a ROS 2 log to `offpiste live`, or to any ROS 2 system over zenoh (needs the extra `live`)."""

    log: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="LOG")]
    """An .mcap or .db3 file, or the folder of a bag."""
    rig: str = ""
    """Rig of the vehicle: only its topics are played, and each cloud after its last point; without it all topics."""
    rate: float = 1.0
    """Factor of the playback speed."""
    seconds: float = float("inf")
    """Duration to play [s]."""
    without: tuple[str, ...] = ()
    """Topics to skip, e.g. recorded commands; /clock and /offpiste/… are always skipped."""
    robot: Annotated[RobotOptions, tyro.conf.OmitArgPrefixes] = field(default_factory=RobotOptions)

    def run(self) -> int:
        """Play the log."""
        from offpiste.live.play import play_log

        play_log(self.log, self.rig, self.robot.settings(), self.rate, self.seconds, without=self.without)
        return 0


@COMMANDS.register("doctor")
@dataclass(frozen=True)
class Doctor:
    """Check a robot before it moves: which messages arrive, and what is missing (needs the extra `live`)."""

    rig: Annotated[tyro.conf.Positional[str], tyro.conf.arg(metavar="RIG")]
    """Rig of the vehicle: a .toml file or the name of a preset."""
    run_folder: Annotated[str, tyro.conf.arg(name="run", metavar="RUN")] = RUN
    """Run for `live`, whose inputs the robot must measure."""
    pca: Path | None = None
    """PCA of the run, as in `live`."""
    seconds: float = 3.0
    """Duration of the check [s]."""
    clock: Literal["system", "clock", "stamps"] = "system"
    """Reference of stamps, as in `live`; with `system`, stamps must fit the clock of this computer."""
    robot: Annotated[RobotOptions, tyro.conf.OmitArgPrefixes] = field(default_factory=RobotOptions)

    def run(self) -> int:
        """Show all findings; exit with 1 if one is an error."""
        from offpiste.live.doctor import examined

        wrong = 0
        robot = self.robot.settings()
        for level, what in examined(self.rig, self.run_folder, self.pca, robot, self.seconds, self.clock):
            show(f"{level}: {what}")
            wrong += level == "error"
        run = ["--run", self.run_folder] if self.run_folder != RUN else []
        words = [self.rig, *run, *options(self, "rig", "run_folder", "seconds", "robot"), *options(self.robot)]
        if wrong:
            show(next_line("doctor", *words, first=["correct the errors above"]))
        else:
            show(next_line("live", *words, "--goal", "50", "0", "--speed", "3"))
        return 1 if wrong else 0
