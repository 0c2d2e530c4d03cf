"""States for the service manager that started the command: systemd's `sd_notify` protocol."""

import logging
import os
import socket

logger = logging.getLogger(__name__)


class ServiceManager:
    """The socket of `$NOTIFY_SOCKET`: a path, or "@" and the name of an abstract one; without it nothing is sent."""

    def __init__(self) -> None:
        address = os.environ.get("NOTIFY_SOCKET", "")
        self._address = f"\0{address[1:]}" if address.startswith("@") else address
        self._failed = False

    def notify(self, **state: object) -> None:
        """Send a state, as `notify(READY=1, STATUS="drives")`; never waits."""
        if not self._address:
            return
        lines = (f"{name}={' '.join(str(value).split())}" for name, value in state.items())
        try:
            with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_NONBLOCK) as sender:
                sender.sendto("\n".join(lines).encode(), self._address)
        except OSError as error:
            if not self._failed:
                logger.warning(f"the service manager is not notified: {error.strerror or error} ($NOTIFY_SOCKET)")
            self._failed = True
