"""The stretch of a log that is looked at."""

import numpy as np

from offpiste.errors import LogError


def parse_stretch(text: str) -> tuple[float, float]:
    """First and last second after the log's first pose, from "A:B", "A:" or ":B" [s]; all of it from "".

    Raises:
        LogError: not such a text, or nothing between.
    """
    first, colon, last = (text or ":").partition(":")
    try:
        start, end = float(first or 0.0), float(last or np.inf)
        if colon and 0 <= start < end:
            return start, end
    except ValueError:
        pass
    raise LogError(f"not a stretch: '{text}'", how="write --seconds A:B, A: or :B, seconds after the log's first pose")
