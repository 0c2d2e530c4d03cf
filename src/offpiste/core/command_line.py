"""Command lines that reproduce given settings, with changes."""

from dataclasses import MISSING, fields, is_dataclass
from shlex import join
from typing import Any


def command_line(command: str, settings: Any, *positional: str, **changes: object) -> str:
    """Return the command line of settings, with changes and without defaults; `positional` fields have no option."""
    words = [word for one in fields(settings) if one.name in positional
             for word in _texts(changes.get(one.name, getattr(settings, one.name)))]  # fmt: skip
    return join(["offpiste", command, *words, *options(settings, *positional, **changes)])


def options(settings: Any, *without: str, **changes: object) -> list[str]:
    """Return the options of a dataclass, with changes and without defaults and some fields.

    Nested dataclasses give options like `--weights.yaw`.
    """
    words: list[str] = []
    for one in fields(settings):
        if one.name in without:
            continue
        value = changes.get(one.name, getattr(settings, one.name))
        default = one.default if one.default_factory is MISSING else one.default_factory()
        name = one.name.replace("_", "-")
        if is_dataclass(value):
            words += [f"--{name}.{word[2:]}" if word.startswith("--") else word for word in options(value)]
        elif value != default or one.name in changes:
            words += [f"--no-{name}" if value is False else f"--{name}"]
            words += [] if isinstance(value, bool) else _texts(value)
    return words


def _texts(value: object) -> list[str]:
    return [str(each) for each in value] if isinstance(value, tuple | list) else [str(value)]
