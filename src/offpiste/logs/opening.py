"""Opening a log of any format."""

from pathlib import Path
from shlex import quote

from offpiste.core.errors import LogError, SeveralLogs
from offpiste.core.object_store import refuse_url
from offpiste.logs.log import LOG_FORMATS, Log, contents_of
from offpiste.rig.channels import Clock

_LISTED = 5
"""How many logs of a folder a message names."""
_EXPORTED_BY = {
    ".ulg": "ulog2csv (pyulog), and give the folder of its tables",
    ".bin": "ArduPilot's mavlogdump.py (pymavlink) as CSV",
    ".mf4": "asammdf as CSV or Parquet",
    ".blf": "python-can and the DBC as CSV",
    ".h5": "pandas as Parquet",
    ".mat": "scipy.io.loadmat and pandas as Parquet",
}
"""What reads logs of other formats, by their ending."""


def open_log(path: str | Path, *, clock: Clock | None = None) -> Log:
    """Open a recorded drive of any registered format.

    Args:
        path: file or folder; a message lists the formats when none fits.
        clock: time column of a table and its unit; without one the column is guessed.

    Raises:
        SeveralLogs: a folder of logs.
        LogError: no such path, unknown format, or a file that cannot be read.
    """
    refuse_url(path)
    path = Path(path)
    if not path.exists():
        raise LogError("no such file or folder", where=path)
    formats = [kind for _, kind in sorted(LOG_FORMATS.items())]
    # Formats from outside come first, and bags last: a folder of another format may hold a bag as well.
    shipped = [kind for kind in formats if kind.__module__.startswith("offpiste.")]
    for kind in (*(kind for kind in formats if kind not in shipped), *reversed(shipped)):
        if kind.recognises(path):
            return kind.open(path, clock or Clock())
    logs, others = contents_of(path) if path.is_dir() else ([], [])
    if logs:
        more = f" and {len(logs) - _LISTED} more" if len(logs) > _LISTED else ""
        what = f"a folder of logs: {', '.join(logs[:_LISTED])}{more}"
        how = f"give one of them, or inspect all: offpiste inspect {quote(str(path))}"
        raise SeveralLogs(what, where=path, how=how, logs=logs, others=others)
    how = f"give {', '.join(kind.description for kind in formats)}"
    if by := _EXPORTED_BY.get(path.suffix.lower()):
        how = f"export it by {by}"
    raise LogError("no known log format", where=path, how=how)
