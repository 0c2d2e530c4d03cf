"""Commands of a motion, i.e. speed and turn rate instead of pedals and steering."""

from collections.abc import Iterator, Mapping
from typing import Any, Final

import numpy as np
from jaxtyping import Float

from offpiste.logs.log import Topic
from offpiste.rig.channels import TURN_RATES
from offpiste.rig.edits import rounded
from offpiste.rig.labels import PATTERNS, Label, channel_unit, is_named
from offpiste.rig.rig import Rig

_FASTEST: Final = 6.5
"""Maximum turn rate in rad/s; larger values are in degrees per second."""
_DIRECTION: Final = 100.0
"""Scaled maximum speed, large enough that the rounded sign of slow speeds serves as gear, too."""
_USUAL: Final = 95
"""Percentile of the commanded curvatures taken as full lock; larger ones are turns on the spot."""


def motion_commands(topic: Topic, named: Mapping[str, Label]) -> Iterator[tuple[str, tuple[str, ...], str]]:
    """Yield channel, fields and unit of throttle, gear and steering from a topic of commanded motion.

    Args:
        named: name and unit of the topic's fields.
    """
    by_topic = is_commanded(topic)
    asked = {field: label for field, label in named.items() if by_topic or is_named("commanded", label.name)}
    plain = {field: PATTERNS["command_words"].sub(" ", label.name).strip(" ._/") for field, label in asked.items()}
    usable = [field for field, name in plain.items() if not is_named("not_motion", name)]
    straight = (f for f in usable if "angular" not in plain[f])
    speed = next((f for f in straight if is_named("speed", plain[f]) and _measures("wheel_speed", asked[f])), None)
    if speed is None:
        return
    yield "throttle", (speed,), asked[speed].unit or "m/s"
    yield "gear", (speed,), asked[speed].unit or "m/s"
    turn = next((f for f in usable if is_named("turn", plain[f]) and _measures("yaw_rate", asked[f])), None)
    if turn is not None and asked[speed].unit in ("", "m/s"):
        yield "steer", (turn, speed), asked[turn].unit or "rad/s"


def is_commanded(topic: Topic, fields: tuple[str, ...] = ()) -> bool:
    """Return True if the type or name of a topic, or any of these fields, marks a command."""
    if is_named("command_types", topic.type) and not is_named("measured", topic.name):
        return True
    return is_named("commanded", topic.name, *fields)


def _measures(channel: str, label: Label) -> bool:
    return channel_unit(channel, label.unit) is not None


def motion_settings(channel: str, values: Float[np.ndarray, " n"], unit: str) -> tuple[dict[str, Any], str]:
    """Return the settings of a commanded motion in a first rig, and a note.

    Args:
        values: of the first field: speed [m/s] or turn rate.
        unit: of a turn rate, as stated by the log; rad/s by default.
    """
    largest, backwards = float(np.abs(values).max()), bool(values.min() < 0)
    if channel == "gear":
        return {"scale": rounded(_DIRECTION / largest)}, "the direction of the commanded speed"
    if channel == "throttle":
        words = f"a commanded speed, of which 1 is {largest:.4g}, the largest of this log"
        size = {"absolute": True} if backwards else {}
        return {"scale": rounded(1 / largest), **size, "clip": [0.0, 1.0]}, words
    if unit == "rad/s" and largest > _FASTEST:
        unit = "deg/s"
    words = "a commanded turn rate, and the speed: the angle of a bicycle that turns so, over max_steer"
    return {"unit": unit, "clip": [-1.0, 1.0]}, words


def commanded_curvature(raw: Float[np.ndarray, "n 2"], rig: Rig) -> float:
    """Return the commanded curvature at full lock [1/m], excluding a few turns on the spot.

    Args:
        raw: turn rate and speed of each command, as recorded.
        rig: the rig with this steering.
    """
    source = rig.channels["steer"]
    rate, speed = raw[np.isfinite(raw).all(axis=1)].T
    rate = (rate * source.scale + source.offset) * TURN_RATES[source.unit]
    quick = np.abs(speed) > 0.3 * np.percentile(np.abs(speed), _USUAL)
    turns = quick & (rate != 0)
    return float(np.percentile(np.abs(rate[turns] / speed[turns]), _USUAL)) if turns.any() else 0.0
