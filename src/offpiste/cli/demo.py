"""`offpiste demo`."""

from dataclasses import dataclass
from pathlib import Path

from offpiste.cli.entry import COMMANDS


@COMMANDS.register("demo")
@dataclass(frozen=True)
class Demo:
    """Run the whole path on simulated drives, from `simulate` to `evaluate` and `drive` (needs the extra `sim`)."""

    out: Path = Path("demo")
    """Folder for everything that it makes."""
    seconds: float = 60.0
    """Length of each of seven drives [s]."""
    epochs: int = 12
    """Passes over the training windows."""
    seed: int = 0
    """Seed of the worlds, the drives and the training."""

    def run(self) -> int:
        """Simulate, inspect, fit the PCA, extract, train, evaluate, drive."""
        from offpiste.demo import DemoSettings, run_demo

        run_demo(self.out, DemoSettings(self.seconds, self.epochs, self.seed))
        return 0
