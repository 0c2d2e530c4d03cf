"""How a robot is reached: options of all commands that do."""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Final, Literal

if TYPE_CHECKING:
    from offpiste.transport.zenoh_transport import ZenohSettings

RUN: Final = "pretrained:proving-ground/b"
"""Run that drives unless one is given; the doctor looks at the same."""


@dataclass(frozen=True)
class RobotOptions:
    """How the robot is reached, over zenoh."""

    endpoint: str = ""
    """Address of zenoh's router; tcp/127.0.0.1:7447, where rmw_zenohd listens, unless given."""
    router: bool = False
    """Be the router oneself: where no rmw_zenohd runs."""
    keys: Literal["rmw_zenoh", "bridge"] = "rmw_zenoh"
    """rmw_zenoh, or those of zenoh-bridge-ros2dds for robots on Fast DDS or Cyclone DDS."""
    domain: int = 0
    """ROS_DOMAIN_ID, for rmw_zenoh."""
    namespace: str = ""
    """Namespace of the bridge."""
    zenoh_config: Path | None = None
    """File of zenoh's configuration, e.g. with certificates for TLS."""

    def settings(self, patient: bool = False) -> "ZenohSettings":
        """As the transport takes them."""
        from offpiste.transport.zenoh_transport import ZenohSettings

        return ZenohSettings(
            endpoint=self.endpoint,
            mode="router" if self.router else "client",
            keys=self.keys,
            domain=self.domain,
            namespace=self.namespace,
            config=str(self.zenoh_config or ""),
            patient=patient,
        )
