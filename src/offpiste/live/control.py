"""Processes that command the vehicle: control at 50 Hz, and the watchdog that stops it when commands stop."""

import shutil
import time
from collections import deque
from typing import Any, Final

import numpy as np

from offpiste.core.conventions import DT
from offpiste.live.command_messages import Command, CommandMessages, joy_message
from offpiste.live.gate import Gate
from offpiste.live.part import NewestCourse, Part, TrackFeed, freeze_loaded_objects
from offpiste.live.reception import Pressed, switch_of
from offpiste.live.ring import packed, plan_from
from offpiste.live.session import COMMAND, MODE, Session
from offpiste.logs.ros.writer import make
from offpiste.runtime.estimator import Given
from offpiste.runtime.follower import Follower, MapState, TimedPlan
from offpiste.runtime.modes import Ages, Controls, ModeDecision
from offpiste.transport.received import Received

SILENCE: Final = 0.1
"""Time without a command after which the watchdog sends the stop [s]."""
ENDS: Final = 5.0
"""Maximum duration of the stop by control at the end of a drive [s]."""
_AT_LEAST: Final = 1.0
"""Minimum duration of that stop [s]."""
_LAST: Final = 0.5
"""Duration of the watchdog's stop after control has ended [s], so that the last command is a stop."""


class SteadyAges:
    """Ages of the inputs of control by the monotonic clock.

    They bound the ages by the robot's clock: if that clock froze, the newest plan and scan would look recent forever.
    """

    def __init__(self) -> None:
        self._seen: dict[str, tuple[float, float]] = {}

    def ages(self, came: float, state: MapState, acting: TimedPlan | None, steady: float) -> Ages:
        """Return the ages now [s], with the arrival of the last reading [s] and the followed plan.

        The ages of scan, image and plan are the times since their stamps last changed; minus infinity without a finite
        stamp.
        """
        start = -np.inf if acting is None else acting.start
        for name, stamp in {"scan": state.scan_time, "image": state.image_time, "plan": start}.items():
            if self._seen.get(name, (np.nan, 0.0))[0] != stamp:
                self._seen[name] = stamp, steady
        constant = {name: steady - at if np.isfinite(stamp) else -np.inf for name, (stamp, at) in self._seen.items()}
        return Ages(state=steady - came, **constant)


class Controller:
    """Command the vehicle once every `conventions.DT`: follow the newest plan, or stop."""

    def __init__(self, part: Part) -> None:
        self.part, settings, rig = part, part.settings, part.rig
        self.follower: Follower | None = None
        self._feed = TrackFeed(part, settings.load_planner().dynamics.vehicle.actuators)
        before, enable = part.newest("commands"), rig.live.enable if settings.drive else None
        self._gate = Gate(rig.live.limits, enable, settings.runtime.stop, before.get("applied"))
        self._course, self._plans = NewestCourse(part), part.reader("plans")
        self._empty = self._stuck = False
        self._steady, self._since = SteadyAges(), -np.inf
        self._stops, self._sent_at = part.ring("stops").written, np.inf
        self._why = "control was started again" if before else ""
        self._gear = before.get("gear", settings.runtime.gear)
        self.transport = part.connect()
        outputs, self._switch = CommandMessages(rig, self.transport.types), deque[Received](maxlen=64)
        self._send = outputs.sender(self.transport) if settings.drive else None
        for topic in outputs.topics if settings.drive else ():
            self.transport.subscribe(topic, self._other, unchecked=True)
        if enable is not None:
            msgtype = rig.live.types.get(enable.topic, "")
            self.transport.subscribe(enable.topic, self._switch.append, msgtype=msgtype)
        self._preview = self.transport.publisher(COMMAND, "sensor_msgs/msg/Joy")
        self._mode = self.transport.publisher(MODE, "std_msgs/msg/String", keep=True)
        self._said, self.late, self.ages = "", deque[float](maxlen=3000), deque[tuple[float, float]](maxlen=3000)

    @property
    def has_stopped(self) -> bool:
        """Whether the vehicle is at a standstill, or was never commanded."""
        if not self.part.settings.drive or self.part.ring("commands").written == 0:
            return True
        return self.follower is not None and self.follower.at_standstill()

    def tick(self, *, ending: bool = False) -> str:
        """Send a command and return the state.

        Args:
            ending: stop the vehicle, whatever the plans.
        """
        now = self.part.now()
        if self._feed.update(now):
            self._since = now
            if self.follower is not None:
                self.follower.restart()
        if (tracker := self._course.changed()) is not None:
            if self.follower is None:
                self.follower = Follower(self.part.settings.runtime, self._feed.track, tracker)
                self.follower.stopping = True  # a moving vehicle is stopped before it is driven
                self.follower.gear = self._gear  # as last commanded: the gear is not changed before the standstill
            self.follower.tracker = tracker
        latest, commanded = self._feed.track.latest, self.part.ring("commands").written > 0
        if self.follower is None or not np.isfinite(now):
            return "waits for a course" if self.follower is None else "waits for the clock"
        if latest is not None:
            self.follower.tracker.move(latest.position[:2])
        elif not commanded:  # a vehicle that was commanded before is stopped even without readings
            return "waits for readings of the vehicle"
        self._take_plans(self.follower, now)
        controls = self._command(self.follower, now, "the drive ends" if ending else "")
        said = f"{controls.mode}: {controls.why}" if controls.why else controls.mode
        if said != self._said:
            self._said = said
            self._mode(make("std_msgs/String", data=said))
        return said

    def numbers(self) -> dict[str, Any]:
        """Return delays, ages, speed and progress for the sign of life."""
        late, ages = 1e3 * np.array(self.late), 1e3 * np.array(self.ages).reshape(-1, 2)
        known = ages[np.isfinite(ages).all(axis=1)]
        map_age, plan_age = np.percentile(known, 99, axis=0) if len(known) else (np.nan, np.nan)
        return {
            "tick_p50_ms": float(np.percentile(late, 50)),
            "tick_p99_ms": float(np.percentile(late, 99)),
            "map_age_p99_ms": float(map_age),
            "plan_age_p99_ms": float(plan_age),
            "speed_mps": np.nan if self.follower is None else self.follower.speed,
            "progress_m": 0.0 if self.follower is None else self.follower.tracker.progress,
            "refused": self.transport.refused.snapshot(),
        }

    def _command(self, follower: Follower, now: float, held: str) -> Controls:
        known = self.part.newest("map-state")
        state = MapState(known.get("scan_time", -np.inf), known.get("image_time", -np.inf), self._empty, self._stuck)
        drive, acting = self.part.settings.drive, follower.schedule.acting(now)
        steady = self._steady.ages(self._feed.came, state, acting, time.monotonic())
        decision = follower.mode(now, state, steady)
        held = held or self._held() if drive else held
        if held and (decision.mode != "stopping" or decision.why == "no plan"):
            decision = ModeDecision("stopping", held)
        if not drive:  # another driver need not complete our stops
            follower.stopping = False
        follower.driver = Given() if drive else self._feed.given

        def applied(controls: Controls) -> np.ndarray:
            command = controls.command.copy()
            if acting is None:  # without a plan, keep the steering: straight ahead would leave a bend
                command[2] = self._gate.steer
            stopping = not controls.drives
            return self._gate.check(command, follower.speed, time.monotonic(), stopping=stopping).control

        controls = follower.follow(now, decision, applied)
        del follower.events[:-1]
        control, moving = self._gate.checked.control, controls.drives and not self._gate.checked.why
        followed = acting.prediction if moving and acting is not None else None
        if self._send is not None:
            self._send(Command(now, control, controls.gear, followed))
        self._preview(joy_message(max(round(now * 1e9), 0), control))
        self.ages.append((now - state.scan_time, np.inf if acting is None else now - acting.made))
        about = {"time": now, "applied": control, "stopping": follower.stopping, "mode": controls.mode}
        about |= {"gear": controls.gear, "course": self._course.number, "progress": follower.tracker.progress}
        about["driver"] = follower.driver._asdict()  # plans begin from the vehicle's actual commands
        self.part.write("commands", packed(about))
        self._sent_at = time.monotonic()
        return controls

    def _held(self) -> str:
        """Return the reason to stop the vehicle regardless of its inputs; empty if there is none."""
        stops, before = self.part.ring("stops").written, self._stops
        self._stops = stops
        why, self._why = self._why, ""
        if why:
            return why
        if self.part.clock_stopped:
            return "the clock stands still"
        if self.part.ring("status-watchdog").written == 0:  # once it was ready, it is restarted within a second
            return "the watchdog is not ready"
        if stops != before or time.monotonic() - self._sent_at > SILENCE:
            return "commands were interrupted"  # the watchdog, or the vehicle itself, has stopped it
        while self._switch:
            received = self._switch.popleft()
            message, at = self.transport.decode(received), received.steady
            heard = Pressed(False)
            if message is not None:
                heard = switch_of(self.part.rig, message, self.part.now() - (time.monotonic() - at))
            self._gate.enabled(heard.pressed, at, age=heard.age, publisher=received.publisher)
        return self._gate.blocked(time.monotonic())

    def _other(self, received: Received) -> None:
        if received.publisher[:8] != self.transport.identity:
            self.part.dropped.add(f"{received.topic}: commands of another publisher")
            self._gate.other(time.monotonic())

    def _take_plans(self, follower: Follower, now: float) -> None:
        """Take newer plans that are still valid."""
        settings = self.part.settings.runtime
        for values in self._plans.new():
            self._empty, self._stuck = bool(values["empty"]), bool(values["stuck"])
            if "start" not in values:
                continue
            timed = plan_from(values)
            latest = follower.schedule.latest
            if timed.start > now + settings.latency + settings.timeouts.ahead or timed.made < self._since:
                self.part.dropped["plans of another time, or from before the pose jumped"] += 1
            elif latest is None or timed.start > latest.start:
                follower.schedule.add(timed)


def control(session: Session) -> None:
    """Run the process that commands; it stops the vehicle when the drive or the parent ends."""
    part = Part("control", session)
    controller = Controller(part)
    freeze_loaded_objects()
    due, ends, drives = time.monotonic(), np.inf, False
    while True:
        if ends == np.inf and part.ending:
            ends = time.monotonic()
        since = time.monotonic() - ends
        if since > ENDS or (since > _AT_LEAST and controller.has_stopped):
            break
        state = controller.tick(ending=ends < np.inf)
        if state == "driving" and not drives:  # delays while other processes loaded do not count
            drives = True
            controller.late.clear()
            controller.ages.clear()
        controller.late.append(time.monotonic() - due)
        part.beat(state, controller.numbers)
        due += DT
        if time.monotonic() - due > 5 * DT:  # the process was stopped or starved: missed ticks are skipped
            part.dropped["ticks missed"] += round((time.monotonic() - due) / DT)
            due = time.monotonic()
        time.sleep(max(due - time.monotonic(), 0.0))
    controller.transport.close()
    if part.orphaned and not part.settings.drive:  # otherwise the watchdog, which ends later, removes it
        shutil.rmtree(session.folder, ignore_errors=True)


def watchdog(session: Session) -> None:
    """Run the process that sends the stop when commands stop coming, until the vehicle has been stopped."""
    part = Part("watchdog", session)
    transport = part.connect()
    send = CommandMessages(part.rig, transport.types).sender(transport)
    commands, stops, ends = part.ring("commands"), 0, np.inf
    for name in ("stops", "clock", "end"):  # opened now: once the parent has ended, their files may vanish
        part.ring(name)
    freeze_loaded_objects()
    while not _is_over(part, time.monotonic() - ends):
        if ends == np.inf and part.ending:
            ends = time.monotonic()
        silent = commands.written > 0 and commands.age > SILENCE
        if silent:
            last, brake = part.newest("commands"), part.settings.runtime.stop
            send(Command(part.now(), np.array((0.0, brake, last["applied"][2])), last["gear"]))
            part.write("stops", b"stop")  # a restarted control completes it
            stops += 1
        part.beat("stops the vehicle" if silent else "ready", stops=stops)
        time.sleep(DT)
    transport.close()
    if part.orphaned:  # no other process is left to remove it
        shutil.rmtree(session.folder, ignore_errors=True)


def _is_over(part: Part, since: float) -> bool:
    """Return whether the vehicle has been stopped, some time [s] after the end of the drive (negative before it)."""
    commands = part.ring("commands")
    if since < 0:
        return False
    if commands.written == 0:
        return since > SILENCE
    at_standstill = part.newest("commands")["mode"] == "stopped"
    return (at_standstill and commands.age > SILENCE + _LAST) or since > ENDS + 2.0
