"""Command line of a study: messages on the terminal, and errors that a user can cause in one line."""

import logging
import sys
from collections.abc import Callable
from typing import Any

import tyro

from offpiste.core.errors import OffpisteError
from offpiste.core.progress import log_to_terminal, show


def run(command: Callable[..., Any], arguments: list[str] | None = None) -> None:
    """Run `command` with arguments of the command line, and its method `run` if it has one; print a text it returns.

    Exits with 1 when the input or the run failed, with 130 when interrupted, each with one line on standard error.
    """
    log_to_terminal()
    logger = logging.getLogger("experiments")
    logger.setLevel(logging.INFO)
    logger.handlers = logging.getLogger("offpiste").handlers
    spec = sys.modules["__main__"].__spec__
    prog = f"python -m {spec.name.removesuffix('.__main__')}" if spec else None
    try:
        result = tyro.cli(command, args=arguments, prog=prog)
        if hasattr(result, "run"):
            result = result.run()
        if isinstance(result, str):
            show(result)
    except OffpisteError as error:
        sys.exit(str(error))
    except KeyboardInterrupt:
        print("interrupted; what was finished is kept", file=sys.stderr)  # noqa: T201
        sys.exit(130)
