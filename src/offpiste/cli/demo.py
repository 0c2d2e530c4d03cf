"""`offpiste demo`."""

from dataclasses import dataclass
from pathlib import Path

from offpiste.cli.entry import COMMANDS


@COMMANDS.register("demo")
@dataclass(frozen=True)
class Demo:
    """Show shipped models at work in a new world, in a minute or two; or train some (needs the extra `sim`)."""

    out: Path = Path("demo")
    """Folder for everything that it makes."""
    seed: int = 0
    """Seed of the world; with --train of the worlds, the drives and the training."""
    train: bool = False
    """Instead walk the whole path: simulate, inspect, fit-pca, extract, train, evaluate, drive; ten minutes."""
    seconds: float = 60.0
    """For --train: length of each of seven drives [s]."""
    epochs: int = 12
    """For --train: passes over the training windows."""

    def run(self) -> int:
        """Drive, predict, compare; or simulate, train, evaluate, drive."""
        if self.train:
            from offpiste.demo.whole_path import DemoSettings, run_demo

            run_demo(self.out, DemoSettings(self.seconds, self.epochs, self.seed))
        else:
            from offpiste.demo.first_minute import FirstMinuteSettings, run_first_minute

            run_first_minute(self.out, FirstMinuteSettings(self.seed))
        return 0
