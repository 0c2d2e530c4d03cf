"""Simulation of the proving ground and the run time in lockstep, with faults of the sensors."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Literal, get_args

import numpy as np
from jaxtyping import Float

from offpiste.core.conventions import ACTUATORS, DT
from offpiste.core.geometry import yaw_rate_from_body_rates
from offpiste.core.progress import Track, track
from offpiste.logs.log import RawCloud
from offpiste.logs.measurements import Camera, Cloud, Image, Lidar, cloud_from_records
from offpiste.logs.ros.image_encodings import pixels_of
from offpiste.logs.ros.sensor_messages import points_from_message
from offpiste.logs.ros.writer import McapWriter
from offpiste.mapping.replay import ExtractFeatures
from offpiste.rig.rig import Rig
from offpiste.runtime.estimator import VehicleReading
from offpiste.runtime.modes import Controls
from offpiste.runtime.runtime import Runtime
from offpiste.simulation.messages import START_NS, events_message, stamp_ns
from offpiste.simulation.recorder import Imperfections, Recorder, with_noise
from offpiste.simulation.rendering.scene import Scene
from offpiste.simulation.sample import VehicleSample
from offpiste.simulation.sensors.suite import Sensing, SensorSuite
from offpiste.simulation.simulate import Start, drive
from offpiste.simulation.vehicle.parameters import VehicleParameters
from offpiste.simulation.world.world import World

Kind = Literal["none", "camera-dropped", "lidar-dropped", "late-image", "nan-features", "map-empty"]
KINDS: tuple[Kind, ...] = get_args(Kind)
When = Literal["time", "reversing"]
WHENS: tuple[When, ...] = get_args(When)
LATE = 0.8
"""Delay of late images [s]."""
BACKWARDS = 0.5
"""Rolling speed of the wheels above which the vehicle counts as reversing [m/s]."""
PLANNER_EVENTS = "/planner/events"
WITHOUT_PROGRESS = 12.0
"""Time without progress along the course after which a vehicle counts as stuck [s]."""


@dataclass
class Fault:
    """A lasting fault of the sensors, injected into a drive: lost or late messages, broken features or scans.

    It begins at `start` [s], or when the vehicle next reverses.
    """

    kind: Kind = "none"
    start: float = 10.0
    when: When = "time"
    _waiting: list[tuple[float, Image]] = field(default_factory=list)
    _began: bool = False
    _cleared: bool = False

    def notice(self, time: float, rolling: float) -> None:
        """Begin the fault if due, given the time since the start [s] and the rolling speed of the wheels [m/s]."""
        self._began |= time >= self.start and (self.when == "time" or rolling < -BACKWARDS)

    def passed(self, measured: Image | Cloud | None, time: float) -> list[Image | Cloud]:
        """Return the messages that reach the run time now."""
        arrived: list[Image | Cloud] = []
        while self._waiting and self._waiting[0][0] <= time + 1e-6:  # tolerance for rounding
            arrived.append(self._waiting.pop(0)[1])
        kind = self.kind if self._began else "none"
        if isinstance(measured, Image) and kind == "late-image":
            self._waiting.append((time + LATE, measured))
        elif isinstance(measured, Cloud) and kind == "map-empty":  # echoes far above the map
            arrived.append(replace(measured, points=measured.points + np.array((0.0, 0.0, 1000.0))))
        elif measured and kind != ("camera-dropped" if isinstance(measured, Image) else "lidar-dropped"):
            arrived.append(measured)
        return arrived

    def strike(self, runtime: Runtime) -> None:
        """Apply the fault to the run time itself: clear the map once."""
        if self.kind == "map-empty" and self._began and not self._cleared:
            self._cleared = True
            runtime.forget_map()

    def extractor(self, extract: ExtractFeatures) -> ExtractFeatures:
        """Wrap a feature extractor with the fault."""

        def faulty(pixels: np.ndarray) -> np.ndarray:
            features = extract(pixels)
            return np.full_like(features, np.nan) if self.kind == "nan-features" and self._began else features

        return faulty


@dataclass
class PlannerController:
    """Feeds noisy measurements to the run time and applies its controls to the vehicle (a `simulate.Controller`)."""

    runtime: Runtime
    rng: np.random.Generator
    controls: list[Controls] = field(default_factory=list)
    _best: float = 0.0
    _since: float = 0.0

    @property
    def arrived(self) -> bool:
        """True if the vehicle has stopped at the end of its course."""
        return self._stopped("end of the course")

    @property
    def stuck(self) -> bool:
        """True if backing out was given up, or a vehicle that neither waits nor backs out makes no progress."""
        late = bool(self.controls) and self.controls[-1].time - self._since > WITHOUT_PROGRESS
        return late or self._stopped("stuck")

    def _stopped(self, why: str) -> bool:
        return bool(self.controls) and (self.controls[-1].mode, self.controls[-1].why) == ("stopped", why)

    def command(self, sample: VehicleSample) -> Float[np.ndarray, " 4"]:
        """Return throttle, brake, steer and gear for the next `conventions.DT`."""
        self.runtime.vehicle(reading_of(with_noise(sample, Imperfections(), self.rng)))
        controls = self.runtime.step(time_of(sample.time))
        waits = controls.mode == "stopped" or controls.gear < 0
        if not self.controls or waits or self.runtime.course_tracker.progress > self._best + 1.0:
            self._best, self._since = self.runtime.course_tracker.progress, controls.time
        self.controls.append(controls)
        return np.append(controls.command, controls.gear)


@dataclass(frozen=True)
class Driving:
    """Record of a drive by the planner: vehicle states every `conventions.DT`, and the commands in the same rows."""

    samples: list[VehicleSample]
    controls: list[Controls]

    @property
    def from_first_throttle(self) -> "Driving":
        """Part of the drive from the first throttle on; before, the planner may still be loading."""
        first = next((row for row, each in enumerate(self.controls) if each.command[0] > 0), 0)
        return Driving(self.samples[first:], self.controls[first:])


def drive_planned(
    runtime: Runtime, world: World, parameters: VehicleParameters, start: Start, suite: SensorSuite, rig: Rig,
    out: Path, *, seconds: float, seed: int, fault: Fault, scene: Scene | None = None, track: Track = track,
) -> Driving:  # fmt: skip
    """Drive with a run time, and log every message and change of mode.

    Args:
        seed: seed of noise and light.
        fault: applied to what the run time receives, not to the log.
        scene: scene of the world, if available.
        track: progress display.
    """
    noise, light, own = (np.random.default_rng([seed, stream]) for stream in (1, 2, 3))
    sensing, lidars = Sensing(world, suite, light, scene=scene, apart=True), lidars_of(suite, rig)
    controller, written, samples = PlannerController(runtime, own), 0, list[VehicleSample]()
    steps = round(seconds / DT)
    with McapWriter(out) as writer:
        recorder = Recorder(writer, parameters.rolling_radius, noise)
        recorder.start(world, suite.mountings)
        drives = drive(world, parameters, start, controller, steps=steps)
        for _, sample in zip(track(range(steps), f"drive {out.name}"), drives, strict=False):
            samples.append(sample)
            recorder.vehicle(sample)
            fault.notice(sample.time, float(sample.wheel_speed.mean()))
            for event in runtime.events[written:]:
                stamp = stamp_ns(sample.time)
                writer.write(PLANNER_EVENTS, events_message((f"{event.mode}: {event.why}",), stamp), stamp)
            written = len(runtime.events)
            with runtime.watch.of("simulated sensors"):
                messages = sensing.observe(sample, recorder.sensor_stamp_ns)
            for topic, message in messages:
                recorder.sensor(topic, message)
                for measured in fault.passed(measurement_of(message, lidars), sample.time):
                    runtime.image(measured) if isinstance(measured, Image) else runtime.scan(measured)
            fault.strike(runtime)
            if controller.arrived:
                break
    return Driving(samples, controller.controls)


def measurement_of(message: Any, lidars: Mapping[str, Lidar]) -> Image | Cloud | None:
    """Convert a message to an image or a cloud; None for calibrations."""
    name = message.header.frame_id
    stamp = message.header.stamp.sec + 1e-9 * message.header.stamp.nanosec
    if hasattr(message, "format"):
        return Image(stamp, name, np.asarray(pixels_of(message, name), np.uint8))
    if name in lidars:
        return cloud_from_records(RawCloud(stamp, name, points_from_message(message)), lidars[name])
    return None


def time_of(time: float) -> float:
    """Convert the time since the start of the drive to a stamp [s]."""
    return START_NS * 1e-9 + round(time / DT) * DT


def reading_of(sample: VehicleSample) -> VehicleReading:
    """Convert a sample to a reading for the run time."""
    rate = float(yaw_rate_from_body_rates(sample.orientation[None], sample.angular_velocity[None])[0])
    measured = {
        "brake": sample.brake_pressure,
        "steer": sample.steer_angle,
        "steer_rate": sample.steer_rate,
        "engine_rpm": sample.engine_speed / 1000,
    }
    actuators = np.array([measured.get(name, np.nan) for name in ACTUATORS])
    return VehicleReading(time_of(sample.time), sample.position, sample.orientation, sample.velocity, rate, actuators)


def cameras_of(suite: SensorSuite, rig: Rig) -> dict[str, Camera]:
    """Return the cameras of the vehicle by name."""
    return {c.name: Camera(c.name, c.model, c.body_from_sensor.matrix, rig.cameras[c.name]) for c in suite.cameras}


def lidars_of(suite: SensorSuite, rig: Rig) -> dict[str, Lidar]:
    """Return the LiDARs of the vehicle by name."""
    return {s.name: Lidar(s.name, s.body_from_sensor.matrix, rig.lidars[s.name]) for s in suite.lidars}
