"""Delay models of actuators, once, as functions of plain scalars: how fast each follows its command.

The elementary functions are passed in, as in `offpiste.dynamics.bicycle`: torch's give the reference on batches,
SymPy's the expressions from which kernels are derived.
"""

from collections.abc import Callable, Mapping
from typing import Final, NamedTuple

from offpiste.core.channels import ACTUATORS, Actuator, actuator_columns
from offpiste.dynamics.bicycle import Elementary, Scalar
from offpiste.dynamics.vehicle import Vehicle

Values = tuple[Scalar, ...]
"""An actuator and, of a second-order lag, its rate."""

Constants = Mapping[str, Scalar]
"""Constants of one lag by name."""

Change = Callable[[Values, Scalar, Scalar, Constants, Elementary], Values]
"""From an actuator's values, its command, vx [m/s] and the lag's constants to d(values)/dt."""


class Lag(NamedTuple):
    """A delay model.

    Attributes:
        change: d(values)/dt.
        constants: least, largest and initial value of each constant.
        residual: whether a network corrects the last derivative.
    """

    change: Change
    constants: Mapping[str, tuple[float, float, float]]
    residual: bool = False


def first_order(values: Values, command: Scalar, vx: Scalar, c: Constants, f: Elementary) -> Values:
    """A first-order lag.

    Constants: rate, how fast the command is followed [1/s].
    """
    (value,) = values
    return (c["rate"] * (command - value),)


def apply_release(values: Values, command: Scalar, vx: Scalar, c: Constants, f: Elementary) -> Values:
    """A first-order lag that applies and releases at its own speeds: brake pressure.

    Constants: apply, release, how fast a rising and a falling command are followed [1/s].
    """
    (brake,) = values
    return (c["apply"] * f.maximum(command - brake, 0 * brake) - c["release"] * f.maximum(brake - command, 0 * brake),)


def second_order(values: Values, command: Scalar, vx: Scalar, c: Constants, f: Elementary) -> Values:
    """A second-order lag behind gain u + offset: the steering angle and its rate.

    Constants: gain, offset [rad], frequency (natural, [rad/s]), damping (ratio).
    """
    steer, rate = values
    wanted = c["gain"] * command + c["offset"]
    return rate, c["frequency"] * (c["frequency"] * (wanted - steer) - 2 * c["damping"] * rate)


def engine(values: Values, command: Scalar, vx: Scalar, c: Constants, f: Elementary) -> Values:
    """Engine speed: follows what throttle and speed ask for, idle + t u_th + s |vx| + b u_th |vx| [1000 rev/min].

    Constants: rate [1/s], idle, throttle (t), speed (s), both (b).
    """
    (revolutions,) = values
    speed = f.maximum(vx, -vx)
    target = c["idle"] + c["throttle"] * command + c["speed"] * speed + c["both"] * command * speed
    return (c["rate"] * (target - revolutions),)


LAGS: Final[dict[str, Lag]] = {
    "first-order": Lag(first_order, {"rate": (0.1, 40.0, 8.0)}),
    "apply-release": Lag(apply_release, {"apply": (0.1, 40.0, 8.0), "release": (0.1, 40.0, 8.0)}, residual=True),
    "second-order": Lag(
        second_order,
        {
            "gain": (0.0, 1.5, 0.5),
            "offset": (-0.3, 0.3, 0.0),
            # Forward Euler at 0.02 s is stable for frequency < 2 damping / dt.
            "frequency": (0.5, 20.0, 8.0),
            "damping": (0.4, 1.5, 0.8),
        },
        residual=True,
    ),
    "engine": Lag(
        engine,
        {
            "rate": (0.1, 40.0, 4.0),
            "idle": (0.0, 3.0, 1.0),
            "throttle": (-10.0, 10.0, 3.0),
            "speed": (-1.0, 1.0, 0.1),
            "both": (-1.0, 1.0, 0.0),
        },
    ),
}
"""Delay models by the names that `offpiste.core.channels.Actuator.lag` gives; an extension may add its own."""


class Lagging(NamedTuple):
    """An actuator with its delay model.

    Attributes:
        actuator: which one.
        columns: the actuator and, of a second-order lag, its rate.
        lag: how they follow `actuator.follows`.
    """

    actuator: Actuator
    columns: tuple[str, ...]
    lag: Lag

    @property
    def label(self) -> str:
        """What the names of its constants and networks begin with."""
        return self.actuator.label

    def steps(self, vehicle: Vehicle) -> bool:
        """Whether the vehicle's log has both the actuator and the command that it follows."""
        return self.actuator.name in vehicle.actuators and self.actuator.follows in vehicle.control


def lagging(actuators: tuple[Actuator, ...] = ACTUATORS) -> tuple[Lagging, ...]:
    """Actuators that lag behind a command, in order; rates of others belong to those."""
    return tuple(
        Lagging(one, (one.name, *(rate.name for rate in actuators if rate.rate_of == one.name)), LAGS[one.lag])
        for one in actuators
        if not one.rate_of
    )


def lagging_of(vehicle: Vehicle) -> tuple[Lagging, ...]:
    """The same of the columns that a vehicle's datasets have."""
    return lagging(actuator_columns(vehicle.actuators))
