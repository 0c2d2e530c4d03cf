"""`offpiste demo` and `offpiste warm-up`."""

from dataclasses import dataclass
from pathlib import Path

from offpiste.cli.entry import COMMANDS
from offpiste.cli.next_steps import next_line
from offpiste.core.progress import show


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


@COMMANDS.register("warm-up")
@dataclass(frozen=True)
class WarmUp:
    """Compile all kernels in advance, which takes about a minute after an installation."""

    def run(self) -> int:
        """Compile all kernels."""
        from offpiste.demo.warm_up import warm_up_all

        warm_up_all()
        show(next_line("demo"))
        return 0
