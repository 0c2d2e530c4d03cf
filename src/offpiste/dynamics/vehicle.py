"""What a dynamics model must know of the vehicle and of its log."""

from dataclasses import dataclass
from functools import cached_property

from offpiste.core.channels import actuator_columns, all_actuators, control_columns


@dataclass(frozen=True)
class Vehicle:
    """A vehicle and the channels that its log has.

    Attributes:
        mass: [kg].
        wheelbase: [m].
        max_steer: road-wheel angle at a steering command of 1 [rad]; 0 where nothing steers.
        control: names of controls (`offpiste.core.channels`) that the log has.
        actuators: names of actuators that the log has; "steer" only together with "steer_rate".
        rear_axle: how far behind the pose point the rear axle lies [m].
        features: how many terrain features the dataset has under each wheel.
        pca: how many of them a model reads, the first ones; 0: all.
        codes: length of the code that an encoder makes of them.
        track: distance between the left and the right wheels, or tracks [m].
    """

    mass: float
    wheelbase: float
    max_steer: float
    control: tuple[str, ...]
    actuators: tuple[str, ...]
    rear_axle: float = 0.0
    features: int = 0
    pca: int = 0
    codes: int = 4
    track: float = 0.0

    def __post_init__(self) -> None:
        for rate in all_actuators():
            if rate.rate_of in self.actuators and rate.name not in self.actuators:
                raise ValueError(f"{rate.rate_of} needs its rate ({rate.name}): the delay model has both as its state")

    @cached_property
    def control_columns(self) -> tuple[str, ...]:
        """Columns of `control` in this vehicle's datasets, those that the log lacks included."""
        return tuple(control.name for control in control_columns(self.control))

    @cached_property
    def actuator_columns(self) -> tuple[str, ...]:
        """Columns of `actuators` in this vehicle's datasets, those that the log lacks included."""
        return tuple(actuator.name for actuator in actuator_columns(self.actuators))

    @cached_property
    def measured_inputs(self) -> dict[str, str]:
        """Inputs of the bicycle that an actuator measures (`Actuator.drives`), and the names of those actuators."""
        present = (actuator for actuator in actuator_columns(self.actuators) if actuator.name in self.actuators)
        return {actuator.drives: actuator.name for actuator in present if actuator.drives}

    @property
    def steers(self) -> bool:
        """Whether the log has a steering angle or a steering command."""
        return "steer" in self.actuators or "steer" in self.control

    @property
    def read(self) -> int:
        """How many terrain features a model reads."""
        return self.pca or self.features
