"""All channel checks: to add one, write its function in a new file and call it here."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property

from offpiste.inspection.clocks import check_clocks, check_headers, check_rates, check_steps
from offpiste.inspection.course import heading_fits
from offpiste.inspection.draft_values import check_draft_values, check_size
from offpiste.inspection.driven_path import DrivenPath
from offpiste.inspection.findings import Finding
from offpiste.inspection.gear import check_gear, pedal_reverses
from offpiste.inspection.heading_drift import check_heading_drift, check_heading_noise
from offpiste.inspection.held import check_dropouts, check_frozen
from offpiste.inspection.late_poses import check_late_poses
from offpiste.inspection.limits import check_cut_off, check_range_ends, check_resolution
from offpiste.inspection.missing import check_missing, check_same_pedals, check_unread
from offpiste.inspection.pedals import check_controls, check_pedals
from offpiste.inspection.recorded_log import Recorded
from offpiste.inspection.response import pedal_fits, steering_fits
from offpiste.inspection.samples import channel_signals, check_ranges, check_signals, check_valid, other_signals
from offpiste.inspection.stamps import check_on_change, check_senders, check_stamps
from offpiste.inspection.steering import check_steering
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
        return check_senders(self.inspected, self.rig) if self.rig else []

    @property
    def inspected(self) -> dict[str, Recorded]:
        """Return the topics read by a given rig; all topics without one."""
        return {name: r for name, r in self.recorded.items() if not self.given or name in self.used}


def check_topics(topics: Topics) -> list[Finding]:
    """Run the checks of topics as recorded; a fatal finding ends the inspection."""
    recorded, rig, given = topics.recorded, topics.rig, topics.given
    findings = list(topics.senders)
    signals = channel_signals(recorded, rig) if rig is not None else []
    if not given:
        signals += other_signals(recorded, rig)
    findings += check_signals(signals, rig) + _check_stamps(topics)
    if rig is not None:
        findings += check_unread(recorded, rig)
    if rig is not None and given:
        findings += check_missing(recorded, rig) + check_same_pedals(rig)
        findings += check_ranges(signals) + check_valid(recorded, rig)
        findings += check_draft_values(rig) + check_size(rig)
    return findings


def _check_stamps(topics: Topics) -> list[Finding]:
    inspected, clock, used = topics.inspected, topics.clock, topics.used
    changing = check_on_change(topics.recorded, topics.rig) if topics.rig is not None else []
    silent = topics.silent | {finding.where for finding in changing}
    channels = topics.rig.channels if topics.rig else {}
    alone = check_stamps(inspected, clock, used=used, silent=silent, channels=channels)
    several = {finding.where for finding in topics.senders}
    findings = changing + [f for f in alone if f.code != "losses" or f.where not in several]
    findings += check_steps(inspected, used=used, set_back=topics.set_back)
    if topics.rig is not None:
        findings += check_rates(inspected, topics.rig.channels["position"].topic, used=used)
    return findings + check_headers(inspected, used=used)


def check_motion(topics: Topics, drive: Drive, path: DrivenPath) -> list[Finding]:
    """Run the checks of channels against the motion; they require a trusted pose."""
    rig, recorded, given = drive.rig, topics.recorded, topics.given
    follows = heading_fits(path)  # otherwise turning cannot be checked
    measured = given and not check_draft_values(rig)  # wheelbase and `max_steer`
    steering, pedals = steering_fits(drive, path), pedal_fits(drive, path)
    findings: list[Finding] = []
    for check in (check_frozen, check_dropouts, check_resolution, check_heading_noise, check_wheel_speed):
        findings += check(drive, path)
    cut_off: list[Finding] = []
    if follows:
        cut_off = check_cut_off(drive, path)  # the vehicle turns further: the scale is unknown
        findings += check_late_poses(drive, path, steering, pedals) + check_heading_drift(drive, path)
        findings += check_linear_velocity(drive, path) if "linear_velocity" in drive.channels else []
        findings += check_turn_rate(drive, path)
        findings += check_steering(steering, drive, path, measured=measured, cut={f.where for f in cut_off})
    # Turning and pedal presses may show the same; each channel is reported once.
    ends = check_range_ends(drive) if given else []
    findings += cut_off + [f for f in ends if f.where not in {cut.where for cut in cut_off}]
    findings += check_clocks(recorded, path, rig, besides={rig.channels["position"].topic})
    reverses = pedal_reverses(drive, path)  # negative values are not a brake
    fits = {name: fit for name, fit in pedals.items() if not (reverses and name == "brake")}
    findings += check_pedals(fits, drive, path) + check_gear(drive, path, recorded)
    return findings + check_controls(steering, pedals, drive, path, given=given)
