"""Registry of subcommands: a file in this package, or an extension, adds one by registering a dataclass."""

from collections.abc import Callable
from typing import Final, Protocol

from offpiste.registry import Registry


class Command(Protocol):
    """A dataclass whose fields are the arguments; tyro makes the help of its docstrings."""

    def run(self) -> int:
        """Do it; the exit code: 0 done, 1 the input is unfit."""


COMMANDS: Final[Registry[Callable[..., Command]]] = Registry("command", package=__package__)

PIPELINE: Final = (
    "demo",
    "simulate",
    "inspect",
    "view",
    "fit-pca",
    "extract",
    "train",
    "evaluate",
    "reproduce",
    "drive",
)
"""Order of the commands in the help: as a log goes through them. Others follow."""


def commands_in_order() -> dict[str, Callable[..., Command]]:
    """All commands by name, those of `PIPELINE` first."""
    order = {name: number for number, name in enumerate(PIPELINE)}
    return dict(sorted(COMMANDS.items(), key=lambda named: order.get(named[0], len(order))))
