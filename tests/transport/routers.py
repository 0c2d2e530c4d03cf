"""Zenoh routers on the loopback, and sessions."""

import socket
import time
from contextlib import ExitStack

from offpiste.transport.zenoh_transport import ZenohSettings, ZenohTransport


def free_port():
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


def until(condition, seconds=5.0, every=0.01):
    """Return whether a condition becomes true within a time limit [s], checked at an interval [s]."""
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        if condition():
            return True
        time.sleep(every)
    return False


class Network:
    """A router, unless one is at the given endpoint, and sessions that are closed with it."""

    def __init__(self, endpoint="", **settings):
        self._settings, self._stack = settings, ExitStack()
        self.endpoint = endpoint or f"tcp/127.0.0.1:{free_port()}"
        self.router = None if endpoint else self.session(mode="router")

    def session(self, definitions=(), **settings):
        given = {"endpoint": self.endpoint, **self._settings, **settings}
        transport = ZenohTransport(ZenohSettings(**given), definitions)
        self._stack.callback(transport.close)
        return transport

    def close(self):
        self._stack.close()
