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
    """Play a ROS 2 log to `offpiste live`, or to anything that runs ROS 2 over zenoh (needs the extra `live`)."""

    log: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="LOG")]
    """An .mcap or .db3, or the folder of a bag."""
    rig: str = ""
    """Rig of the vehicle: only its topics are played, and clouds once their last point was measured; else all."""
    rate: float = 1.0
    """Times as fast as it was recorded."""
    seconds: float = float("inf")
    """How much of it is played."""
    lockstep: bool = False
    """Step by step: wait for the command of `offpiste live --lockstep` after each."""
    without: tuple[str, ...] = ()
    """Topics that are left out, e.g. the recorded commands; /clock and /offpiste/… always are."""
    robot: Annotated[RobotOptions, tyro.conf.OmitArgPrefixes] = field(default_factory=RobotOptions)

    def run(self) -> int:
        """Open, connect, play."""
        from offpiste.live.commands import play_log

        settings = self.robot.settings(patient=self.lockstep)
        play_log(self.log, self.rig, settings, self.rate, self.seconds, lockstep=self.lockstep, without=self.without)
        return 0
