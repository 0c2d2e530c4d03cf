"""The proving ground and the run time in lockstep: a drive by the planner, recorded like any drive."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from offpiste.closed_loop.faults import Fault
from offpiste.core.conventions import ACTUATORS, DT
from offpiste.core.geometry import yaw_rate_from_body_rates
from offpiste.core.progress import Track, track
from offpiste.logs.log import RawCloud
from offpiste.logs.measurements import Camera, Cloud, Image, Lidar, cloud_from_records
from offpiste.logs.ros.image_encodings import pixels_of
from offpiste.logs.ros.sensor_messages import points_from_message
from offpiste.logs.ros.writer import McapWriter
from offpiste.rig.rig import Rig
from offpiste.runtime.estimator import VehicleReading
from offpiste.runtime.modes import Controls
from offpiste.runtime.runtime import Runtime
from offpiste.simulation.recorder import START_NS, Recorder, events_message, stamp_ns
from offpiste.simulation.rendering.scene import Scene
from offpiste.simulation.sample import Pose, VehicleSample
from offpiste.simulation.sensors.imperfections import Imperfections, Noise, with_noise
from offpiste.simulation.sensors.suite import Sensing, SensorSuite
from offpiste.simulation.simulate import Start, drive
from offpiste.simulation.vehicle.parameters import VehicleParameters
from offpiste.simulation.world.world import World

PLANNER_EVENTS = "/planner/events"
GAVE_UP = ("stopped", "stuck")
"""Mode, and why, once backing out was given up."""
WITHOUT_PROGRESS = 12.0
"""Time without progress along the course after which a vehicle counts as stuck [s]."""


@dataclass
class PlannerController:
    """Passes readings to the run time and its controls to the vehicle (a `simulation.simulate.Controller`).

    Attributes:
        rng: noise of the readings.
        timeout: the drive ends after this time without progress, unless the vehicle is stopped or backs out [s].
    """

    runtime: Runtime
    rng: np.random.Generator
    timeout: float = WITHOUT_PROGRESS
    controls: list[Controls] = field(default_factory=list)
    _best: float = 0.0
    _since: float = 0.0

    @property
    def arrived(self) -> bool:
        """Whether the vehicle is at a standstill at the end of its course."""
        last = self.controls[-1] if self.controls else None
        return last is not None and last.mode == "stopped" and last.why == "end of the course"

    @property
    def stuck(self) -> bool:
        """Whether the vehicle has made no progress for `timeout`, or backing out was given up."""
        last = self.controls[-1] if self.controls else None
        return last is not None and (last.time - self._since > self.timeout or (last.mode, last.why) == GAVE_UP)

    def command(self, sample: VehicleSample) -> Float[np.ndarray, " 4"]:
        """Throttle, brake, steering and gear for the next `conventions.DT`."""
        self.runtime.vehicle(reading_of(with_noise(sample, Noise(), Imperfections(), self.rng)))
        controls = self.runtime.command(time_of(sample.time))
        waits = controls.mode == "stopped" or controls.gear < 0
        if not self.controls or waits or self.runtime.course_tracker.progress > self._best + 1.0:
            self._best, self._since = self.runtime.course_tracker.progress, controls.time
        self.controls.append(controls)
        return np.append(controls.command, controls.gear)


@dataclass(frozen=True)
class Driving:
    """A drive by the planner.

    Attributes:
        samples: states of the vehicle, every `conventions.DT`.
        controls: commands in the same rows.
    """

    samples: list[VehicleSample]
    controls: list[Controls]

    @property
    def from_first_throttle(self) -> "Driving":
        """What follows the first throttle, or all: before it, what makes the plans may still be loading."""
        first = next((row for row, each in enumerate(self.controls) if each.command[0] > 0), 0)
        return Driving(self.samples[first:], self.controls[first:])


def drive_planned(
    runtime: Runtime,
    world: World,
    parameters: VehicleParameters,
    start: Start,
    suite: SensorSuite,
    rig: Rig,
    out: Path,
    *,
    seconds: float,
    seed: int,
    fault: Fault | None = None,
    scene: Scene | None = None,
    track: Track = track,
) -> Driving:
    """Let the run time drive, and log every message and every change of mode.

    Args:
        fault: applied to what the run time receives; the log has what the sensors sent.
        seed: seed of noise and light.
        scene: built from the world; None to build it here.
        track: shows progress over the steps.
    """
    noise, light, own = (np.random.default_rng([seed, stream]) for stream in (1, 2, 3))
    sensing, lidars = Sensing(world, suite, light, scene=scene, apart=True), lidars_of(suite, rig)
    controller, written, samples = PlannerController(runtime, own), 0, list[VehicleSample]()
    fault = fault or Fault()
    with McapWriter(out) as writer:
        recorder = Recorder(writer, wheel_radius=parameters.rolling_radius, rng=noise)
        recorder.start(world, suite.mountings())
        drives = drive(world, parameters, start, controller, steps=round(seconds / DT))
        for _, sample in zip(track(range(round(seconds / DT)), f"drive {out.name}"), drives, strict=False):
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
    """Image or cloud of a camera's or LiDAR's message; None for calibrations."""
    name = message.header.frame_id
    stamp = message.header.stamp.sec + 1e-9 * message.header.stamp.nanosec
    if hasattr(message, "format"):
        return Image(stamp, name, np.asarray(pixels_of(message, name), np.uint8))
    if name in lidars:
        return cloud_from_records(RawCloud(stamp, name, points_from_message(message)), lidars[name])
    return None


def time_of(time: float) -> float:
    """Stamp in the log of a time since the start of the drive [s]."""
    return START_NS * 1e-9 + round(time / DT) * DT


def reading_of(sample: VehicleSample) -> VehicleReading:
    """Reading of the vehicle as the run time receives it."""
    rate = yaw_rate_from_body_rates(sample.orientation[None], sample.angular_velocity[None])[0]
    measured = {
        "brake": sample.brake_pressure,
        "steer": sample.steer_angle,
        "steer_rate": sample.steer_rate,
        "engine_rpm": sample.engine_speed / 1000,
    }
    actuators = np.array([measured.get(name, np.nan) for name in ACTUATORS])
    return VehicleReading(
        time_of(sample.time), sample.position, sample.orientation, sample.velocity, float(rate), actuators
    )


def cameras_of(suite: SensorSuite, rig: Rig) -> dict[str, Camera]:
    """Cameras of the vehicle by name, as a log has them."""
    return {c.name: Camera(c.name, c.model, _matrix(c.body_from_camera), rig.cameras[c.name]) for c in suite.cameras}


def lidars_of(suite: SensorSuite, rig: Rig) -> dict[str, Lidar]:
    """LiDARs of the vehicle by name, as a log has them."""
    return {s.name: Lidar(s.name, _matrix(s.body_from_lidar), rig.lidars[s.name]) for s in suite.lidars}


def _matrix(pose: Pose) -> Float[np.ndarray, "4 4"]:
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = pose.rotation, pose.position
    return matrix
