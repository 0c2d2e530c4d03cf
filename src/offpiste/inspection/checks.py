"""Registry of the channel checks: to add one, write its function in a new file and list it here."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Final

from offpiste.inspection.clocks import check_clocks
from offpiste.inspection.course import heading_fits
from offpiste.inspection.draft_values import check_draft_values, check_size
from offpiste.inspection.driven_path import DrivenPath
from offpiste.inspection.dropouts import check_dropouts
from offpiste.inspection.dropped import check_dropped
from offpiste.inspection.findings import Finding
from offpiste.inspection.frozen import check_frozen
from offpiste.inspection.gear import check_gear, pedal_reverses
from offpiste.inspection.heading_drift import check_heading_drift, check_heading_noise
from offpiste.inspection.lags import LagFit
from offpiste.inspection.late_poses import check_late_poses
from offpiste.inspection.lost_throttle import check_lost_throttle
from offpiste.inspection.missing import check_missing, check_same_pedals, check_unread
from offpiste.inspection.on_change import check_on_change
from offpiste.inspection.pedals import check_controls, check_pedals, pedal_fits
from offpiste.inspection.range_ends import check_range_ends
from offpiste.inspection.ranges import check_ranges
from offpiste.inspection.recorded_log import Recorded
from offpiste.inspection.resolution import check_resolution
from offpiste.inspection.saturation import check_saturation
from offpiste.inspection.senders import check_senders
from offpiste.inspection.several_clocks import check_rates, check_steps
from offpiste.inspection.signals import channel_signals, check_signals, other_signals
from offpiste.inspection.stamps import MISSING, check_headers, check_stamps
from offpiste.inspection.steering import check_steering, check_upside_down
from offpiste.inspection.steering_copies import check_computed_pose, check_copies
from offpiste.inspection.steering_fit import SteeringFit, steering_fits
from offpiste.inspection.velocity import check_linear_velocity, check_turn_rate, check_wheel_speed
from offpiste.logs.drive import Drive
from offpiste.logs.log import SetBack, Topic
from offpiste.rig.channels import Clock
from offpiste.rig.rig import Rig


@dataclass(frozen=True)
class Topics:
    """The recorded topics read by a check.

    Attributes:
        recorded: all numeric topics, by name.
        rig: the given rig or a drafted one; None if drafting failed.
        given: True if the rig is given.
        listed: all topics of the log, including parts of topics.
        set_back: backward step of the recorder's clock.
    """

    recorded: dict[str, Recorded]
    rig: Rig | None
    given: bool
    listed: Mapping[str, Topic] = field(default_factory=dict)
    set_back: SetBack | None = None

    @property
    def clock(self) -> Clock:
        """Return the rig's clock settings, or the defaults."""
        return self.rig.clock if self.rig else Clock()

    @property
    def used(self) -> set[str]:
        """Return the topics read by the rig."""
        if self.rig is None:
            return set()
        aligned = {self.rig.alignment.speed.topic} if self.rig.alignment else set()
        return {source.topic for source in self.rig.channels.values()} | aligned

    @property
    def silent(self) -> set[str]:
        """Return the topics recorded only on change, according to the rig."""
        channels = self.rig.channels.values() if self.rig else ()
        return {source.topic for source in channels} - {s.topic for s in channels if s.interpolation != "on change"}

    @cached_property
    def senders(self) -> list[Finding]:
        """Return findings on topics with several senders, used by other checks."""
        return check_senders(self.listed, self.inspected, self.rig, used=self.used)

    @property
    def inspected(self) -> dict[str, Recorded]:
        """Return the topics read by a given rig; all topics without one."""
        return {name: r for name, r in self.recorded.items() if not self.given or name in self.used}


@dataclass(frozen=True)
class Motion:
    """The driven path against which channels are checked.

    Attributes:
        follows: True if the heading follows the course, so that turning can be checked.
    """

    topics: Topics
    drive: Drive
    path: DrivenPath
    follows: bool

    @cached_property
    def measured(self) -> bool:
        """Return True if the rig's wheelbase and `max_steer` are measured, not drafted."""
        return self.topics.given and not check_draft_values(self.drive.rig)

    @cached_property
    def steering(self) -> dict[str, SteeringFit]:
        """Return the steering fits, used by several checks."""
        return steering_fits(self.drive, self.path, measured=self.measured)

    @cached_property
    def cut_off(self) -> list[Finding]:
        """Return channels that saturate while the vehicle turns further; their scale is unknown."""
        return check_saturation(self.drive, self.path) if self.follows else []

    @cached_property
    def pedals(self) -> dict[str, LagFit]:
        """Return the pedal fits, used by several checks."""
        return pedal_fits(self.drive, self.path)


def _signals(topics: Topics) -> list[Finding]:
    signals = channel_signals(topics.recorded, topics.rig) if topics.rig is not None else []
    if not topics.given:
        signals += other_signals(topics.recorded, topics.rig)
    return check_signals(signals, topics.rig)


def _ranges(topics: Topics) -> list[Finding]:
    return check_ranges(topics.recorded, topics.rig) if topics.rig is not None and topics.given else []


def _dropped(topics: Topics) -> list[Finding]:
    return check_dropped(topics.recorded, topics.rig) if topics.rig is not None and topics.given else []


def _missing(topics: Topics) -> list[Finding]:
    if topics.rig is None or not topics.given:
        return []
    return check_missing(topics.recorded, topics.rig) + check_same_pedals(topics.rig)


def _on_change(topics: Topics) -> list[Finding]:
    return check_on_change(topics.recorded, topics.rig) if topics.rig is not None else []


def _draft_values(topics: Topics) -> list[Finding]:
    if topics.rig is None or not topics.given:
        return []
    return check_draft_values(topics.rig) + check_size(topics.rig)


def _unread(topics: Topics) -> list[Finding]:
    return check_unread(topics.recorded, topics.rig) if topics.rig is not None else []


def _senders(topics: Topics) -> list[Finding]:
    return topics.senders


def _stamps(topics: Topics) -> list[Finding]:
    changing = _on_change(topics)
    silent = topics.silent | {finding.where for finding in changing}
    channels = topics.rig.channels if topics.rig else {}
    alone = check_stamps(topics.inspected, topics.clock, used=topics.used, silent=silent, channels=channels)
    several = {finding.where for finding in topics.senders} | {part.part_of for part in topics.listed.values()}
    alone = [f for f in alone if f.what != MISSING or f.where not in several]
    between = check_steps(topics.inspected, topics.clock, used=topics.used, set_back=topics.set_back)
    if topics.rig is not None:
        pose = topics.rig.channels["position"].topic
        between += check_rates(topics.inspected, pose, topics.clock, used=topics.used)
    return changing + alone + between + check_headers(topics.inspected, topics.clock, used=topics.used)


TOPIC_CHECKS: Final[tuple[Callable[[Topics], list[Finding]], ...]] = (
    _missing,
    _senders,
    _signals,
    _ranges,
    _dropped,
    _stamps,
    _draft_values,
    _unread,
)
"""Checks of topics as recorded; a fatal finding ends the inspection."""


def _linear_velocity(motion: Motion) -> list[Finding]:
    recorded = motion.follows and "linear_velocity" in motion.drive.channels
    return check_linear_velocity(motion.drive, motion.path) if recorded else []


def _wheel_speed(motion: Motion) -> list[Finding]:
    return check_wheel_speed(motion.drive, motion.path)


def _turn_rate(motion: Motion) -> list[Finding]:
    return check_turn_rate(motion.drive, motion.path) if motion.follows else []


def _late_poses(motion: Motion) -> list[Finding]:
    if not motion.follows:
        return []
    return check_late_poses(motion.drive, motion.path, motion.steering, motion.pedals)


def _frozen(motion: Motion) -> list[Finding]:
    return check_frozen(motion.drive, motion.path)


def _dropouts(motion: Motion) -> list[Finding]:
    return check_dropouts(motion.drive, motion.path)


def _resolution(motion: Motion) -> list[Finding]:
    return check_resolution(motion.drive, motion.path)


def _heading_drift(motion: Motion) -> list[Finding]:
    return check_heading_drift(motion.drive, motion.path) if motion.follows else []


def _heading_noise(motion: Motion) -> list[Finding]:
    return check_heading_noise(motion.drive, motion.path)


def _cut_off(motion: Motion) -> list[Finding]:
    """Combine the evidence of turning and of pedal presses; each channel is reported once."""
    ends = check_range_ends(motion.drive) if motion.topics.given else []
    return motion.cut_off + [f for f in ends if f.where not in {found.where for found in motion.cut_off}]


def _clocks(motion: Motion) -> list[Finding]:
    rig = motion.drive.rig
    return check_clocks(motion.topics.recorded, motion.path, rig, besides={rig.channels["position"].topic})


def _steering(motion: Motion) -> list[Finding]:
    if not motion.follows:
        return []
    cut = {finding.where for finding in motion.cut_off}
    return check_steering(motion.steering, motion.drive, motion.path, measured=motion.measured, cut=cut)


def _upside_down(motion: Motion) -> list[Finding]:
    if not motion.follows:
        return []
    return check_upside_down(motion.steering, motion.drive, motion.path, motion.topics.recorded)


def _steering_copies(motion: Motion) -> list[Finding]:
    return [] if motion.topics.given else check_copies(motion.drive, motion.topics.recorded)


def _computed_pose(motion: Motion) -> list[Finding]:
    return check_computed_pose(motion.drive, motion.path, motion.topics.recorded) if motion.follows else []


def _pedals(motion: Motion) -> list[Finding]:
    reverses = pedal_reverses(motion.drive, motion.path)  # negative values are not a brake
    fits = {name: fit for name, fit in motion.pedals.items() if not (reverses and name == "brake")}
    return check_pedals(fits, motion.drive, motion.path)


def _lost_throttle(motion: Motion) -> list[Finding]:
    fit = motion.pedals.get("throttle")
    return check_lost_throttle(fit, motion.drive, motion.path) if fit is not None else []


def _controls(motion: Motion) -> list[Finding]:
    fits = motion.steering, motion.pedals
    return check_controls(*fits, motion.drive, motion.path, given=motion.topics.given)


def _gear(motion: Motion) -> list[Finding]:
    return check_gear(motion.drive, motion.path, motion.topics.recorded)


MOTION_CHECKS: Final[tuple[Callable[[Motion], list[Finding]], ...]] = (
    _late_poses,
    _frozen,
    _dropouts,
    _resolution,
    _heading_drift,
    _heading_noise,
    _linear_velocity,
    _wheel_speed,
    _turn_rate,
    _clocks,
    _steering,
    _upside_down,
    _cut_off,
    _steering_copies,
    _computed_pose,
    _pedals,
    _lost_throttle,
    _controls,
    _gear,
)
"""Checks of channels against the motion; they require a trusted pose."""


def motion_of(topics: Topics, drive: Drive, path: DrivenPath) -> Motion:
    """Collect the inputs of the motion checks."""
    return Motion(topics, drive, path, heading_fits(path))
