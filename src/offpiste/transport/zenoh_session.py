"""Zenoh sessions and their configuration, and a router that outlives the process that started it."""

import json
import multiprocessing
import os
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from multiprocessing.connection import Connection
from typing import Any, Final, Literal

from offpiste.core.errors import TransportError, extra
from offpiste.core.signals import group_signals_blocked, ignore_group_signals

ROUTER: Final = "tcp/127.0.0.1:7447"
"""Default endpoint of rmw_zenoh's router on the loopback interface."""
OUTLIVES: Final = 10.0
"""Time that a router outlives its parent process, so that the vehicle can be stopped [s]."""
Mode = Literal["client", "router", "part"]
"""See `ZenohSettings`."""
_STARTS: Final = 60.0
"""Time limit for starting a router process [s]."""


def opened_session(endpoint: str, mode: Mode, file: str) -> Any:
    """Open a session (arguments as in `ZenohSettings`; errors as of `ZenohTransport`)."""
    with extra("live"):
        import zenoh

    zenoh.init_log_from_env_or("off")
    where = file or endpoint or ROUTER
    try:
        return zenoh.open(configuration(endpoint, mode, file))
    except (zenoh.ZError, ValueError, OSError) as error:
        reason = " ".join(str(error).split(" at /")[0].split())[:200]  # without the line of zenoh's source
        if mode == "router":
            raise TransportError(f"cannot be a router there: {reason}", where=where, how="end the other one") from error
        how = "start the robot's router (ros2 run rmw_zenoh_cpp rmw_zenohd), or give --router"
        raise TransportError(f"no connection: {reason}", where=where, how=how) from error


def configuration(endpoint: str, mode: Mode, file: str) -> Any:
    """Return the configuration: arguments, then the file, then defaults that neither listen nor scout."""
    import zenoh

    config, unset = zenoh.Config.from_file(file) if file else zenoh.Config(), zenoh.Config()

    def default(key: str, value: str) -> None:
        if config.get_json(key) == unset.get_json(key):
            config.insert_json5(key, value)

    if mode != "client":
        config.insert_json5("mode", '"router"' if mode == "router" else '"client"')
    default("mode", '"client"')
    is_client = config.get_json("mode") == '"client"'
    default("scouting/multicast/enabled", "false")
    default("scouting/gossip/enabled", "false")
    default("transport/shared_memory/enabled", "false")  # unused, and killed processes would leave files
    default("timestamping/enabled", "true")  # publishers that keep their last message need it
    side = "listen/endpoints" if mode == "router" else "connect/endpoints"
    if endpoint:
        config.insert_json5(side, f'["{endpoint}"]')
    elif mode == "router" or is_client:
        default(side, f'["{ROUTER}"]')
    if mode == "part":
        config.insert_json5("listen/endpoints", "[]")
    default("listen/endpoints", "[]")
    if is_client:
        default("connect/timeout_ms", "3000")
        default("connect/retry", "{period_init_ms: 200, period_max_ms: 1000, period_increase_factor: 2}")
    return config


@contextmanager
def router_process(endpoint: str, file: str) -> Iterator[str]:
    """Run a router in its own process and yield its endpoint for this computer.

    It ends with the context, or `OUTLIVES` seconds after its parent process. Raises `TransportError`.
    """
    context = multiprocessing.get_context("spawn")
    ours, its = context.Pipe()
    process = context.Process(target=_serve, args=(endpoint, file, its), name="offpiste router", daemon=True)
    with group_signals_blocked():  # a signal to the group must not end it before the vehicle is stopped
        process.start()
    its.close()
    try:
        said = None
        with suppress(EOFError):
            said = ours.recv() if ours.poll(_STARTS) else None
        if isinstance(said, TransportError):
            raise said
        if said is None:
            raise TransportError("the router did not start", where=file or endpoint or ROUTER, how="start it again")
        yield said
    finally:
        with suppress(OSError):
            ours.send("end")
        process.join(3.0)
        process.kill()


def _serve(endpoint: str, file: str, pipe: Connection) -> None:
    """Run the router until asked to end, or until `OUTLIVES` seconds after the parent's end."""
    ignore_group_signals()
    os.setsid()  # the stop goes through it even if a signal to the group ends all others
    try:
        session = opened_session(endpoint, "router", file)
    except TransportError as error:
        pipe.send(error)
        return
    try:
        pipe.send(endpoint or _reached_at(file))
        pipe.recv()
    except (EOFError, OSError):
        time.sleep(OUTLIVES)
    session.close()


def _reached_at(file: str) -> str:
    """Return the endpoint by which this computer reaches the router configured in a file."""
    listens: Any = json.loads(configuration("", "router", file).get_json("listen/endpoints"))
    if isinstance(listens, dict):  # by mode
        listens = listens["router"]
    return str(listens[0]).replace("/0.0.0.0:", "/127.0.0.1:").replace("/[::]:", "/127.0.0.1:")
