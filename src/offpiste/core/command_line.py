"""Options of a command line that reproduce given settings, with changes."""

from dataclasses import MISSING, fields, is_dataclass
from typing import Any


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
            values = value if isinstance(value, tuple | list) else (value,)
            words += [] if isinstance(value, bool) else [str(each) for each in values]
    return words
