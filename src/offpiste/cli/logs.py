"""Commands about drives: record one, judge one, look at one."""

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import tyro

from offpiste.errors import RigError
from offpiste.progress import show


@dataclass(frozen=True)
class Simulate:
    """Record a drive on the proving ground: an off-road vehicle in a world made from a seed, as an MCAP log."""

    out: Path = Path("drive.mcap")
    """The log; twins are written beside it."""
    world: str = "mojave"
    """mojave, halter-ranch, dunes, coastal-scrub, or uniform (where looks vary and grip does not)."""
    seconds: float = 60.0
    """A drive that rolls over or gets stuck ends early."""
    seed: int = 0
    """Of the world, the driver and all noise."""
    drive_seed: int | None = None
    """Another drive in the same world."""
    sensors: Literal["full", "light", "none"] = "light"
    """Four cameras and two LiDARs; one of each, slower; or none."""
    twins: int = 0
    """Further drives with the same start and commands on other ground."""
    grip_contrast: float = 1.0
    """1: ground as tables have it; 0: all ground drives alike."""
    appearance_noise: float = 1.0
    """How far looks vary without meaning anything for grip."""
    pose_noise: float = 0.0
    """White noise of recorded positions [m]."""
    pose_drift: float = 0.0
    """Drift of recorded poses in a minute [m and degrees]."""
    extrinsic_error: float = 0.0
    """Angle between recorded and true mountings of sensors [degrees]."""
    stamp_offset: float = 0.0
    """How much too late cameras and LiDARs are stamped [ms]."""

    def run(self) -> int:
        """Make a world, drive through it, record."""
        from offpiste.simulation.sensors.imperfections import Imperfections
        from offpiste.simulation.simulate import DriveSettings, simulate
        from offpiste.simulation.world.world import WorldSettings

        world = WorldSettings(self.world, self.seed, self.grip_contrast, self.appearance_noise)
        flaws = Imperfections(self.pose_noise, self.pose_drift, self.extrinsic_error, self.stamp_offset)
        seed = self.seed if self.drive_seed is None else self.drive_seed
        settings = DriveSettings(world, self.seconds, seed, self.sensors, imperfections=flaws)
        simulate(settings, self.out, twins=self.twins)
        return 0


@dataclass(frozen=True)
class Inspect:
    """What a careful engineer would find out first about a log; exit code 1 if it is unusable for training."""

    log: tyro.conf.Positional[str]
    """A .bag, .mcap, .db3, .csv, .parquet, a ROS 2 bag folder or a TartanDrive 2 folder."""
    rig: str | None = None
    """A preset's name or a rig file; without one, the log is judged by what it shows."""
    write_rig: Path | None = None
    """Write a first rig for this log to a new file."""
    json: bool = False
    """Print findings for machines."""

    def run(self) -> int:
        """Inspect, print, judge."""
        from json import dumps

        from offpiste.files import write_text
        from offpiste.inspection.draft_rig import draft_rig
        from offpiste.inspection.draft_sensors import missing
        from offpiste.inspection.inspect import inspect_log, render
        from offpiste.logs import open_log
        from offpiste.rig.rig import Clock, load_rig

        rig = load_rig(self.rig) if self.rig else None
        clock = rig.clock if rig else Clock()
        log = open_log(self.log, clock_column=clock.column, clock_unit=clock.unit)
        if self.write_rig and self.write_rig.exists():
            raise RigError("is there already", where=self.write_rig, how="give --write-rig a new name")
        if self.write_rig:
            drafted = draft_rig(log)
            write_text(self.write_rig, drafted)
            for line in (f"wrote {self.write_rig}", *(f"  missing: {what}" for what in missing(drafted))):
                print(line, file=sys.stderr)  # noqa: T201
        inspection = inspect_log(log, rig)
        if rig is not None and inspection.usable:
            from offpiste.inspection.sensors import check_sensors

            inspection = inspection.with_findings(check_sensors(log, rig))
        show(dumps(inspection.as_dict(), indent=2) if self.json else render(inspection))
        return 0 if inspection.usable else 1


@dataclass(frozen=True)
class View:
    """Look at a log or a dataset: pictures, a Rerun recording of a log, and the report of a dataset's features."""

    path: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="LOG|DATASET")]
    """A drive with LiDARs, or what `extract` wrote."""
    rig: str | None = None
    """Of a log: a preset's name or a rig file."""
    pca: Path | None = None
    """Of a log: a file that `fit-pca` wrote; without one there are no features, and ground is grey."""
    out: Path = Path("view")
    """Folder of the pictures."""
    seconds: str = ""
    """Of a log: a stretch A:B, A: or :B, in seconds after the first pose."""
    rrd: bool = True
    """Of a log: also write drive.rrd for the Rerun viewer (needs the extra `view`)."""
    device: str = "cpu"
    """Where the backbone runs."""

    def run(self) -> int:
        """Play back or open, draw, write."""
        from offpiste.visualization.view import view

        written = view(
            self.path,
            self.out,
            rig=self.rig,
            pca=self.pca,
            seconds=self.seconds,
            rrd=self.rrd,
            device=self.device,
        )
        show(f"wrote {', '.join(map(str, written))}")
        return 0
