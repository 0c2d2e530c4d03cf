"""`offpiste warm-up`."""

from dataclasses import dataclass

from offpiste.cli.entry import COMMANDS
from offpiste.cli.next_steps import next_line


@COMMANDS.register("warm-up")
@dataclass(frozen=True)
class WarmUp:
    """Compile all kernels in advance, which takes about a minute after an installation."""

    def run(self) -> int:
        """Compile all kernels."""
        from offpiste.core.progress import show
        from offpiste.demo.warm_up import warm_up_all

        warm_up_all()
        show(next_line("demo"))
        return 0
