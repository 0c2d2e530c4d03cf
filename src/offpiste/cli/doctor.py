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
            show(next_line("doctor", *words, first=["correct the errors above"]))
        else:
            show(next_line("live", *words, "--goal", "50", "0", "--speed", "3"))
        return 1 if wrong else 0
