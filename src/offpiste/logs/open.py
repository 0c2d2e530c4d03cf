"""Open a log: the format is recognised by its path."""

from pathlib import Path

from offpiste.errors import LogError
from offpiste.logs.log import LOG_FORMATS, Log
from offpiste.rig.clock import Clock


def open_log(path: str | Path, *, clock: Clock | None = None) -> Log:
    """Open a recorded drive of any registered format.

    Args:
        path: file or folder; a message lists the formats when none fits.
        clock: time column of a table and its unit; without one the column is guessed.

    Raises:
        LogError: no such path, unknown format, or a file that cannot be read.
    """
    path = Path(path)
    if not path.exists():
        raise LogError("no such file or folder", where=path)
    formats = [kind for _, kind in sorted(LOG_FORMATS.items())]
    # Formats from outside come first, and bags last: a folder of another format may hold a bag as well.
    shipped = [kind for kind in formats if kind.__module__.startswith("offpiste.")]
    for kind in (*(kind for kind in formats if kind not in shipped), *reversed(shipped)):
        if kind.recognises(path):
            return kind.open(path, clock or Clock())
    how = f"give {', '.join(kind.description for kind in formats)}"
    raise LogError("no known log format", where=path, how=how)
