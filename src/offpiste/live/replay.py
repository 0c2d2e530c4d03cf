"""The replay of a log without a transport: what the run time would have commanded."""

from collections.abc import Callable, Iterator

from offpiste.live.driver import Heard, Step, StepDriver
from offpiste.live.log_steps import RecordedDrive
from offpiste.transport.message_types import MessageTypes


def replayed(drive: RecordedDrive, driver: StepDriver, types: MessageTypes) -> Iterator[tuple[float, Step | None]]:
    """Time of each step [s], and what it came to; messages that cannot be decoded are left out."""
    for step in drive.steps():
        now = step.time / 10**9
        heard = []
        for one in step.messages:
            message = decoded(types, one.type, one.data)
            if message is not None:
                heard.append(Heard(one.topic, message, now))
        yield now, driver.step(heard, now)


def decoded(types: MessageTypes, msgtype: str, data: bytes) -> object | None:
    """A message; None where it cannot be decoded, as the transport refuses it."""
    try:
        return types.store.deserialize_cdr(data, msgtype)
    except Exception:  # noqa: BLE001 - whatever damaged bytes make rosbags raise
        return None


OnStep = Callable[[float, Step | None], None]
"""Is given each step: its time [s], and what it came to."""
