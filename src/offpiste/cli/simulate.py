"""`offpiste simulate`."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import tyro

from offpiste.cli.entry import COMMANDS
from offpiste.cli.live import RobotOptions
from offpiste.cli.next_steps import next_line

if TYPE_CHECKING:
    from offpiste.simulation.simulate import DriveSettings

_NOT_LIVE = (
    "out", "drives", "drive_seed", "manoeuvres", "mounting_turn", "pose_drift", "extrinsic_error", "stamp_offset",
    "processes", "cluster",
)  # fmt: skip
"""Options of recorded drives only."""


@COMMANDS.register("simulate")
@dataclass(frozen=True)
class Simulate:
    """Simulate a drive on the proving ground and record it as an MCAP log (needs the extra `sim`)."""

    out: Path = Path("drive.mcap")
    """Log to write, or folder of several --drives."""
    world: str = "mojave"
    """Name of a world, or a TOML file; an unknown name lists the available worlds."""
    seconds: float = 60.0
    """Duration of the drive [s]; it ends early if the vehicle rolls over or gets stuck."""
    seed: int = 0
    """Seed of the world, the driver and the noise."""
    drives: int = 1
    """Number of drives, with consecutive seeds from --seed and a world each; existing drives are kept."""
    drive_seed: int | None = None
    """Seed of driver and noise, for a different drive in the same world."""
    sensors: Literal["full", "light", "none"] = "light"
    """full: four cameras and two LiDARs; light: one of each at lower rate and resolution; none."""
    manoeuvres: bool = False
    """Let the driver also stop, crawl, reverse, rock the vehicle free and drive fast (rig proving_ground_gear)."""
    vehicle: str = ""
    """TOML file of another vehicle (docs/proving-ground.md); its rig is written next to the log."""
    mounting_turn: float = 0.0
    """Rotation of each sensor from its usual mounting about a random axis, as the log states [degrees]."""
    grip_contrast: float = 1.0
    """Contrast of grip between kinds of ground; 0: all ground has the same grip."""
    appearance_noise: float = 1.0
    """Scale of appearance variations that are unrelated to grip."""
    pose_noise: float = 0.0
    """Additional white noise of recorded positions [m]."""
    pose_drift: float = 0.0
    """Drift of recorded poses per minute [m and degrees]."""
    extrinsic_error: float = 0.0
    """Angle between recorded and true mounting of each sensor [degrees]."""
    stamp_offset: float = 0.0
    """Delay of the stamps of cameras and LiDARs [ms]."""
    processes: int = 0
    """Number of drives recorded in parallel; 0: one per core."""
    cluster: str = ""
    """Record several drives on a Ray cluster (extra `ray`): auto, or HOST:PORT of its head."""

    live: bool = False
    """Simulate a robot in real time for `offpiste live proving_ground --drive` (extra `live`).

    Only world, seconds, seed, sensors, vehicle, pose noise, contrast and appearance of the options above apply."""
    speed: float = 5.0
    """Target speed of the course of --live [m/s]."""
    robot: Annotated[RobotOptions, tyro.conf.OmitArgPrefixes] = field(default_factory=RobotOptions)

    def run(self) -> int:
        """Record one or several drives, or simulate a live robot."""
        from offpiste.core.errors import OffpisteError
        from offpiste.core.files import check_folder
        from offpiste.core.parallel import at_a_time
        from offpiste.core.progress import show
        from offpiste.simulation.simulate import Recording, simulate, simulate_all

        if self.live:
            self._run_live()
            return 0
        if self.drives < 1:
            raise OffpisteError(f"{self.drives} drives", where="--drives", how="give 1 or more")
        if self.drives == 1:
            seed = self.seed if self.drive_seed is None else self.drive_seed
            simulate(self._settings(self.seed, seed), self.out)
            rig = self._rig(self.out.with_suffix(".rig.toml"))
        elif self.drive_seed is None:
            check_folder(self.out, own=("*.mcap",))
            processes = at_a_time(self.processes)
            self.out.mkdir(parents=True, exist_ok=True)
            seeds, name = range(self.seed, self.seed + self.drives), Path(self.world).stem
            recordings = [Recording(self._settings(seed, seed), self.out / f"{name}-{seed}.mcap") for seed in seeds]
            simulate_all(recordings, processes, self.cluster)
            rig = self._rig(self.out / "rig.toml")
        else:
            raise OffpisteError("--drive-seed cannot be combined with --drives", how="leave out one of them")
        show(next_line("inspect", self.out, "--rig", rig))
        return 0

    def _run_live(self) -> None:
        from offpiste.core.errors import OffpisteError
        from offpiste.live.simulated_robot import simulate_live

        ignored = [name for name in _NOT_LIVE if getattr(self, name) != getattr(Simulate, name)]
        if ignored:
            options = " and ".join(f"--{name.replace('_', '-')}" for name in ignored)
            raise OffpisteError(f"{options} would do nothing", where="--live", how="leave it out")
        simulate_live(
            self._settings(self.seed, self.seed).world, self.robot.settings(), sensors=self.sensors,
            seconds=self.seconds, speed=self.speed, vehicle=self.vehicle, pose_noise=self.pose_noise,
        )  # fmt: skip

    def _rig(self, path: Path) -> str:
        """Return the rig of the drives: a preset, or a file written for another vehicle."""
        preset = "proving_ground_gear" if self.manoeuvres else "proving_ground"
        if not self.vehicle:
            return preset
        from offpiste.core.files import write_text
        from offpiste.simulation.vehicle.parameters import vehicle_rig

        write_text(path, vehicle_rig(preset, Path(self.vehicle)))
        return str(path)

    def _settings(self, world_seed: int, seed: int) -> "DriveSettings":
        from offpiste.simulation.driver.driver import WITH_MANOEUVRES, DriverSettings
        from offpiste.simulation.recorder import Imperfections
        from offpiste.simulation.simulate import DriveSettings
        from offpiste.simulation.world.world import WorldSettings

        world = WorldSettings(self.world, world_seed, self.grip_contrast, self.appearance_noise)
        imperfections = Imperfections(self.pose_noise, self.pose_drift, self.extrinsic_error, self.stamp_offset)
        driver = WITH_MANOEUVRES if self.manoeuvres else DriverSettings()
        return DriveSettings(
            world, self.seconds, seed, self.sensors, self.mounting_turn, driver, imperfections, self.vehicle
        )
