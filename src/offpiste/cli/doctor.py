"""`offpiste doctor`."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Literal

import tyro

from offpiste.cli.entry import COMMANDS
from offpiste.cli.next_steps import next_line
from offpiste.cli.robot_options import RUN, RobotOptions
from offpiste.core.command_line import options


@COMMANDS.register("doctor")
@dataclass(frozen=True)
class Doctor:
    """Look at a robot before anything moves: what is heard, and what is missing (needs the extra `live`)."""

    rig: Annotated[tyro.conf.Positional[str], tyro.conf.arg(metavar="RIG")]
    """Rig of the vehicle: a .toml file, or a preset's name."""
    run_folder: Annotated[str, tyro.conf.arg(name="run", metavar="RUN")] = RUN
    """The run that is to drive, as for `live`: does the robot measure what it reads?"""
    pca: Path | None = None
    """PCA of that run, as for `live`."""
    seconds: float = 3.0
    """How long the robot is listened to [s]."""
    clock: Literal["system", "clock", "stamps"] = "system"
    """As for `live`: stamps have to fit this computer's clock only with `system`."""
    robot: Annotated[RobotOptions, tyro.conf.OmitArgPrefixes] = field(default_factory=RobotOptions)

    def run(self) -> int:
        """Look, say, and exit with 1 if something is wrong."""
        from offpiste.core.progress import show
        from offpiste.live.doctor import examined

        wrong = 0
        robot = self.robot.settings()
        for level, what in examined(self.rig, self.run_folder, self.pca, robot, self.seconds, self.clock):
            show(f"{level}: {what}")
            wrong += level == "error"
        run = ["--run", self.run_folder] if self.run_folder != RUN else []
        words = [self.rig, *run, *options(self, "rig", "run_folder", "seconds", "robot"), *options(self.robot)]
        if wrong:
            show(next_line("doctor", *words, first=["correct what the errors say"]))
        else:
            show(next_line("live", *words, "--goal", "50", "0", "--speed", "3"))
        return 1 if wrong else 0
