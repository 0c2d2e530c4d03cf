"""`offpiste demo`."""

from dataclasses import dataclass
from pathlib import Path

from offpiste.cli.entry import COMMANDS


@COMMANDS.register("demo")
@dataclass(frozen=True)
class Demo:
    """Drive with pretrained models in a new world, in a minute or two (needs the extra `sim`)."""

    out: Path = Path("demo")
    """Folder of all results."""
    seed: int = 0
    """Seed of the world."""

    def run(self) -> int:
        """Run the demonstration."""
        from offpiste.demo.first_minute import FirstMinuteSettings, run_first_minute

        run_first_minute(self.out, FirstMinuteSettings(self.seed))
        return 0
