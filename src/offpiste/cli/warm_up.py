"""`offpiste warm-up`."""

from dataclasses import dataclass

from offpiste.cli.entry import COMMANDS


@COMMANDS.register("warm-up")
@dataclass(frozen=True)
class WarmUp:
    """Compile all kernels ahead, about a minute after an installation; what is compiled already is only loaded."""

    def run(self) -> int:
        """Compile, part by part."""
        from offpiste.demo.warm_up import warm_up_all

        warm_up_all()
        return 0
