"""The network between robot and computer: a router in a process of its own, and a link that can be held up."""

import socket
import subprocess
import sys
import threading
import time
from contextlib import suppress
from typing import Final

_ROUTER: Final = """
import sys, time
from offpiste.transport.zenoh_transport import ZenohSettings, ZenohTransport
router = ZenohTransport(ZenohSettings(endpoint=sys.argv[1], mode="router"))
print("ready", flush=True)
while True:
    time.sleep(60)
"""


def free_port() -> int:
    """A port of the loopback that nobody listens on."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


class Router:
    """zenoh's router.

    Attributes:
        port: on the loopback, also after it was started again.
    """

    def __init__(self) -> None:
        self.port = free_port()
        self.start()

    def start(self) -> None:
        """Start it, and wait until it listens."""
        command = [sys.executable, "-c", _ROUTER, f"tcp/127.0.0.1:{self.port}"]
        self._process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
        assert self._process.stdout is not None
        self._process.stdout.readline()

    def kill(self) -> None:
        """End it at once."""
        self._process.kill()
        self._process.wait()


class Link:
    """Forwards connections of a port to the router, as long as it is open."""

    def __init__(self, router: Router) -> None:
        self._router, self._open = router, threading.Event()
        self._open.set()
        self._socket = socket.create_server(("127.0.0.1", 0))
        self.port = int(self._socket.getsockname()[1])
        threading.Thread(target=self._accept, daemon=True).start()

    def stall(self, seconds: float) -> None:
        """Hold everything up for some time; it is delivered after."""
        self._open.clear()
        time.sleep(seconds)
        self._open.set()

    def burst(self, seconds: float, every: float = 0.3) -> None:
        """Deliver in bursts."""
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            self.stall(every)
            time.sleep(0.01)

    def close(self) -> None:
        """Take no more connections."""
        self._socket.close()

    def _accept(self) -> None:
        with suppress(OSError):
            while True:
                here, _ = self._socket.accept()
                try:
                    there = socket.create_connection(("127.0.0.1", self._router.port))
                except OSError:  # the router is gone
                    here.close()
                    continue
                for one, other in ((here, there), (there, here)):
                    threading.Thread(target=self._forward, args=(one, other), daemon=True).start()

    def _forward(self, one: socket.socket, other: socket.socket) -> None:
        with suppress(OSError):
            while data := one.recv(1 << 16):
                self._open.wait()
                other.sendall(data)
        for end in (one, other):
            with suppress(OSError):
                end.shutdown(socket.SHUT_RDWR)
