"""`offpiste simulate`."""

from dataclasses import dataclass, field
from pathlib import Path
from shlex import quote
from typing import TYPE_CHECKING, Annotated, Literal

import tyro

from offpiste.cli.entry import COMMANDS
from offpiste.cli.robot_options import RobotOptions

if TYPE_CHECKING:
    from offpiste.simulation.simulate import DriveSettings

_NOT_LIVE = (
    "out", "drives", "drive_seed", "manoeuvres", "mounting_turn", "twins", "pose_drift", "extrinsic_error",
    "stamp_offset", "processes", "cluster",
)  # fmt: skip
"""Options of recorded drives alone."""


@COMMANDS.register("simulate")
@dataclass(frozen=True)
class Simulate:
    """Record a drive on the proving ground, in a world made from a seed, as an MCAP log (needs the extra `sim`)."""

    out: Path = Path("drive.mcap")
    """The log, with twins beside it; or the folder of several drives."""
    world: str = "mojave"
    """Name of a world, or a TOML file of your own; an unknown name lists those there are."""
    seconds: float = 60.0
    """Length of the drive [s]; one that rolls over or gets stuck ends early."""
    seed: int = 0
    """Seed of the world, the driver and all noise."""
    drives: int = 1
    """Drives to record; several have the seeds from --seed on, each a world of its own. It resumes."""
    drive_seed: int | None = None
    """Seed of the driver and the noise, for another drive in the same world."""
    sensors: Literal["full", "light", "none"] = "light"
    """Four cameras and two LiDARs; one of each, slower; or none."""
    manoeuvres: bool = False
    """The driver also stops, crawls, reverses, rocks free and drives fast stretches (rig proving_ground_gear)."""
    vehicle: str = ""
    """A TOML file of another vehicle than the side-by-side (docs/proving-ground.md); its rig is written beside."""
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
    processes: int = 0
    """How many of several drives are recorded at a time; 0: one a core."""
    cluster: str = ""
    """Record several drives on a Ray cluster instead (extra `ray`): auto, or HOST:PORT of its head."""

    live: bool = False
    """In real time, as a robot: `offpiste live proving_ground --drive` drives it along a course (extra `live`).

    Only world, seconds, seed, sensors, vehicle, pose noise, contrast and appearance of the above apply."""
    speed: float = 5.0
    """Speed that the course of --live is chosen for [m/s]."""
    robot: Annotated[RobotOptions, tyro.conf.OmitArgPrefixes] = field(default_factory=RobotOptions)

    def run(self) -> int:
        """Make a world, drive through it, record."""
        if self.live:
            return self._run_live()
        from offpiste.core.errors import OffpisteError
        from offpiste.core.progress import show
        from offpiste.simulation.simulate import simulate

        if self.drives == 1:
            seed = self.seed if self.drive_seed is None else self.drive_seed
            simulate(self._settings(self.seed, seed), self.out, twins=self.twins)
            rig = self._rig(self.out.with_suffix(".rig.toml"))
            show(f"next: offpiste inspect {quote(str(self.out))} --rig {rig}")
            return 0
        if self.drives < 1:
            raise OffpisteError(f"{self.drives} drives", where="--drives", how="give 1 or more")
        if self.twins or self.drive_seed is not None:
            raise OffpisteError("--drives goes with neither --twins nor --drive-seed", how="leave them out")
        self._record_all()
        return 0

    def _run_live(self) -> int:
        from offpiste.core.errors import OffpisteError
        from offpiste.live.simulated_robot import simulate_live

        if ignored := [
            f"--{name.replace('_', '-')}" for name in _NOT_LIVE if getattr(self, name) != getattr(Simulate, name)
        ]:
            raise OffpisteError(f"{' and '.join(ignored)} would do nothing", where="--live", how="leave it out")
        world = self._settings(self.seed, self.seed).world
        robot = self.robot.settings()
        simulate_live(
            world, robot, sensors=self.sensors, seconds=self.seconds, speed=self.speed, vehicle=self.vehicle,
            pose_noise=self.pose_noise,
        )  # fmt: skip
        return 0

    def _record_all(self) -> None:
        from offpiste.core.files import check_folder
        from offpiste.core.parallel import at_a_time
        from offpiste.core.progress import show
        from offpiste.simulation.recordings import Recording, simulate_all

        check_folder(self.out, own=("*.mcap",))
        processes = at_a_time(self.processes)
        self.out.mkdir(parents=True, exist_ok=True)
        name = Path(self.world).stem
        seeds = range(self.seed, self.seed + self.drives)
        recordings = [Recording(self._settings(seed, seed), self.out / f"{name}-{seed}.mcap") for seed in seeds]
        simulate_all(recordings, processes, self.cluster)
        rig = self._rig(self.out / "rig.toml")
        show(f"next: offpiste inspect {quote(str(self.out))}/*.mcap --rig {rig}")

    def _rig(self, path: Path) -> str:
        """The rig that reads the drives: a preset, or a file that is written for another vehicle."""
        preset = "proving_ground_gear" if self.manoeuvres else "proving_ground"
        if not self.vehicle:
            return preset
        from offpiste.core.files import write_text
        from offpiste.simulation.vehicle.vehicle_rig import vehicle_rig

        write_text(path, vehicle_rig(preset, Path(self.vehicle)))
        return quote(str(path))

    def _settings(self, world_seed: int, seed: int) -> "DriveSettings":
        from offpiste.simulation.driver.driver import WITH_MANOEUVRES, DriverSettings
        from offpiste.simulation.sensors.imperfections import Imperfections
        from offpiste.simulation.simulate import DriveSettings
        from offpiste.simulation.world.world import WorldSettings

        world = WorldSettings(self.world, world_seed, self.grip_contrast, self.appearance_noise)
        imperfections = Imperfections(self.pose_noise, self.pose_drift, self.extrinsic_error, self.stamp_offset)
        driver = WITH_MANOEUVRES if self.manoeuvres else DriverSettings()
        return DriveSettings(
            world, self.seconds, seed, self.sensors, self.mounting_turn, driver, imperfections, self.vehicle
        )
