"""From arguments to a command, and from its outcome to an exit code."""

import os
import sys

import tyro

from offpiste.cli.commands import commands_in_order
from offpiste.errors import OffpisteError
from offpiste.progress import log_to_terminal


def main(arguments: list[str] | None = None) -> None:
    """Run one command: exit 0 when done, 1 when the input or the run failed (one line on stderr), 2 on wrong usage."""
    arguments = list(sys.argv[1:] if arguments is None else arguments)
    debug = "--debug" in arguments
    arguments = [a for a in arguments if a != "--debug"]
    try:
        command = tyro.extras.subcommand_cli_from_dict(
            commands_in_order(),
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
        # The reader of a pipe has closed it, e.g. `head`; Python would complain when it flushes at exit.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        sys.exit(1)
