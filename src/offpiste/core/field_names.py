"""Suggestions for misspelled keys and values in files that msgspec checks."""

import re
from collections.abc import Iterator

import msgspec
from msgspec import inspect

from offpiste.core.errors import did_you_mean

_MISSPELLED = re.compile(r"unknown field `([^`]+)`|Invalid enum value '([^']+)'")
_PATH = re.compile(r" - at `\$\.?(.*)`")
_STEP = re.compile(r"\[\.\.\.\]|[^.\[]+")


def suggestion(error: msgspec.ValidationError, kind: type) -> str:
    """Suggest a key or value of similar spelling (`did_you_mean`) for an error of a conversion to `kind`."""
    misspelled, path = _MISSPELLED.search(str(error)), _PATH.search(str(error))
    if misspelled is None:
        return ""
    here = [inspect.type_info(kind)]
    for step in _STEP.findall(path[1]) if path else ():
        here = [inner for outer in here for inner in _inside(outer, step)]
    field, value = misspelled.groups()
    return did_you_mean(field or value, (name for each in here for name in _names(each)))


def _inside(kind: inspect.Type, step: str) -> Iterator[inspect.Type]:
    """Yield the types of a field, or of the items if `step` is "[...]"."""
    for one in kind.types if isinstance(kind, inspect.UnionType) else (kind,):
        if isinstance(one, inspect.StructType | inspect.DataclassType):
            yield from (field.type for field in one.fields if field.encode_name == step)
        elif isinstance(one, inspect.DictType):
            yield one.value_type
        elif isinstance(one, inspect.CollectionType):
            yield one.item_type


def _names(kind: inspect.Type) -> Iterator[str]:
    """Yield the field names of a type, or the values of a literal."""
    for one in kind.types if isinstance(kind, inspect.UnionType) else (kind,):
        if isinstance(one, inspect.StructType | inspect.DataclassType):
            yield from (field.encode_name for field in one.fields)
        elif isinstance(one, inspect.LiteralType):
            yield from map(str, one.values)
