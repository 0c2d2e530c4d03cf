"""The faults: how each is made, and by what its name is found in the diagnostics."""

import os
import resource
import signal
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

import numpy as np

from experiments.live_faults.bench import COMMAND, ODOMETRY, Bench
from offpiste.logs.ros.writer import make
from offpiste.transport.keys import Address
from offpiste.transport.zenoh_transport import ZenohSettings, ZenohTransport

Inject = Callable[[Bench, np.random.Generator], float]
"""Makes a fault, and ends it; returns when control was lost, by the steady clock [s]."""


@dataclass(frozen=True)
class Fault:
    """A fault.

    Attributes:
        named: what a new line of the diagnostics has to hold.
        stops: whether the vehicle has to be stopped; else it may drive on.
        ends_recording: after it, another drive is begun.
    """

    name: str
    inject: Inject
    named: str
    stops: bool = False
    ends_recording: bool = False


def faults() -> list[Fault]:
    """All faults."""
    found = []
    for part in ("control", "receive", "map", "plan", "watchdog", "record"):
        stops = part in ("control", "receive")
        found.append(Fault(f"SIGKILL of {part}", _blow(part, signal.SIGKILL), rf"^{part}: restarts", stops))
        why = rf"^{part}: gives no sign of life|^control: stopp"
        found.append(Fault(f"SIGSTOP of {part} for 3 s", _blow(part, signal.SIGSTOP), why, stops))
    lost = r"no state|interrupted|router lost|no router"
    return [
        *found,
        Fault("router gone for 1 s", _router_gone, lost, stops=True),
        Fault("network stalled for 0.1 to 3 s", _stalled, lost),
        Fault("packets in bursts for 3 s", _bursts, lost),
        Fault("a reading stamped 100 s ahead", _stamps(100.0), "stamps ahead of the clock"),
        Fault("a reading stamped 100 s ago", _stamps(-100.0), "repeat or go back|not finite"),
        Fault("the clock jumps by 100 s and back", _clock_jumps, "the clock jumped", stops=True),
        Fault("a corrupt message", _corrupt, "cannot be decoded"),
        Fault("a wrong type hash", _wrong_hash, "its hash differs"),
        Fault("a full disk under --record", _full_disk, r"^record: ended", ends_recording=True),
        Fault("a second commander for 0.5 s", _second_commander, "another publisher", stops=True),
        Fault("no more memory for receive", _no_memory("receive"), r"^receive: (restarts|ended)", stops=True),
    ]


_HELD: Final = 3.0
"""A process is stopped for so long [s]."""


def _blow(part: str, number: signal.Signals) -> Inject:
    def inject(bench: Bench, rng: np.random.Generator) -> float:
        moment = time.monotonic()
        os.kill(bench.pids[part], number)
        if number == signal.SIGSTOP:
            time.sleep(_HELD)
            os.kill(bench.pids[part], signal.SIGCONT)
        return moment

    return inject


def _router_gone(bench: Bench, rng: np.random.Generator) -> float:
    bench.router.kill()
    time.sleep(1.0)
    bench.router.start()
    return time.monotonic()  # nothing could be heard before


def _stalled(bench: Bench, rng: np.random.Generator) -> float:
    bench.link.stall(float(rng.uniform(0.1, 3.0)))
    return time.monotonic()


def _bursts(bench: Bench, rng: np.random.Generator) -> float:
    moment = time.monotonic()
    bench.link.burst(3.0)
    return moment


def _other(bench: Bench) -> ZenohTransport:
    """A session of someone else."""
    return ZenohTransport(ZenohSettings(endpoint=f"tcp/127.0.0.1:{bench.router.port}"))


def _stamps(late: float) -> Inject:
    def inject(bench: Bench, rng: np.random.Generator) -> float:
        other, moment = _other(bench), time.monotonic()
        publish = other.publisher(ODOMETRY, "nav_msgs/msg/Odometry")
        time.sleep(0.5)
        assert bench.last_odometry is not None
        message = other.decode(bench.last_odometry)
        message.header.stamp.sec += round(late)
        publish(message)
        time.sleep(0.2)
        other.close()
        return moment

    return inject


def _clock_jumps(bench: Bench, rng: np.random.Generator) -> float:
    other = _other(bench)
    publish = other.publisher("/clock", "rosgraph_msgs/msg/Clock")
    time.sleep(0.5)
    assert bench.last_odometry is not None
    stamp = other.decode(bench.last_odometry).header.stamp
    stamp.sec += 100
    moment = time.monotonic()
    for _ in range(20):
        publish(make("rosgraph_msgs/Clock", clock=stamp))
        time.sleep(0.01)
    other.close()
    return moment


def _corrupt(bench: Bench, rng: np.random.Generator) -> float:
    other, moment = _other(bench), time.monotonic()
    publish = other.raw_publisher(ODOMETRY, "nav_msgs/msg/Odometry")
    time.sleep(0.5)
    publish(b"\x00\x01\x00\x00" + rng.bytes(40))
    time.sleep(0.2)
    other.close()
    return moment


def _wrong_hash(bench: Bench, rng: np.random.Generator) -> float:
    other, moment = _other(bench), time.monotonic()
    key = other.keys.publication(Address(ODOMETRY, "nav_msgs/msg/Odometry", "RIHS01_" + "0" * 64))
    other._session.put(key, rng.bytes(100))
    time.sleep(0.2)
    other.close()
    return moment


def _full_disk(bench: Bench, rng: np.random.Generator) -> float:
    size = bench.recording.stat().st_size + 4096
    resource.prlimit(bench.pids["record"], resource.RLIMIT_FSIZE, (size, size))
    time.sleep(3.0)
    return time.monotonic()


def _second_commander(bench: Bench, rng: np.random.Generator) -> float:
    other = _other(bench)
    publish = other.publisher(COMMAND, "sensor_msgs/msg/Joy")
    time.sleep(0.5)
    message = other.types.empty("sensor_msgs/msg/Joy")
    message.axes = np.array((0.3, 0.0, 0.0), np.float32)
    moment = time.monotonic()
    for _ in range(25):
        publish(message)
        time.sleep(0.02)
    other.close()
    return moment


def _no_memory(part: str) -> Inject:
    def inject(bench: Bench, rng: np.random.Generator) -> float:
        moment, pid = time.monotonic(), bench.pids[part]
        resource.prlimit(pid, resource.RLIMIT_AS, (1 << 20, 1 << 20))
        return moment

    return inject
