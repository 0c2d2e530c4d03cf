"""The report of `offpiste evidence`: comparisons, valid rates and controls of each backbone, side by side."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final

import msgspec

from offpiste.conventions import FEATURE_SETS
from offpiste.evaluation.metrics import provenance
from offpiste.evidence.controls import ABOUT_LEAK, Controls, checks
from offpiste.files import write_text
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

PRIVACY: Final = (
    "This file holds numbers, the names of drives and the rig's name. It has no camera images, positions or commands "
    "of the drives. `evidence.json` beside it holds the same for programs."
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


def write_evidence(collected: Mapping[str, Collected], out: Path) -> Path:
    """Write report.html with its pictures, and evidence.json, each file whole or not at all.

    Args:
        collected: by name of the backbone.

    Returns:
        Path of report.html.
    """
    headlines = [f"{name}: {line}" for name, one in collected.items() for line in tables.sentences(one.results, "dc")]
    sections = [table_section(gains_beside_each_other(collected))]
    for name, one in collected.items():
        sections += _of_backbone(name, one)
    facts = _facts(collected)
    write_page(Page("What seeing the ground is worth", headlines, facts, [*sections, _closing()]), out)
    found = {name: _numbers(one) for name, one in collected.items()}
    content = msgspec.json.encode({"schema": SCHEMA, "facts": facts, "backbones": found})
    write_text(out / "evidence.json", msgspec.json.format(content, indent=2).decode() + "\n")
    return out / "report.html"


def gains_beside_each_other(collected: Mapping[str, Collected]) -> TextTable:
    """Distance errors against `b`, a line a model and a place where the ground is read, a column a backbone."""
    first = next(iter(collected.values())).results
    lines = []
    for reading in sorted(first.readings, key=lambda reading: reading[0] != "map"):
        for label in (model.label for model in first.models if model != first.baseline):
            cells = []
            for one in (each.results for each in collected.values()):
                model = next((model for model in one.models if model.label == label), None)
                known = model is not None and (model, reading) in one.runs
                cells.append(
                    tables.percent(one.compare(model, reading).relative["distance_error_m"])
                    if model is not None and known
                    else "–"
                )
            lines.append((label, " ".join(filter(None, reading)), *cells))
    levels = first.levels(first.readings[0])
    about = (
        f"Distance error after 5 s relative to b on the same windows, with 95 % intervals over {levels.text()}. "
        "map: the map as it was at the window's start, read at predicted places: it decides. recorded: under the "
        "wheels' recorded future places, with features seen from so far."
    )
    return TextTable("Against b", ("model", "lookup", *collected), tuple(lines), about)


def _of_backbone(name: str, one: Collected) -> list[Section]:
    controls, results = one.controls, one.results
    drawn = [
        Picture(f"{_plain(name)}-{title.replace(' ', '-')}", png(figure), figures.caption(title, results))
        for title, figure in figures.fig4(results).items()
    ]
    listed = [table_section(checks(results, controls), *drawn), table_section(tables.error_table(results.rows()))]
    seen = measure_coverage(one.data.dataset)
    if seen is not None:
        listed += [
            replace(section, pictures=[replace(p, name=f"{_plain(name)}-{p.name}") for p in section.pictures])
            for section in coverage_sections(seen, ("rates",))
        ]
    listed.append(table_section(gain_table("Features of other ground", controls.shift.gains, controls.shift.about)))
    if controls.leak:
        listed.append(table_section(gain_table("What recorded places give away", controls.leak, ABOUT_LEAK)))
    return [replace(section, heading=f"{name}: {section.heading}") for section in listed]


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
        "split": dataset.split.kind if dataset.split.kind == "drives" else dataset.split.text,
        "backbones": ", ".join(
            f"{name} ({len(one.data.dataset.features)} features)" for name, one in collected.items()
        ),
        "training": f"{size.train.epochs} epochs, batch {size.train.batch}, {size.seeds} seed{'s' * (size.seeds > 1)}",
        "date": made.date,
        "machine": made.machine,
        "versions": ", ".join(f"{name} {version}" for name, version in made.versions.items()),
    }


def _numbers(one: Collected) -> dict[str, Any]:
    metrics = msgspec.json.decode((one.settings.out / one.settings.figure / "metrics.json").read_bytes())
    return {
        "against_b": metrics["against_b"],
        "results": metrics["results"],
        "coverage": metrics["coverage"] | {"feature_sets": list(FEATURE_SETS)},
        "shift": one.controls.shift.gains,
        "other_ground": one.controls.shift.ground,
        "leak": one.controls.leak,
    }
