"""Choose the reader for a path."""

from pathlib import Path

from offpiste.errors import LogError
from offpiste.logs.log import Log


def open_log(path: str | Path, *, clock_column: str = "", clock_unit: str = "s") -> Log:
    """Open a recorded drive of any known format.

    Args:
        path: TartanDrive or KITTI raw folder, ROS 1 `.bag`, ROS 2 `.mcap` or `.db3` or the folder of one, `.csv`,
            `.parquet`.
        clock_column, clock_unit: a table's time column and its unit; without a name it is guessed.

    Raises:
        LogError: no such path, unknown format, or a file that cannot be read.
    """
    from offpiste.logs.bag import BagLog
    from offpiste.logs.kitti import KittiLog
    from offpiste.logs.table import TableLog
    from offpiste.logs.tartandrive import TartanDriveLog

    path = Path(path)
    if not path.exists():
        raise LogError("no such file or folder", where=path)
    if KittiLog.recognises(path):
        return KittiLog(path)
    if TartanDriveLog.recognises(path):
        return TartanDriveLog(path)
    if TableLog.recognises(path):
        return TableLog(path, clock_column=clock_column, clock_unit=clock_unit)
    if BagLog.recognises(path):
        return BagLog(path)
    raise LogError(
        "no known log format",
        where=path,
        how="give a .bag, .mcap, .db3, .csv, .parquet, a ROS 2 bag folder, a TartanDrive 2 folder or a KITTI raw drive",
    )
