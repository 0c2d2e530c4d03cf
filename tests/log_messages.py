"""Log messages of offpiste in a test."""

import logging
from collections.abc import Iterator
from contextlib import contextmanager


class _Keeper(logging.Handler):
    def __init__(self) -> None:
        super().__init__()
        self.messages: list[object] = []

    def emit(self, record: logging.LogRecord) -> None:
        self.messages.append(record.msg)


@contextmanager
def logged() -> Iterator[list[object]]:
    """The messages that offpiste logs within, lines and tables as they were given."""
    logger, keeper = logging.getLogger("offpiste"), _Keeper()
    before = logger.level
    logger.setLevel(logging.INFO)
    logger.addHandler(keeper)
    try:
        yield keeper.messages
    finally:
        logger.removeHandler(keeper)
        logger.setLevel(before)
