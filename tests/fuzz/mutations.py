"""Mutations of bytes, text and arrays as pure functions of input and generator."""

import re
from collections.abc import Callable
from dataclasses import fields, is_dataclass, replace
from typing import Any, Final

import numpy as np

Generator = np.random.Generator
Bytes = Callable[[bytes, Generator], bytes]
Text = Callable[[str, Generator], str]

NUMBERS: Final = (
    "nan", "inf", "-inf", "1e308", "-1e308", "1e-320", "-1", "0", "", "18446744073709551616", "1" + 400 * "0",
    "1e18", "-9223372036854775809", "0x10", "1_000", "true", "null", '"text"', "[]", "{}", "2026-01-01", "1.2.3",
)  # fmt: skip
"""Replacements of numbers in text."""
WORDS: Final = ("", "x", "..", "/", "/etc/passwd", "\u0000", "\U0001f697", "nan", "-1", "a" * 5000, "%s{0}\n", "CON")
"""Replacements of words in text."""
VALUES: Final = (
    np.nan, np.inf, -np.inf, 1e308, -1e308, 1e200, 1e30, -1e18, 1e12, 1e9, -1e6, 1e5, 1e-300, 0.0, -1.0, 65535.0,
)  # fmt: skip
"""Replacements of array values."""
INTEGERS: Final = (0, 1, -1, 0x7FFFFFFF, -0x80000000, 0x7FFFFFFFFFFFFFFF, 0x40000000, 0xFFFF, 0x10000000)


def _place(size: int, rng: Generator, longest: int = 4096) -> slice:
    """A random range, rarely long."""
    begin = int(rng.integers(max(size, 1)))
    return slice(begin, min(size, begin + 1 + int(np.exp(rng.uniform(0, np.log(longest))))))


def flipped(data: bytes, rng: Generator) -> bytes:
    changed = bytearray(data)
    for place in rng.integers(max(len(data), 1), size=int(rng.integers(1, 9))) if data else ():
        changed[place] ^= 1 << int(rng.integers(8))
    return bytes(changed)


def truncated(data: bytes, rng: Generator) -> bytes:
    return data[: int(rng.integers(len(data) + 1))] if rng.random() < 0.7 else data[: -int(rng.integers(1, 40))]


def block(data: bytes, rng: Generator) -> bytes:
    """Randomise, empty, repeat or drop a block, or put another one in its place."""
    part, other = _place(len(data), rng), _place(len(data), rng)
    new = (rng.bytes(min(part.stop - part.start, 64)), bytes(part.stop - part.start), 2 * data[part], b"", data[other])
    return data[: part.start] + new[int(rng.integers(len(new)))] + data[part.stop :]


def extreme_integer(data: bytes, rng: Generator) -> bytes:
    size = int(rng.choice((2, 4, 8)))
    value = INTEGERS[int(rng.integers(len(INTEGERS)))] & ((1 << (8 * size)) - 1)
    at = int(rng.integers(max(len(data) - size, 1)))
    return data[:at] + value.to_bytes(size, "little") + data[at + size :]


def appended(data: bytes, rng: Generator) -> bytes:
    return data + rng.bytes(int(rng.integers(1, 200))) if rng.random() < 0.5 else b""


BYTES: Final[tuple[Bytes, ...]] = (flipped, truncated, block, block, block, extreme_integer, extreme_integer, appended)

_NUMBER = re.compile(r"(?<![\w.])[-+]?\d+(?:\.\d+)?(?:[eE][-+]?\d+)?(?![\w.])")
_WORD = re.compile(r"[A-Za-z_/][\w/.:-]*")


def _replaced(text: str, pattern: re.Pattern[str], new: tuple[str, ...], rng: Generator) -> str:
    found = list(pattern.finditer(text))
    if not found:
        return text + new[int(rng.integers(len(new)))]
    many = int(rng.choice((1, 1, 1, 2, 10)))
    for number in sorted({int(n) for n in rng.integers(len(found), size=many)}, reverse=True):
        match = found[number]
        text = text[: match.start()] + new[int(rng.integers(len(new)))] + text[match.end() :]
    return text


def absurd_number(text: str, rng: Generator) -> str:
    return _replaced(text, _NUMBER, NUMBERS, rng)


def absurd_word(text: str, rng: Generator) -> str:
    words = tuple(sorted({match.group() for match in _WORD.finditer(text)})) or ("x",)
    return _replaced(text, _WORD, words if rng.random() < 0.7 else WORDS, rng)


def line(text: str, rng: Generator) -> str:
    """Drop or repeat a line, or put another one in its place."""
    lines = text.splitlines(keepends=True) or [""]
    at, other = (int(n) for n in rng.integers(len(lines), size=2))
    lines[at : at + 1] = ([], [lines[at], "\n", lines[at]], [lines[other]])[int(rng.integers(3))]
    return "".join(lines)


def inserted(text: str, rng: Generator) -> str:
    """Insert deep nesting or bytes of another encoding."""
    at, new = int(rng.integers(len(text) + 1)), str(rng.choice(("[", "{", '{"a":', "[[x."))) * 20_000
    return text[:at] + (new if rng.random() < 0.5 else "\udcff\udcfe") + text[at:]


TEXT: Final[tuple[Text, ...]] = (*4 * (absurd_number,), *3 * (absurd_word,), *4 * (line,), *2 * (inserted,))


def mutate_bytes(data: bytes, rng: Generator) -> tuple[bytes, str]:
    """Mutate bytes in one way; returns also its name."""
    mutation = BYTES[int(rng.integers(len(BYTES)))]
    return mutation(data, rng), mutation.__name__


def mutate_text(data: bytes, rng: Generator) -> tuple[bytes, str]:
    """Mutate text in one way; returns also its name."""
    mutation = TEXT[int(rng.integers(len(TEXT)))]
    changed = mutation(data.decode("utf-8", "surrogateescape"), rng)
    return changed.encode("utf-8", "surrogateescape"), mutation.__name__


def mutate_values(values: np.ndarray, rng: Generator) -> tuple[np.ndarray, str]:
    """Replace some entries of an array by absurd values of its type; returns also a description."""
    changed = np.array(values, copy=True)
    if not changed.size:
        return changed, "empty"
    rows = changed.reshape(len(changed), -1) if changed.ndim else changed.reshape(1, 1)
    one = int(rng.integers(len(rows)))
    parts = (slice(None), _place(len(rows), rng, max(2, len(rows))), slice(one, one + 1))
    part = parts[int(rng.choice(3, p=(0.2, 0.5, 0.3)))]
    columns = slice(None) if rng.random() < 0.4 else int(rng.integers(rows.shape[1]))
    how = int(rng.integers(10))
    with np.errstate(all="ignore"):
        if how < 7:
            value = VALUES[int(rng.integers(len(VALUES)))]
            if rows.dtype.kind in "iu":
                info = np.iinfo(rows.dtype)
                value = float(np.clip(np.nan_to_num(value), info.min, float(info.max) * (1 - 1e-9)))
            rows[part, columns] = np.asarray(value).astype(rows.dtype)
            said = f"{value:g}"
        elif how == 7:
            factor = float(rng.choice((1e3, 1e6, 1e12, -1.0)))
            rows[part, columns] = (rows[part, columns].astype(np.float64) * factor).astype(rows.dtype)
            said = f"times {factor:g}"
        elif how == 8:
            rows[:] = rows[rng.permutation(len(rows))]
            said = "shuffled"
        else:
            noise = np.exp(rng.uniform(0, 300, rows[part, columns].shape)) * rng.choice((-1, 1))
            rows[part, columns] = noise.astype(rows.dtype)
            said = "noise over all magnitudes"
    return changed, said


_OCTETS = ("is_bigendian", "datatype")
"""Fields of ROS messages with 8 bits."""


def mutate_message(message: Any, rng: Generator) -> tuple[Any, str]:
    """Replace a field of a ROS message, at any depth, by an absurd value of its type; returns also a description."""
    name = str(rng.choice([one.name for one in fields(message) if not one.name.startswith("_")]))
    value = getattr(message, name)
    if isinstance(value, list) and value and is_dataclass(value[0]):
        at = int(rng.integers(len(value)))
        changed, how = mutate_message(value[at], rng)
        changed, how = [*value[:at], changed, *value[at + 1 :]], f"[{at}].{how}"
    elif is_dataclass(value):
        changed, how = mutate_message(value, rng)
        how = f".{how}"
    elif isinstance(value, np.ndarray):
        changed, how = mutate_values(value, rng)
        how = f" {how}"
    else:
        integers = (0, 1, 2, 255, 65_535, 0x7FFFFFFF)[: 4 if name in _OCTETS else None]
        kinds = {str: WORDS, float: VALUES, bool: (False, True), int: integers, list: ([],)}
        values = kinds[type(value)]
        changed = values[int(rng.integers(len(values)))]
        how = f" {str(changed)[:20]!r}"
    return replace(message, **{name: changed}), name + how
