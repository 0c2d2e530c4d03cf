"""A command as a line to paste, from its settings: the same one again with some of them changed."""

from dataclasses import MISSING, fields
from shlex import join
from typing import Any


def command_line(command: str, settings: Any, *positional: str, **changes: object) -> str:
    """The command line that gives these settings, with those changed that are named; defaults are left out.

    Args:
        settings: a command's dataclass, without settings of settings.
        positional: its fields that stand without their name, in their order.
    """
    words, options = ["offpiste", command], []
    for one in fields(settings):
        value = changes.get(one.name, getattr(settings, one.name))
        default = one.default if one.default_factory is MISSING else one.default_factory()
        if one.name in positional:
            words += _texts(value)
        elif value != default or one.name in changes:
            name = one.name.replace("_", "-")
            options += [f"--no-{name}" if value is False else f"--{name}"]
            options += [] if isinstance(value, bool) else _texts(value)
    return join([*words, *options])


def _texts(value: object) -> list[str]:
    return [str(each) for each in value] if isinstance(value, tuple | list) else [str(value)]
