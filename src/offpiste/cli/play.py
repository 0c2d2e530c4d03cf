"""`offpiste play`."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

import tyro

from offpiste.cli.entry import COMMANDS
from offpiste.cli.robot_options import RobotOptions


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
    lockstep: bool = False
    """Wait for the command of `offpiste live --lockstep` after each step."""
    without: tuple[str, ...] = ()
    """Topics to skip, e.g. recorded commands; /clock and /offpiste/… are always skipped."""
    robot: Annotated[RobotOptions, tyro.conf.OmitArgPrefixes] = field(default_factory=RobotOptions)

    def run(self) -> int:
        """Play the log."""
        from offpiste.live.commands import play_log

        settings = self.robot.settings(patient=self.lockstep)
        play_log(self.log, self.rig, settings, self.rate, self.seconds, lockstep=self.lockstep, without=self.without)
        return 0
