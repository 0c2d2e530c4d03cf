"""`offpiste demo`."""

from dataclasses import dataclass
from pathlib import Path

from offpiste.cli.entry import COMMANDS


@COMMANDS.register("demo")
@dataclass(frozen=True)
class Demo:
    """Show shipped models in a new world, in a minute or two; or train new ones (needs the extra `sim`)."""

    out: Path = Path("demo")
    """Folder for all results."""
    seed: int = 0
    """Seed of the world; with --train, of worlds, drives and training."""
    train: bool = False
    """Run the whole path instead: simulate, inspect, fit-pca, extract, train, evaluate, drive; ten minutes."""
    seconds: float = 60.0
    """With --train: length of each of the seven drives [s]."""
    epochs: int = 12
    """With --train: passes over the training windows."""

    def run(self) -> int:
        """Drive, predict, compare; or simulate, train, evaluate, drive."""
        if self.train:
            from offpiste.demo.whole_path import DemoSettings, run_demo

            run_demo(self.out, DemoSettings(self.seconds, self.epochs, self.seed))
        else:
            from offpiste.demo.first_minute import FirstMinuteSettings, run_first_minute

            run_first_minute(self.out, FirstMinuteSettings(self.seed))
        return 0
