"""`offpiste simulate`."""

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from offpiste.cli.entry import COMMANDS


@COMMANDS.register("simulate")
@dataclass(frozen=True)
class Simulate:
    """Record a drive on the proving ground, in a world made from a seed, as an MCAP log (needs the extra `sim`)."""

    out: Path = Path("drive.mcap")
    """The log; twins are written beside it."""
    world: str = "mojave"
    """Name of a world, or a TOML file of your own; an unknown name lists those there are."""
    seconds: float = 60.0
    """Length of the drive [s]; one that rolls over or gets stuck ends early."""
    seed: int = 0
    """Seed of the world, the driver and all noise."""
    drive_seed: int | None = None
    """Seed of the driver and the noise, for another drive in the same world."""
    sensors: Literal["full", "light", "none"] = "light"
    """Four cameras and two LiDARs; one of each, slower; or none."""
    mounting_turn: float = 0.0
    """Angle by which each sensor is turned about a random axis from its usual mounting; the log says so [degrees]."""
    twins: int = 0
    """Further drives with the same start and commands on other ground."""
    grip_contrast: float = 1.0
    """1: ground as tables have it; 0: all ground drives alike."""
    appearance_noise: float = 1.0
    """How far looks vary without any effect on grip."""
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
        from offpiste.progress import show
        from offpiste.simulation.sensors.imperfections import Imperfections
        from offpiste.simulation.simulate import DriveSettings, simulate
        from offpiste.simulation.world.world import WorldSettings

        world = WorldSettings(self.world, self.seed, self.grip_contrast, self.appearance_noise)
        imperfections = Imperfections(self.pose_noise, self.pose_drift, self.extrinsic_error, self.stamp_offset)
        seed = self.seed if self.drive_seed is None else self.drive_seed
        settings = DriveSettings(
            world, self.seconds, seed, self.sensors, self.mounting_turn, imperfections=imperfections
        )
        simulate(settings, self.out, twins=self.twins)
        show(f"next: offpiste inspect {self.out} --rig proving_ground")
        return 0
