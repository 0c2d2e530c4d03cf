"""Vehicle of the proving ground as a robot on the transport, simulated in real time."""

import logging
import queue
import threading
import time
from collections.abc import Callable
from contextlib import closing
from functools import cache
from typing import Any, Final

import numpy as np
from jaxtyping import Float

from offpiste.closed_loop.courses import ChosenCourse, CourseSettings, choose_course
from offpiste.closed_loop.lockstep import Driving, time_of
from offpiste.closed_loop.scores import scores_of
from offpiste.core.conventions import DT
from offpiste.core.errors import LiveError, require
from offpiste.core.progress import track
from offpiste.live.command_messages import path_message
from offpiste.live.part import freeze_loaded_objects
from offpiste.live.play import clock_message
from offpiste.live.session import CLOCK
from offpiste.rig.rig import load_rig
from offpiste.runtime.modes import Controls
from offpiste.simulation.messages import MAP, mountings_message, stamp_ns, vehicle_messages
from offpiste.simulation.recorder import Imperfections, with_noise
from offpiste.simulation.sample import VehicleSample
from offpiste.simulation.sensors.suite import Sensing, sensor_suite
from offpiste.simulation.simulate import drive
from offpiste.simulation.vehicle.parameters import load_vehicle
from offpiste.simulation.world.build import make_world
from offpiste.simulation.world.world import World, WorldSettings
from offpiste.transport.received import Received
from offpiste.transport.zenoh_transport import ZenohSettings, ZenohTransport

logger = logging.getLogger(__name__)

COURSE: Final = "/course"
"""Latched topic of the course (nav_msgs/Path)."""
OWN_STOP: Final = 0.25
"""Time without a command after which the vehicle brakes by itself, like a drive-by-wire unit [s]."""
_BEHIND: Final = 0.2
"""Delay from which sensors leave out a measurement [s]."""
_STANDS: Final = 2.0
"""Standstill at the end of the course after which the drive ends [s]."""
_NEAR: Final = 4.0
"""Maximum distance of that standstill from the end [m]."""


class RemoteCommands:
    """Last received command (a `simulation.simulate.Controller`).

    Attributes:
        stuck: always False: the driver may wait.
        lost: number of steps without a recent command.
        given: throttle, brake, steer and gear of each step.
    """

    def __init__(self) -> None:
        self.stuck, self.lost, self.given = False, 0, list[np.ndarray]()
        self._command, self._at = np.array((0.0, 1.0, 0.0, 1.0)), -np.inf

    def received(self, axes: Float[np.ndarray, " n"]) -> None:
        """Take throttle, brake, steer and gear from the axes of a sensor_msgs/Joy; ignore invalid ones."""
        command = np.append(axes, 1.0)[:4] if len(axes) == 3 else axes[:4]  # without a gear: forward
        if len(command) == 4 and np.isfinite(command).all():
            limited = np.clip(np.asarray(command, np.float64), (0.0, 0.0, -1.0, -1.0), 1.0)
            self._command, self._at = limited, time.monotonic()

    def command(self, sample: VehicleSample) -> Float[np.ndarray, " 4"]:
        """Return the command for the next step."""
        command = self._command
        if time.monotonic() - self._at > OWN_STOP:
            self.lost += np.isfinite(self._at)
            command = np.array((0.0, 1.0, command[2], command[3]))
        self.given.append(command)
        return command


class SimulatedSensors:
    """Cameras and LiDARs, simulated in a thread; measurements that would be late are left out.

    Attributes:
        left_out, published: number of measurements.
    """

    def __init__(self, sensing: Sensing, publish: Callable[[str, Any], None]) -> None:
        self._sensing, self._publish, self._waiting = sensing, publish, queue.SimpleQueue[VehicleSample | None]()
        self.left_out = self.published = 0
        self._latest, self._ends = 0.0, False
        self._thread = threading.Thread(target=self._work, daemon=True)
        self._thread.start()

    def measure(self, sample: VehicleSample) -> None:
        """Queue a measurement."""
        self._latest = sample.time
        self._waiting.put(sample)

    def end(self) -> None:
        """End the thread without the queued measurements."""
        self._ends = True
        self._waiting.put(None)
        self._thread.join()

    def _work(self) -> None:
        while (sample := self._waiting.get()) is not None and not self._ends:
            if self._latest - sample.time > _BEHIND:
                self.left_out += self._sensing.pass_by(sample)
                continue
            for topic, message in self._sensing.observe(sample, stamp_ns):
                self._publish(topic, message)
                self.published += 1


class SimulatedRobot:
    """Vehicle of the proving ground on the transport.

    Args:
        sensors: profile of `simulation.sensors`.
        vehicle: a TOML file; "" for the side-by-side.
        pose_noise: additional white noise of the published positions [m].
    """

    def __init__(
        self, transport: ZenohTransport, world: World, chosen: ChosenCourse, sensors: str, seed: int, *,
        vehicle: str = "", pose_noise: float = 0.0,
    ) -> None:  # fmt: skip
        self._transport, self.world, self.chosen = transport, world, chosen
        self._command_topic = load_rig("proving_ground").outputs["command"].topic
        self._parameters, self._imperfections = load_vehicle(vehicle or None), Imperfections(pose_noise)
        self.commands, self._rng = RemoteCommands(), np.random.default_rng([seed, 3])
        self._publisher = cache(transport.publisher)
        transport.subscribe(self._command_topic, self._commanded, msgtype="sensor_msgs/msg/Joy")
        suite = sensor_suite(sensors)
        self._sensing = Sensing(world, suite, np.random.default_rng([seed, 2]))
        self._sensors = SimulatedSensors(self._sensing, self._publish)
        mountings = mountings_message(suite.mountings, stamp_ns(0.0))
        transport.publisher("/tf_static", "tf2_msgs/msg/TFMessage", keep=True)(mountings)
        places = np.pad(chosen.course.driven, ((0, 0), (0, 1)))
        path = path_message(places, np.zeros(len(places)), stamp_ns(0.0), MAP)
        transport.publisher(COURSE, "nav_msgs/msg/Path", keep=True)(path)

    def drive(self, seconds: float) -> Driving:
        """Drive to the end of the course, a failure, a time limit [s], or Ctrl-C; return it from the first throttle."""
        samples, stands, slow = list[VehicleSample](), 0.0, 0.0
        end, due, steps = self.chosen.course.driven[-1], time.monotonic(), round(seconds / DT)
        run = drive(self.world, self._parameters, self.chosen.start, self.commands, steps=steps)
        try:
            for _, sample in zip(track(range(steps), "simulate"), run, strict=False):
                samples.append(sample)
                self._publish_vehicle(sample)
                self._sensors.measure(sample)
                moving = float(np.hypot(*sample.velocity[:2])) > 0.1
                there = not moving and np.linalg.norm(sample.position[:2] - end) < _NEAR
                stands = stands + DT if there else 0.0
                if stands > _STANDS:
                    break
                due += DT
                if time.monotonic() - due > 5 * DT:  # simulated time falls behind instead of catching up
                    slow += time.monotonic() - due
                    due = time.monotonic()
                time.sleep(max(due - time.monotonic(), 0.0))
        except KeyboardInterrupt:
            if len(samples) < 2:  # too short for scores
                raise
        finally:  # sensors must not outlive their thread pools
            self._sensors.end()
        if slow > 0.05 * len(samples) * DT:
            logger.warning(f"this machine is too slow: simulated time fell behind by {slow:.1f} s")
        if left_out := self._sensors.left_out:
            measured = left_out + self._sensors.published
            logger.warning(f"this machine is too slow: left out {left_out} of {measured} measurements")
        driven = list(zip(samples, self.commands.given, strict=False))
        controls = [Controls(time_of(s.time), given[:3], "driving", gear=given[3]) for s, given in driven]
        return Driving([sample for sample, _ in driven], controls).from_first_throttle

    def _publish(self, topic: str, message: Any) -> None:
        self._publisher(topic, message.__msgtype__)(message)

    def _publish_vehicle(self, sample: VehicleSample) -> None:
        stamp, measured = stamp_ns(sample.time), with_noise(sample, self._imperfections, self._rng)
        messages = vehicle_messages(measured, stamp, wheel_radius=self._parameters.rolling_radius)
        del messages[self._command_topic]
        messages["/odometry"] = messages.pop("/odometry")  # last: it completes a reading
        for topic, message in {**messages, CLOCK: clock_message(stamp)}.items():
            self._publish(topic, message)

    def _commanded(self, received: Received) -> None:
        message = self._transport.decode(received)
        if message is not None:
            self.commands.received(message.axes)


def simulate_live(
    world: WorldSettings, robot: ZenohSettings, *,
    sensors: str, seconds: float, speed: float, vehicle: str = "", pose_noise: float = 0.0,
) -> None:  # fmt: skip
    """Simulate a vehicle that is driven over the transport, and log the scores of its drive."""
    require("live", "zenoh")
    if not DT / 2 < seconds < np.inf:
        raise LiveError(f"invalid duration {seconds:g} s", where="--seconds", how="give a finite number above 0")
    parameters, made = load_vehicle(vehicle or None), make_world(world)
    chosen = choose_course(made, world.seed, CourseSettings(speed=speed))
    freeze_loaded_objects()
    with closing(ZenohTransport(robot)) as transport:
        simulated = SimulatedRobot(transport, made, chosen, sensors, world.seed, vehicle=vehicle, pose_noise=pose_noise)
        logger.info(f"the vehicle waits for commands; its course is on {COURSE}")
        driving = simulated.drive(seconds)
    result = scores_of(driving, chosen.course, seconds, parameters)
    ending = "finished" if result["finished"] else f"{result['progress_m']:.0f} of {result['course_m']:.0f} m"
    logger.info(
        f"{ending} in {result['time_s']:.1f} s, {result['mean_speed_mps']:.1f} m/s, {result['mean_path_error_m']:.2f} m"
        f" off the course, cost {result['driven_cost']:.0f}; {simulated.commands.lost} steps without a command"
    )
