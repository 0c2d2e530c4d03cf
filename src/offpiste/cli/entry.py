"""From arguments to a command, and from its outcome to an exit code."""

import os
import sys
from collections.abc import Callable
from typing import Any

import tyro

from offpiste.cli.datasets import Extract, FitPca
from offpiste.cli.experiments import Demo, Drive, Reproduce
from offpiste.cli.logs import Inspect, Simulate, View
from offpiste.cli.models import Evaluate, Train
from offpiste.errors import OffpisteError
from offpiste.progress import log_to_terminal

COMMANDS: dict[str, Callable[..., Any]] = {
    "demo": Demo,
    "simulate": Simulate,
    "inspect": Inspect,
    "fit-pca": FitPca,
    "view": View,
    "extract": Extract,
    "train": Train,
    "evaluate": Evaluate,
    "reproduce": Reproduce,
    "drive": Drive,
}


def main(arguments: list[str] | None = None) -> None:
    """Run one command: exit 0 when done, 1 when the input or the run failed (one line on stderr), 2 on wrong usage."""
    arguments = list(sys.argv[1:] if arguments is None else arguments)
    debug = "--debug" in arguments
    arguments = [a for a in arguments if a != "--debug"]
    try:
        command = tyro.extras.subcommand_cli_from_dict(
            COMMANDS,
            prog="offpiste",
            description="Learns how an off-road vehicle will move on the ground ahead. --debug shows tracebacks.",
            args=arguments,
            config=(tyro.conf.FlagCreatePairsOff,),
        )
        log_to_terminal()
        sys.exit(command.run())
    except OffpisteError as error:
        if debug:
            raise
        print(f"offpiste: {error}", file=sys.stderr)  # noqa: T201
        sys.exit(1)
    except KeyboardInterrupt:
        print("offpiste: interrupted; what was finished is kept", file=sys.stderr)  # noqa: T201
        sys.exit(1)
    except BrokenPipeError:
        # Whoever read what was printed has stopped, e.g. `head`; Python would complain when it flushes at its end.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        sys.exit(1)
