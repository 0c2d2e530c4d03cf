"""Options of the connection to a robot."""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Final, Literal

if TYPE_CHECKING:
    from offpiste.transport.zenoh_transport import ZenohSettings

RUN: Final = "pretrained:proving-ground/b"
"""Default run of `live` and `doctor`."""


@dataclass(frozen=True)
class RobotOptions:
    """Connection to the robot over zenoh."""

    endpoint: str = ""
    """Address of the zenoh router; by default tcp/127.0.0.1:7447, the address of rmw_zenohd."""
    router: bool = False
    """Act as the router if no rmw_zenohd runs."""
    keys: Literal["rmw_zenoh", "bridge"] = "rmw_zenoh"
    """Key format: rmw_zenoh, or that of zenoh-bridge-ros2dds for robots on Fast DDS or Cyclone DDS."""
    domain: int = 0
    """ROS_DOMAIN_ID of rmw_zenoh."""
    namespace: str = ""
    """Namespace of the bridge."""
    zenoh_config: Path | None = None
    """Configuration file of zenoh, e.g. with TLS certificates."""

    def settings(self, patient: bool = False) -> "ZenohSettings":
        """Return the settings of the transport."""
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
