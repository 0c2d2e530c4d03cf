"""Parameters of a vehicle and channels of its log, as dynamics models need them."""

from dataclasses import dataclass
from functools import cached_property

from offpiste.core.channels import actuator_columns, all_actuators, control_columns


@dataclass(frozen=True)
class Vehicle:
    """Vehicle and the channels of its log.

    Attributes:
        mass: [kg].
        wheelbase: [m].
        max_steer: road-wheel angle at a steering command of 1 [rad]; 0 without steering.
        control: recorded controls (`offpiste.core.channels`).
        actuators: recorded actuators; "steer" only together with "steer_rate".
        rear_axle: distance of the rear axle behind the pose point [m].
        features: number of terrain features under each wheel in the dataset.
        pca: number of leading features that a model reads; 0: all.
        codes: length of an encoded feature vector.
        track: distance between left and right wheels or tracks [m].
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
        """Columns of `control` in this vehicle's datasets, including absent channels."""
        return tuple(control.name for control in control_columns(self.control))

    @cached_property
    def actuator_columns(self) -> tuple[str, ...]:
        """Columns of `actuators` in this vehicle's datasets, including absent channels."""
        return tuple(actuator.name for actuator in actuator_columns(self.actuators))

    @cached_property
    def measured_inputs(self) -> dict[str, str]:
        """Actuators that measure an input of the bicycle, by that input (`Actuator.drives`)."""
        present = (actuator for actuator in actuator_columns(self.actuators) if actuator.name in self.actuators)
        return {actuator.drives: actuator.name for actuator in present if actuator.drives}

    @property
    def steers(self) -> bool:
        """Whether a steering angle or a steering command is recorded."""
        return "steer" in self.actuators or "steer" in self.control

    @property
    def read(self) -> int:
        """Number of terrain features that a model reads."""
        return self.pca or self.features
