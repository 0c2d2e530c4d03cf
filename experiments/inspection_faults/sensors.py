"""Score the checks of cameras and LiDARs: `python -m experiments.inspection_faults.sensors --out sensors`."""

import traceback
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar, Final

import numpy as np

from experiments.command import run
from experiments.inspection_faults.drives import BEHAVIOURS, ground_and_style, world_of
from experiments.inspection_faults.report import listed, share_table
from experiments.inspection_faults.score import in_words, serious
from experiments.inspection_faults.sensor_faults import LAYOUTS, SENSOR_FAULTS, SensorCase, SensorFault
from experiments.inspection_faults.study import Study
from offpiste.core.errors import OffpisteError
from offpiste.inspection.findings import Finding, ranked
from offpiste.inspection.sensors import check_sensors
from offpiste.logs.log import open_log
from offpiste.rig.edits import edited
from offpiste.simulation.simulate import DriveSettings, record, start_and_driver
from offpiste.simulation.vehicle.parameters import load_vehicle

CASES_PER_DRIVE: Final = 5
"""The first of them is healthy."""
_SECONDS, _LEAST = 40.0, 25.0
"""Length of a drive, and length under which it is repeated [s]."""
_MAP: Final = ("LiDARs", "poses")
"""Places of notes about ghosts, moving returns and a drift in height."""


@dataclass(frozen=True)
class SensorScore:
    """Result of one case."""

    seed: int
    drive: str
    fault: str  # "" for a healthy case
    strength: float
    found: bool  # whether a warning says what is wrong, and where
    noted: bool  # whether only a note does
    fix: str  # "right", "wrong", "none" (of the first warning about it), "" where not found or not fixable
    alarms: tuple[str, ...]  # warnings and fatal findings that say something else
    accusing: tuple[str, ...]  # notes on the map that do
    findings: tuple[str, ...]
    error: str  # exception of the inspection


def recorded_drive(number: int, cache: Path) -> Path:
    """Return the log of a drive, simulated once and kept in the folder `cache`; its name ends with the layout."""
    layout = list(LAYOUTS)[number % len(LAYOUTS)]
    path = cache / f"sensors-{number:06d}-{layout}.mcap"
    world, vehicle, random = world_of(number), load_vehicle(), np.random.default_rng([number, 0x5E5])
    behaviours = [name for name in BEHAVIOURS if name != "stops and reverse"]
    shares = np.array([BEHAVIOURS[name] for name in behaviours])
    cache.mkdir(parents=True, exist_ok=True)
    while not path.exists():
        ground, style = ground_and_style(str(random.choice(behaviours, p=shares / shares.sum())), world, random)
        settings = DriveSettings(world=ground.settings, seed=int(random.integers(1 << 30)))
        part = path.with_name(f"part-{path.name}")
        start, driver = start_and_driver(ground, vehicle, seed=settings.seed, settings=style)
        steps, suite = round(_SECONDS * 50), LAYOUTS[layout].suite()
        part.unlink(missing_ok=True)
        if record(settings, ground, vehicle, start, driver, part, steps=steps, suite=suite).seconds > _LEAST:
            part.rename(path)
    return path


def given_to(seed: int) -> tuple[SensorFault | None, float]:
    """Return fault and strength of a seed; they take turns, so that all are equally frequent."""
    number, turn = divmod(seed, CASES_PER_DRIVE)
    if turn == 0:
        return None, 0.0
    choices = [(fault, strength) for fault in SENSOR_FAULTS.values() for strength in fault.strengths]
    # Shuffled alike, so that the strengths of a fault meet different drives.
    order = np.random.default_rng(0x5E5).permutation(len(choices))
    return choices[order[(number * (CASES_PER_DRIVE - 1) + turn - 1) % len(choices)]]


def score(seed: int, case: SensorCase, fault: SensorFault | None, strength: float) -> SensorScore:
    """Plant a fault, check the sensors, and compare the findings with the truth; channels have a score of their own."""
    if fault:
        case = fault.change(case, strength, np.random.default_rng([seed, 0x5E5]))
    findings: tuple[Finding, ...] = ()
    error = ""
    try:
        findings = ranked(check_sensors(case.log, case.rig))
    except Exception:  # noqa: BLE001  # any exception counts as a failure
        error = traceback.format_exc(limit=-3)
    about = [one for one in findings if fault and one.where == fault.where and fault.what in one.what]
    others = [one for one in findings if one not in about and not (fault and one.where in fault.consequences)]
    warnings, alarms = serious(about), serious(others)
    return SensorScore(
        seed=seed,
        drive=case.log.path.stem,
        fault=fault.name if fault else "",
        strength=strength,
        found=bool(warnings),
        noted=bool(about) and not warnings,
        fix=_first_fix(case, fault, warnings[0]) if fault and warnings else "",
        alarms=tuple(map(in_words, alarms)),
        accusing=tuple(in_words(one) for one in others if one.where in _MAP and one not in alarms),
        findings=tuple(map(in_words, findings)),
        error=error,
    )


def _first_fix(case: SensorCase, fault: SensorFault, warning: Finding) -> str:
    if fault.fixed is None:
        return ""
    if not warning.cures:
        return "none"
    try:
        return "right" if fault.fixed(case, edited(case.rig, warning.cures[0])) else "wrong"
    except OffpisteError:
        return "wrong"


def report(scores: Sequence[SensorScore]) -> str:
    """Return the whole report as Markdown."""
    healthy, faulty = [s for s in scores if not s.fault], [s for s in scores if s.fault]
    measures = {
        "healthy logs with a false alarm": [bool(s.alarms) for s in healthy],
        "healthy logs with an accusing note": [bool(s.accusing) for s in healthy],
        "faults found or noted": [s.found or s.noted for s in faulty],
        "of found and fixable ones, right first fix": [s.fix == "right" for s in faulty if s.fix],
        "faulty logs with another alarm": [bool(s.alarms) for s in faulty],
        "failures of inspect": [bool(s.error) for s in scores],
    }
    rows = []
    for name, strength in sorted({(s.fault, s.strength) for s in faulty}):
        of = [s for s in faulty if (s.fault, s.strength) == (name, strength)]
        fixes = f"{sum(s.fix == 'right' for s in of)}/{sum(s.found for s in of)}" if SENSOR_FAULTS[name].fixed else ""
        found, noted = sum(s.found for s in of), sum(s.noted for s in of)
        rows.append(f"| {name} | {strength:g} {SENSOR_FAULTS[name].unit} | {found}/{len(of)} | {noted} | {fixes} |")
    parts = [
        "# What `inspect` finds in cameras and LiDARs of logs with known truth",
        f"{len(healthy)} healthy logs, {len(faulty)} with one fault. Intervals are Wilson's 95 %.",
        share_table(measures),
        "| fault | strength | found | noted | right first fix |\n|---|---|---|---|---|\n" + "\n".join(rows),
        *listed("False alarms on healthy logs", [_line(s, a) for s in healthy for a in (*s.alarms, *s.accusing)]),
        *listed("Other alarms on faulty logs", [_line(s, a) for s in faulty for a in s.alarms]),
        *listed("Neither found nor noted", [_line(s) for s in faulty if not (s.found or s.noted)]),
        *listed("Wrong first fixes", [_line(s) for s in faulty if s.fix == "wrong"]),
        *listed("Failures of inspect", [_line(s, s.error.strip().splitlines()[-1]) for s in scores if s.error]),
    ]
    return "\n\n".join(parts) + "\n"


def _line(one: SensorScore, text: str = "") -> str:
    return f"{one.seed} ({one.drive}; {one.fault or 'healthy'} {one.strength:g}) {text}".strip()


@dataclass(frozen=True)
class SensorFaults(Study):
    """Score the checks of cameras and LiDARs on simulated logs with one fault; five logs share a drive, one healthy."""

    out: Path = Path("sensor-faults")
    logs: int = 60

    kind: ClassVar[type] = SensorScore

    def case(self, seed: int) -> SensorCase:
        """Return the healthy case of a seed."""
        path = recorded_drive(seed // CASES_PER_DRIVE, self.drives)
        layout = LAYOUTS[path.stem.rpartition("-")[2]]
        rig = layout.rig()
        return SensorCase(open_log(path, clock=rig.clock), rig, layout)

    def score(self, seed: int) -> SensorScore:
        """Score the case of a seed."""
        return score(seed, self.case(seed), *given_to(seed))

    def report(self, scores: Sequence[SensorScore]) -> str:
        """Return the whole report as Markdown."""
        return report(scores)

    def summary(self, score: SensorScore) -> str:
        """Describe the outcome of a fault."""
        what = "found" if score.found else "noted" if score.noted else "missed" if score.fault else "healthy"
        return f"{_line(score)}: {what} {score.fix}; {len(score.alarms)} other alarms"


if __name__ == "__main__":
    run(SensorFaults)
