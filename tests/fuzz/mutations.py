"""Mutations of bytes, text and arrays as pure functions of input and generator."""

import re
from collections.abc import Callable
from typing import Final

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


def flip_bits(data: bytes, rng: Generator) -> bytes:
    changed = bytearray(data)
    for place in rng.integers(max(len(data), 1), size=int(rng.integers(1, 9))) if data else ():
        changed[place] ^= 1 << int(rng.integers(8))
    return bytes(changed)


def random_bytes(data: bytes, rng: Generator) -> bytes:
    part = _place(len(data), rng, 64)
    return data[: part.start] + rng.bytes(part.stop - part.start) + data[part.stop :]


def truncate(data: bytes, rng: Generator) -> bytes:
    return data[: int(rng.integers(len(data) + 1))] if rng.random() < 0.7 else data[: -int(rng.integers(1, 40))]


def zero_block(data: bytes, rng: Generator) -> bytes:
    part = _place(len(data), rng)
    return data[: part.start] + bytes(part.stop - part.start) + data[part.stop :]


def repeat_block(data: bytes, rng: Generator) -> bytes:
    part = _place(len(data), rng)
    return data[: part.stop] + data[part] + data[part.stop :]


def drop_block(data: bytes, rng: Generator) -> bytes:
    part = _place(len(data), rng)
    return data[: part.start] + data[part.stop :]


def swap_blocks(data: bytes, rng: Generator) -> bytes:
    length = min(1 + int(np.exp(rng.uniform(0, 8))), len(data) // 2)
    if not length:
        return data
    first, second = sorted(int(b) for b in rng.integers(len(data) - length + 1, size=2))
    second = max(second, first + length)
    a, b = data[first : first + length], data[second : second + length]
    return data[:first] + b + data[first + length : second] + a + data[second + length :]


def extreme_integer(data: bytes, rng: Generator) -> bytes:
    size = int(rng.choice((2, 4, 8)))
    value = INTEGERS[int(rng.integers(len(INTEGERS)))] & ((1 << (8 * size)) - 1)
    at = int(rng.integers(max(len(data) - size, 1)))
    return data[:at] + value.to_bytes(size, "little") + data[at + size :]


def emptied(data: bytes, rng: Generator) -> bytes:
    return b""


def appended(data: bytes, rng: Generator) -> bytes:
    return data + rng.bytes(int(rng.integers(1, 200)))


BYTES: Final[tuple[Bytes, ...]] = (
    flip_bits, flip_bits, random_bytes, truncate, zero_block, repeat_block, drop_block, swap_blocks, extreme_integer,
    extreme_integer, emptied, appended,
)  # fmt: skip

_NUMBER = re.compile(r"(?<![\w.])[-+]?\d+(?:\.\d+)?(?:[eE][-+]?\d+)?(?![\w.])")
_WORD = re.compile(r"[A-Za-z_/][\w/.:-]*")


def _replaced(text: str, pattern: re.Pattern[str], new: tuple[str, ...], rng: Generator) -> str:
    found = list(pattern.finditer(text))
    if not found:
        return text + new[int(rng.integers(len(new)))]
    many = int(rng.choice((1, 1, 1, 2, 10)))
    chosen = sorted({int(n) for n in rng.integers(len(found), size=many)}, reverse=True)
    for number in chosen:
        match = found[number]
        text = text[: match.start()] + new[int(rng.integers(len(new)))] + text[match.end() :]
    return text


def absurd_number(text: str, rng: Generator) -> str:
    return _replaced(text, _NUMBER, NUMBERS, rng)


def absurd_word(text: str, rng: Generator) -> str:
    return _replaced(text, _WORD, WORDS, rng)


def other_word(text: str, rng: Generator) -> str:
    words = tuple(sorted({match.group() for match in _WORD.finditer(text)})) or ("x",)
    return _replaced(text, _WORD, words, rng)


def _lines(text: str, rng: Generator, count: int) -> tuple[list[str], list[int]]:
    lines = text.splitlines(keepends=True) or [""]
    return lines, [int(n) for n in rng.integers(len(lines), size=count)]


def swap_lines(text: str, rng: Generator) -> str:
    lines, (a, b) = _lines(text, rng, 2)
    lines[a], lines[b] = lines[b], lines[a]
    return "".join(lines)


def drop_line(text: str, rng: Generator) -> str:
    lines, (at,) = _lines(text, rng, 1)
    return "".join(lines[:at] + lines[at + 1 :])


def repeat_line(text: str, rng: Generator) -> str:
    lines, (at,) = _lines(text, rng, 1)
    return "".join([*lines[: at + 1], "\n", *lines[at:]])


def nested(text: str, rng: Generator) -> str:
    at = int(rng.integers(len(text) + 1))
    return text[:at] + str(rng.choice(("[", "{", '{"a":', "[[x."))) * 20_000 + text[at:]


def another_encoding(text: str, rng: Generator) -> str:
    at = int(rng.integers(len(text) + 1))
    return text[:at] + "\udcff\udcfe" + text[at:]


TEXT: Final[tuple[Text, ...]] = (
    absurd_number, absurd_number, absurd_number, absurd_number, absurd_word, other_word, other_word, swap_lines,
    drop_line, drop_line, repeat_line, nested, another_encoding,
)  # fmt: skip


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
    part = (
        slice(None)
        if rng.random() < 0.2
        else _place(len(rows), rng, max(2, len(rows)))
        if rng.random() < 0.6
        else slice(at := int(rng.integers(len(rows))), at + 1)
    )
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
