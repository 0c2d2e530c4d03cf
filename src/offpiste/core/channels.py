"""Tables of controls and actuators of a vehicle, which all other stages read.

`CONTROLS` and `ACTUATORS` are columns of every dataset, NaN if a log lacks them. `OPTIONAL_CONTROLS` and registered
channels are columns of datasets whose rig has them. Generated kernels support all but registered channels.
docs/extending.md shows how to add a channel.
"""

import math
from collections.abc import Collection
from dataclasses import dataclass
from typing import Final

from offpiste.core.registry import Registry


@dataclass(frozen=True)
class Control:
    """Command to the vehicle.

    Attributes:
        name: name of the channel in rigs and of the column in datasets.
        low, high: limits of the command.
        rate: largest rate of change in plans [1/s].
        pattern: regular expression of field names that mean this control, used to draft rigs.
        declared: a rig must declare it absent if its logs lack it.
        absent: value that replaces it if a log lacks it.
        discrete: integer that is held between samples and clipped to `low` and `high`.
    """

    name: str
    unit: str = "1"
    low: float = 0.0
    high: float = 1.0
    rate: float = 4.0
    pattern: str = ""
    declared: bool = False
    absent: float = 0.0
    discrete: bool = False


@dataclass(frozen=True)
class Actuator:
    """Measured quantity between a command and the motion.

    Attributes:
        name: column in datasets.
        channel: channel in rigs.
        low, high: plausible range for log checks.
        follows: control that it lags behind.
        lag: lag model (`offpiste.dynamics.actuator_lags.LAGS`).
        drives: input of the bicycle that it measures (`offpiste.dynamics.bicycle.DriveTrain`), which has a reduced form
            if it is absent; "" for an input of the networks alone.
        rate_of: actuator whose rate of change it is; both are the state of that actuator's lag.
        pattern, declared: see `Control`.
    """

    name: str
    channel: str
    unit: str = "1"
    low: float | None = None
    high: float | None = None
    follows: str = ""
    lag: str = "first-order"
    drives: str = ""
    rate_of: str = ""
    pattern: str = ""
    declared: bool = False

    @property
    def label(self) -> str:
        """Prefix of its constants, networks and switches."""
        return self.drives or self.name


CONTROLS: Final = (
    Control(
        "throttle", declared=True,
        pattern=r"throttle|acc(el)?_?(pedal|pdl|ped(?![a-z]))|accelerator|pedal_?acc|(^|[ ._/])(gas|thr(?![a-z]))",
    ),
    Control("brake", rate=8.0, declared=True, pattern=r"brake|(?<![a-z])brk(?![a-z])"),
    Control(
        "steer", low=-1.0, declared=True, pattern=r"steer|(?<![a-z])str_?(cmd|com+and|pct|in(put)?)(?![a-z])",
    ),
)  # fmt: skip
"""Commanded throttle and brake from 0 to 1, and steering from -1 (right) to 1 (left)."""

OPTIONAL_CONTROLS: Final = (
    Control(
        "gear", low=-1.0, rate=math.inf, absent=1.0, discrete=True,
        pattern=r"(?<![a-z])gear(?!_?(box|ratio|ing))|prndl?(?![a-z])|(?<![a-z])(shifter|transmission|reverse)(?![a-z])",
    ),
)  # fmt: skip
"""Engaged gear: 1 forward, 0 neutral, -1 reverse."""

KERNEL_CONTROLS: Final = (*CONTROLS, *OPTIONAL_CONTROLS)
"""Controls that generated kernels support."""

ACTUATORS: Final = (
    Actuator(
        "brake", "brake_pressure", low=0.0, high=1.0,
        follows="brake", lag="apply-release", drives="brake", declared=True,
    ),
    Actuator(
        "steer", "steer_angle", "rad", low=-1.0, high=1.0,
        follows="steer", lag="second-order", drives="steer", declared=True,
    ),
    Actuator("steer_rate", "steer_rate", "rad/s", rate_of="steer", declared=True),
    Actuator(
        "engine_rpm", "engine_rpm", "1000 rev/min", low=0.0, high=15.0, follows="throttle", lag="engine",
        drives="engine", pattern=r"engine.*(rpm|speed)|^rpm(?![_ ]?(fl|fr|rl|rr|front|rear))", declared=True,
    ),
)  # fmt: skip
"""Brake pressure relative to full pressure, angle of the road wheels (+ left) and its rate, engine speed."""

MORE_CONTROLS: Final[Registry[Control]] = Registry("control")
MORE_ACTUATORS: Final[Registry[Actuator]] = Registry("actuator")


def register_control(control: Control) -> Control:
    """Add a control that rigs can have; raises `OffpisteError` if its name is taken."""
    return MORE_CONTROLS.register(control.name)(control)


def register_actuator(actuator: Actuator) -> Actuator:
    """Add an actuator that rigs can have and eager code steps; raises `OffpisteError` if its name is taken."""
    return MORE_ACTUATORS.register(actuator.name)(actuator)


def all_controls() -> tuple[Control, ...]:
    """Return every control that a rig can have."""
    return (*KERNEL_CONTROLS, *(control for _, control in MORE_CONTROLS.items()))


def registered_actuators() -> tuple[Actuator, ...]:
    """Return the actuators that extensions added."""
    return tuple(actuator for _, actuator in MORE_ACTUATORS.items())


def all_actuators() -> tuple[Actuator, ...]:
    """Return every actuator that a rig can have."""
    return (*ACTUATORS, *registered_actuators())


def control_columns(given: Collection[str]) -> tuple[Control, ...]:
    """Return the columns of `control` for these names: `CONTROLS`, then optional and registered ones."""
    return tuple(control for control in all_controls() if control in CONTROLS or control.name in given)


def actuator_columns(given: Collection[str]) -> tuple[Actuator, ...]:
    """Return the columns of `actuators` for these names: `ACTUATORS`, then registered ones."""
    return tuple(actuator for actuator in all_actuators() if actuator in ACTUATORS or actuator.name in given)


def control_of(channel: str) -> Control | None:
    """Return the control of a channel; None for other channels."""
    return next((control for control in all_controls() if control.name == channel), None)


def without_optional(names: Collection[str]) -> tuple[str, ...]:
    """Return the names of controls that a model must share with a dataset, in their order."""
    return tuple(name for name in names if name not in {control.name for control in OPTIONAL_CONTROLS})


def absent_value(name: str) -> float:
    """Return the value that replaces a control if a log lacks it."""
    return next(control.absent for control in all_controls() if control.name == name)


def channel_of_rate(channel: str) -> str:
    """Return the channel whose derivative replaces this one if a log lacks it; "" for none."""
    channels = {actuator.name: actuator.channel for actuator in all_actuators()}
    return next((channels[a.rate_of] for a in all_actuators() if a.channel == channel and a.rate_of), "")
