"""Edits of a rig by the paths of its entries."""

import math
import re
from collections.abc import MutableMapping, Sequence
from dataclasses import dataclass
from typing import Any

import msgspec
import tomlkit
from tomlkit.exceptions import TOMLKitError
from tomlkit.items import InlineTable, Item, Table, Whitespace

from offpiste.core.errors import RigError
from offpiste.rig.channels import ChannelSource
from offpiste.rig.rig import Rig, check_rig, parse_rig
from offpiste.rig.schema import converted


@dataclass(frozen=True)
class Edit:
    """Setting or removal of an entry of a rig."""

    key: str  # path of the entry, e.g. "channels.steer.sign"
    value: Any  # TOML value; None removes the entry

    def __hash__(self) -> int:
        """Hash the text, since values may be lists."""
        return hash(str(self))

    def __str__(self) -> str:
        """Return the edit as text: `channels.steer.sign = -1`, `remove channels.yaw_rate`."""
        return f"remove {self.key}" if self.value is None else f"{self.key} = {toml_value(self.value)}"


def edited(rig: Rig, edits: Sequence[Edit]) -> Rig:
    """Return a rig with some entries set or removed.

    Raises:
        RigError: the edited rig is not valid.
    """
    entries = msgspec.to_builtins(rig)
    for edit in edits:
        *tables, last = edit.key.split(".")
        table = entries
        for name in tables:
            table[name] = dict(table.get(name) or {})
            table = table[name]
        if edit.value is None:
            table.pop(last, None)
        else:
            table[last] = edit.value
    try:
        changed = converted(entries, Rig)
        check_rig(changed)
    except RigError as error:
        raise RigError(error.what, where=rig.name, how=error.how) from None
    return changed


def absent(channel: str, rig: Rig) -> tuple[Edit, ...]:
    """Return the edits that remove a channel and declare it absent."""
    return Edit(f"channels.{channel}", None), Edit("absent", [*rig.absent, channel])


def rescaled(channel: str, source: ChannelSource, factor: float) -> tuple[Edit, ...]:
    """Return the edits that multiply a channel's values by `factor`."""
    scaled = (("scale", source.scale * factor), ("offset", source.offset * factor))
    return tuple(Edit(f"channels.{channel}.{key}", rounded(value)) for key, value in scaled if value)


def rounded(value: float) -> float:
    """Round to four significant digits."""
    return float(f"{value:.4g}")


def edited_text(text: str, edits: Sequence[Edit]) -> str:
    """Return a rig's text with some entries set or removed; other entries, comments and their order are kept."""
    try:
        document = tomlkit.parse(text)
    except TOMLKitError as error:
        raise RigError(f"not valid TOML: {error}", how="fix the line that is named") from error
    for edit in edits:
        *tables, last = edit.key.split(".")
        table: MutableMapping[str, Any] = document
        for name in tables:
            if not isinstance(table.get(name), MutableMapping):
                # Inline tables can only hold inline tables.
                _set(table, name, tomlkit.inline_table() if isinstance(table, InlineTable) else tomlkit.table())
            table = table[name]
        if edit.value is not None:
            _set(table, last, _item(edit.value, inline=len(tables) != 1))
        elif last in table:
            _remove(table, last)
    changed = document.as_string()
    parse_rig(changed, where="the edited rig")
    return changed


def _item(value: Any, *, inline: bool) -> Item:
    """Return a value as a node of a document; dictionaries become tables, inline if asked for."""
    if not isinstance(value, dict):
        return tomlkit.item(list(value) if isinstance(value, tuple) else value)
    table: InlineTable | Table = tomlkit.inline_table() if inline else tomlkit.table()
    for key, entry in value.items():
        table.append(key, _item(entry, inline=True))
    return table


def _set(table: MutableMapping[str, Any], key: str, item: Item) -> None:
    """Set an entry; a new one precedes the blank lines and comments above the next table."""
    if key in table or not isinstance(table, Table):
        table[key] = item
        return
    end = _end(table)
    tail = _without_tail(end)
    if isinstance(item, Table):
        end.append((None, Whitespace("\n")))
    table.append(key, item)
    (item if isinstance(item, Table) else table).value.body.extend(tail)


def _remove(table: MutableMapping[str, Any], key: str) -> None:
    """Remove an entry; keep the comments after a table, which belong to the next one."""
    body = table.value.body if isinstance(table, Table) else getattr(table, "body", [])
    number = next((n for n, (name, _) in enumerate(body) if name is not None and name.key == key), 0)
    before = [item for _, item in body[:number] if isinstance(item, Table)]
    if isinstance(table[key], Table) and before:
        _end(before[-1]).extend(_without_tail(_end(table[key])))
    del table[key]


def _end(table: Table) -> list[tuple[Any, Item]]:
    """Return the body at the end of a table: its own, or that of the last table in it."""
    inner = [child for _, child in table.value.body if isinstance(child, Table)]
    return _end(inner[-1]) if inner else table.value.body


def _without_tail(body: list[tuple[Any, Item]]) -> list[tuple[Any, Item]]:
    """Remove and return everything from the first blank line after a table's entries."""
    entries = max((number for number, (key, _) in enumerate(body, start=1) if key is not None), default=0)
    blank = (number for number in range(entries, len(body)) if isinstance(body[number][1], Whitespace))
    first = next(blank, len(body))
    tail, body[first:] = body[first:], []
    return tail


def toml_value(value: Any) -> str:
    """Format a text, number, boolean, list or inline table as TOML."""
    if isinstance(value, dict):
        return "{ " + ", ".join(f"{toml_key(key)} = {toml_value(entry)}" for key, entry in value.items()) + " }"
    if isinstance(value, list | tuple):
        return "[" + ", ".join(toml_value(entry) for entry in value) + "]"
    if isinstance(value, float) and not math.isfinite(value):
        return str(value)  # inf and nan, which JSON lacks
    return msgspec.json.encode(value, enc_hook=lambda number: number.item()).decode()  # of NumPy


def toml_key(key: str) -> str:
    """Format a key as TOML, quoted if necessary."""
    return key if re.fullmatch("[A-Za-z0-9_-]+", key) else msgspec.json.encode(key).decode()


def number(value: float) -> str:
    """Format a number as a TOML float of four significant digits."""
    text = f"{value:.4g}"
    return text if any(c in text for c in ".en") else f"{text}.0"
