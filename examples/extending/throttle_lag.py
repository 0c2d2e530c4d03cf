"""A first-order actuator: the throttle's measured position, which follows its command with a lag.

Rigs may then have [channels.throttle_position]. Models read the position in place of the command, and predict how it
follows. Name this module in the environment to use it:

    PYTHONPATH=examples/extending OFFPISTE_EXTENSIONS=throttle_lag offpiste extract drive.csv --rig rig.toml
"""

from offpiste.core.channels import Actuator, register_actuator

register_actuator(
    Actuator(
        "throttle_position",
        channel="throttle_position",
        low=0.0,
        high=1.0,
        follows="throttle",
        lag="first-order",
        drives="throttle",
        pattern=r"throttle_?pos",
    )
)
