"""Clocks of a rig: which stamps count, what a gap is, and which topics share a clock that drifts."""

from typing import Literal

import msgspec

from offpiste.rig.channels import ChannelSource


class Clock(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Stamps of a log, and what counts as a gap.

    Attributes:
        stamps: of messages in bags: their headers', or their arrival.
        column: a table's time column.
        unit: of that column: s, ms, us or ns.
        max_gap: no interpolation between samples further apart; a drive is cut there [s].
    """

    stamps: Literal["header", "receive"] = "header"
    column: str = ""
    unit: Literal["s", "ms", "us", "ns"] = "s"
    max_gap: float = 0.5


class Alignment(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Topics whose common clock drifts against the poses'; the wheels' speed shows by how much.

    Attributes:
        topics: all topics stamped by that clock.
        speed: the vehicle's speed by the wheels, among them; several fields are averaged [m/s after conversion].
        max_lag: lags from minus half of it to all of it are tried [s].
    """

    topics: tuple[str, ...]
    speed: ChannelSource
    max_lag: float = 2.0
