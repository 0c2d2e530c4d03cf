"""Splits of rows into training, validation and test: contiguous stretches with gaps, decided at extraction."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int

from offpiste.core.conventions import DT, HISTORY_STEPS, HORIZON_STEPS
from offpiste.core.errors import DatasetError, did_you_mean
from offpiste.core.files import write_text
from offpiste.core.limits import read_small
from offpiste.rig.channels import GEOGRAPHIC
from offpiste.rig.rig import Rig

PARTS = ("train", "validation", "test")  # names of the labels 0, 1, 2; the label -1 belongs to no part

GAP = HISTORY_STEPS + HORIZON_STEPS
"""Rows dropped where the part changes, so that windows of different parts share no row."""


@dataclass(frozen=True)
class Split:
    """Rule that assigns rows to parts."""

    text: str  # as given by the user: "blocks:0.7,0.1,0.2", "fold:2/5", "places:50", "drives:FILE"
    kind: str  # blocks, fold, places or drives
    fractions: tuple[float, ...] = ()  # blocks: of each drive, or of each period of it, in the order of `PARTS`
    period: float = 0.0  # blocks: time after which they repeat [s]; 0: once per drive
    fold: tuple[int, int] = (0, 1)  # fold: number of the fold, from 0, and number of folds
    cell: float = 0.0  # places: side of the squares assigned to parts [m]
    drives: tuple[tuple[str, str], ...] = ()  # drives: name and part of each

    @property
    def smallest(self) -> float:
        """Smallest fraction above zero (blocks)."""
        return min(share for share in self.fractions if share > 0)

    def label(self, drive: str, position: Float[np.ndarray, "N 2"]) -> Int[np.ndarray, " N"]:
        """Return the part of each row of a drive, -1 in gaps; raise `DatasetError` if a split by drives lacks it.

        Args:
            position: px, py in the world frame, not relative to the drive, so that places agree between drives [m].
        """
        rows = len(position)
        if self.kind == "blocks":
            length = min(round(self.period / DT), rows) if self.period else rows
            if length * self.smallest < 2 * GAP:
                return np.zeros(rows, dtype=np.int8)
            edges = np.round(np.cumsum(self.fractions) * length)
            return _with_gaps(np.searchsorted(edges[:-1], np.arange(rows) % length, side="right"))
        if self.kind == "fold":
            number, total = self.fold
            label = np.zeros(rows, dtype=np.int8)
            if rows / (2 * total) < 2 * GAP:
                return label
            half = np.arange(rows) * 2 * total // rows
            label[half == 2 * ((number + 1) % total)] = PARTS.index("validation")
            label[half // 2 == number] = PARTS.index("test")
            return _with_gaps(label)
        if self.kind == "places":
            return _with_gaps(_place_labels(position, self.cell))
        parts = dict(self.drives)
        if drive not in parts:
            raise DatasetError(f"the split names no part for drive '{drive}'", where=self.text, how="add a line for it")
        return np.full(rows, PARTS.index(parts[drive]), dtype=np.int8)


def parse_split(text: str) -> Split:
    """Parse the text of a split.

    `blocks:TRAIN,VALIDATION,TEST` are fractions of each drive by time, with `@SECONDS` of each such period;
    `fold:K/N` tests block K of N and validates on half of the next; `places:METRES` assigns squares of the ground
    70 : 10 : 20; `drives:FILE` reads a line "NAME PART" per drive. Anything else raises `DatasetError`.
    """
    kind, _, rest = text.partition(":")
    usage = "write blocks:0.7,0.1,0.2, fold:0/5 (the first of five, up to fold:4/5), places:50 or drives:FILE"
    try:
        if kind == "blocks":
            shares, at, every = rest.partition("@")
            fractions, period = tuple(float(f) for f in shares.split(",")), float(every) if at else 0.0
            if len(fractions) == 3 and abs(sum(fractions) - 1) >= 1e-6:
                what = f"not a split: the shares of '{text}' sum to {sum(fractions):g}"
                raise DatasetError(what, how="give shares that sum to 1, as in blocks:0.7,0.1,0.2")
            good = len(fractions) == 3 and sum(fractions) > 0 and min(fractions) >= 0 and fractions[0] > 0
            if good and (not at or 0 < period < np.inf):
                split = Split(text, kind, fractions=fractions, period=period)
                least = 2 * GAP * DT / split.smallest
                if at and period < least - 1e-9:
                    what = f"blocks of {period:g} s leave {period * split.smallest:.1f} s for the smallest part"
                    how = (
                        f"give @{np.ceil(least):.0f} or more: two windows with their history take {2 * GAP * DT:.1f} s"
                    )
                    raise DatasetError(what, where=text, how=how)
                return split
        elif kind == "fold":
            number, total = (int(f) for f in rest.split("/"))
            if total >= 3 and 0 <= number < total:
                return Split(text, kind, fold=(number, total))
        elif kind == "places":
            if 0 < float(rest) < np.inf:
                return Split(text, kind, cell=float(rest))
        elif kind == "drives" and rest:
            return Split(text, kind, drives=_read_drives(Path(rest)))
    except ValueError:
        pass
    raise DatasetError(f"not a split: '{text}'", how=f"{usage} (a file with a line 'NAME PART' per drive)")


def refuse_places_without_origin(split: Split, rig: Rig) -> None:
    """Raise `DatasetError` for a split by places if each log has a geographic origin of its own."""
    position = rig.channels["position"]
    if split.kind == "places" and position.unit == GEOGRAPHIC and position.origin is None:
        what = f"positions in '{GEOGRAPHIC}' have an origin of each log, so that one place would be in several parts"
        how = "give channels.position.origin in the rig: latitude and longitude of a place near all drives"
        raise DatasetError(what, where=split.text, how=how)


def stored_split(text: str, drives: Sequence[Sequence[str]]) -> Split:
    """Restore a stored split; a split by drives keeps its parts instead of the file that named them."""
    if drives:
        return Split(text, "drives", drives=tuple((name, part) for name, part in drives))
    return parse_split(text)


def write_drives(path: Path, parts: Iterable[tuple[str, str]]) -> str:
    """Write the name and part of each drive into a file and return its text for `parse_split`."""
    write_text(path, "".join(f"{name} {part}\n" for name, part in parts))
    return f"drives:{path}"


def empty_parts(split: Split) -> tuple[str, ...]:
    """Return the parts that a split leaves empty for any drive."""
    if split.kind == "blocks":
        return tuple(part for part, share in zip(PARTS, split.fractions, strict=True) if share == 0)
    if split.kind == "drives":
        return tuple(part for part in PARTS if part not in {given for _, given in split.drives})
    return ()


def part_number(part: str) -> int:
    """Return the label of a part; raise `DatasetError` if there is no such part."""
    if part not in PARTS:
        raise DatasetError(f"no part '{part}'", how=f"{did_you_mean(part, PARTS)}available: {', '.join(PARTS)}")
    return PARTS.index(part)


def _with_gaps(label: Int[np.ndarray, " N"]) -> Int[np.ndarray, " N"]:
    """Label the rows just after each change of part -1."""
    label = label.astype(np.int8)
    for change in np.flatnonzero(np.diff(label)) + 1:
        label[change : change + GAP] = -1
    return label


def _place_labels(position: Float[np.ndarray, "N 2"], cell: float) -> Int[np.ndarray, " N"]:
    """Assign squares to parts by a hash of their place alone (Teschner et al. 2003), so that all drives agree.

    Unknown positions take the last known one, or the first.
    """
    known = np.isfinite(position).all(axis=1)
    if not known.any():
        return np.zeros(len(position), dtype=np.int8)
    last = np.maximum.accumulate(np.where(known, np.arange(len(known)), np.argmax(known)))
    square = np.floor(position[last] / cell).astype(np.int64)
    hashed = (square[:, 0] * 73856093 ^ square[:, 1] * 19349663) % 1000
    return np.searchsorted([700, 800], hashed, side="right").astype(np.int8)


def _read_drives(path: Path) -> tuple[tuple[str, str], ...]:
    try:
        # The part is the last word: names of drives may hold spaces.
        lines = [line.strip().rsplit(maxsplit=1) for line in read_small(path).splitlines() if line.strip()]
    except (OSError, UnicodeDecodeError) as error:
        raise DatasetError("cannot read the split", where=path, how="write a line 'NAME PART' per drive") from error
    parts = dict[str, str]()
    for number, line in enumerate(lines, start=1):
        if len(line) != 2 or line[1] not in PARTS:
            how = f"PART is one of {', '.join(PARTS)}"
            raise DatasetError(f"line {number} is not 'NAME PART'", where=path, how=how)
        if parts.setdefault(line[0], line[1]) != line[1]:
            what = f"line {number} puts drive '{line[0]}' into {line[1]}, an earlier one into {parts[line[0]]}"
            raise DatasetError(what, where=path, how="keep one of them")
    return tuple((name, part) for name, part in lines)
