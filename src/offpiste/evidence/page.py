"""The report of `offpiste evidence`: comparisons, valid rates and controls of each backbone, side by side."""

import sys
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final

import msgspec

from offpiste.core.conventions import FEATURE_SETS
from offpiste.core.files import write_text
from offpiste.evaluation.evaluated_models import Reading
from offpiste.evaluation.metrics import provenance
from offpiste.evidence.baselines import ABOUT as ABOUT_BASELINES
from offpiste.evidence.controls import ABOUT_LEAK, Controls, checks
from offpiste.evidence.doubts import doubts, public_command, vehicle_facts
from offpiste.evidence.trainings import NOTHING, has_learned, trainings_table
from offpiste.report.figure import png
from offpiste.report.page import Page, Picture, Section, table_section, write_page
from offpiste.report.text_table import TextTable
from offpiste.reproduction import figures, tables
from offpiste.reproduction.gains import gain_table
from offpiste.reproduction.results import FigureResults
from offpiste.reproduction.runs import EvaluationData, driven_time
from offpiste.reproduction.settings import ReproductionSettings
from offpiste.visualization.coverage_figures import coverage_sections
from offpiste.visualization.coverage_tables import measure_coverage

SCHEMA: Final = 1

ABOUT_RATES: Final = (
    "Over all drives, those that trained included. The paper's rates are of its own vehicle and course, beside these "
    "for their size alone."
)

PRIVACY: Final = (
    "This file holds numbers, the names of drives and the rig's name, mass and size. It has no camera images, "
    "positions or commands of the drives. `evidence.json` beside it holds the same for programs."
)


@dataclass(frozen=True)
class Collected:
    """What one backbone's features gave.

    Attributes:
        settings: of its comparison, whose metrics.json stands in its folder.
    """

    settings: ReproductionSettings
    data: EvaluationData
    results: FigureResults
    controls: Controls


def write_evidence(collected: Mapping[str, Collected], out: Path, *, rig: str = "") -> Path:
    """Write report.html with its pictures, and evidence.json, each file whole or not at all.

    Args:
        collected: by name of the backbone.
        rig: text of the rig's file; "" where the proving ground was driven.

    Returns:
        Path of report.html.
    """
    headlines = [f"{name}: {line}" for name, one in collected.items() for line in _main_results(one)]
    doubted = list(doubts(next(iter(collected.values())).data.dataset, rig))
    sections = [Section("What to doubt", notes=doubted)] if doubted else []
    sections.append(table_section(gains_beside_each_other(collected)))
    for name, one in collected.items():
        sections += _of_backbone(name, one)
    facts = _facts(collected)
    write_page(Page("What seeing the ground is worth", headlines, facts, [*sections, _closing()]), out)
    found = {name: _numbers(one) for name, one in collected.items()}
    content = msgspec.json.encode({"schema": SCHEMA, "facts": facts, "doubts": doubted, "backbones": found})
    write_text(out / "evidence.json", msgspec.json.format(content, indent=2).decode() + "\n")
    return out / "report.html"


def _main_results(one: Collected) -> list[str]:
    """Sentences with the gain of `dc`, or what forbids to read anything from it."""
    dc = next(model for model in one.results.models if model.label == "dc")
    if not has_learned(one.settings, dc):
        return [
            "dc learned nothing: all its runs kept the weights that they began with, so that its errors are the "
            "physics' and say nothing of features"
        ]
    said = tables.sentences(one.results, "dc")
    levels = one.results.levels(next((r for r in one.results.readings if r == tables.MAP), tables.HINDSIGHT))
    if levels.caveat:
        said.append(levels.caveat)
    return said


def gains_beside_each_other(collected: Mapping[str, Collected]) -> TextTable:
    """Distance errors against `b`, a line a model and a place where the ground is read, a column a backbone."""
    first = next(iter(collected.values())).results
    lines = []
    for reading in sorted(first.readings, key=lambda reading: reading[0] != "map"):
        for label in (model.label for model in first.models if model != first.baseline):
            cells = []
            for one in collected.values():
                cells.append(_against_b(one, label, reading))
            lines.append((label, " ".join(filter(None, reading)), *cells))
    levels = first.levels(first.readings[0])
    about = (
        "Distance error after 5 s relative to b on the same windows; negative: smaller, which is better. 95 % "
        f"intervals over {levels.text()}. {levels.caveat} "
        "map: the map as it was at the window's start, read at predicted places: it decides. recorded: under the "
        "wheels' recorded future places, with features seen from so many metres away, or in hindsight from anywhere. "
        f"{NOTHING}: every run kept the weights that it began with, the physics alone (see the trainings)."
    )
    return TextTable("Against b", ("model", "lookup", *collected), tuple(lines), about)


def _of_backbone(name: str, one: Collected) -> list[Section]:
    controls, results = one.controls, one.results
    drawn = [
        Picture(f"{_plain(name)}-{title.replace(' ', '-')}", png(figure), figures.caption(title, results))
        for title, figure in figures.fig4(results).items()
    ]
    dc = next(model for model in results.models if model.label == "dc")
    learned = has_learned(one.settings, dc)
    listed = [
        table_section(checks(results, controls, learned=learned), *drawn),
        table_section(trainings_table(one.settings, results.models)),
        table_section(_with_hindsight(tables.error_table(results.rows()))),
    ]
    if controls.baselines:
        listed.append(table_section(gain_table("Models without networks", controls.baselines, ABOUT_BASELINES)))
    seen = measure_coverage(one.data.dataset)
    if seen is not None:
        listed += [
            replace(
                section,
                pictures=[replace(p, name=f"{_plain(name)}-{p.name}") for p in section.pictures],
                notes=[*section.notes, ABOUT_RATES],
            )
            for section in coverage_sections(seen, ("rates",))
        ]
    listed.append(table_section(gain_table("Features of other ground", controls.shift.gains, controls.shift.about)))
    if controls.leak:
        listed.append(table_section(gain_table("What recorded places give away", controls.leak, ABOUT_LEAK)))
    return [replace(section, heading=f"{name}: {section.heading}") for section in listed]


def _against_b(one: Collected, label: str, reading: Reading) -> str:
    """The gain of a model, that it learned nothing, or a dash where it is not known."""
    model = next((model for model in one.results.models if model.label == label), None)
    if model is None or (model, reading) not in one.results.runs:
        return "–"
    if not has_learned(one.settings, model):
        return NOTHING
    return tables.percent(one.results.compare(model, reading).relative["distance_error_m"])


def _with_hindsight(table: TextTable) -> TextTable:
    """Labels with the feature set that other tables name, too."""
    lines = [
        (f"{line[0]} hindsight" if str(line[0]).endswith("recorded") else line[0], *line[1:]) for line in table.lines
    ]
    return replace(table, lines=lines)


def _plain(name: str) -> str:
    """A backbone's name as part of a file name."""
    return Path(name).name


def _closing() -> Section:
    return Section("Sending it back", notes=[PRIVACY])


def _facts(collected: Mapping[str, Collected]) -> dict[str, str]:
    first = next(iter(collected.values()))
    dataset, size, made = first.data.dataset, first.settings.size, provenance("", 0, first.settings.device)
    driven = driven_time(dataset)
    return {
        "drives": f"{len(dataset.drives)}: {driven.train:.0f} s to train, {driven.validation:.0f} s to validate, "
        f"{driven.test:.0f} s to test",
        "rig": dataset.rig.name,
        **vehicle_facts(dataset),
        "split": dataset.split.kind if dataset.split.kind == "drives" else dataset.split.text,
        "backbones": ", ".join(
            f"{name} ({len(one.data.dataset.features)} features)" for name, one in collected.items()
        ),
        "training": f"{size.train.epochs} epochs, batch {size.train.batch}, {size.seeds} seed{'s' * (size.seeds > 1)}",
        "command": public_command(sys.argv),
        "date": made.date,
        "machine": made.machine,
        "versions": ", ".join(f"{name} {version}" for name, version in made.versions.items()),
    }


def _numbers(one: Collected) -> dict[str, Any]:
    metrics = msgspec.json.decode((one.settings.out / one.settings.figure / "metrics.json").read_bytes())
    return {
        "kept_epochs": [list(line) for line in trainings_table(one.settings, one.results.models).lines],
        "against_b": metrics["against_b"],
        "results": metrics["results"],
        "coverage": metrics["coverage"] | {"feature_sets": list(FEATURE_SETS)},
        "shift": one.controls.shift.gains,
        "other_ground": one.controls.shift.ground,
        "leak": one.controls.leak,
        "baselines": one.controls.baselines,
    }
