"""What a dynamics model must know of the vehicle and of its log."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Vehicle:
    """A vehicle and the channels that its log has.

    Attributes:
        mass: [kg].
        wheelbase: [m].
        max_steer: road-wheel angle at a steering command of 1 [rad].
        control: names (of `conventions.CONTROL`) that the log has.
        actuators: names (of `conventions.ACTUATORS`) that the log has; "steer" only together with "steer_rate".
        rear_axle: how far behind the pose point the rear axle lies [m].
        features: how many terrain features the dataset has under each wheel.
        pca: how many of them a model reads, the first ones; 0: all.
        codes: length of the code that an encoder makes of them.
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

    def __post_init__(self) -> None:
        if "steer" in self.actuators and "steer_rate" not in self.actuators:
            raise ValueError("a steering angle needs its rate: the delay model has both as its state")

    @property
    def read(self) -> int:
        """How many terrain features a model reads."""
        return self.pca or self.features
