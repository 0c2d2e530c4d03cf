"""The numbers of a figure as tables of text."""

from collections.abc import Sequence

import numpy as np

from offpiste.conventions import FEATURE_SETS
from offpiste.dataset.store import Dataset
from offpiste.evaluation.results import ResultRow
from offpiste.evaluation.table import interval, number
from offpiste.experiments.reproduce.claims import percent
from offpiste.experiments.reproduce.results import BASELINE, Findings, last_rows
from offpiste.experiments.reproduce.validity import valid_throughout
from offpiste.viewing.cover_table import TextTable

NAMES = {
    "distance_error_m": "distance [m]",
    "vx_error_mps": "v_x [m/s]",
    "yaw_error_rad": "yaw [rad]",
    "vy_error_mps": "v_y [m/s]",
    "loss": "loss",
}


def error_table(rows: Sequence[ResultRow]) -> TextTable:
    """Mean errors after 5 s of every model, in every way of reading the ground."""
    lines = [
        (
            row.way,
            *(f"{number(getattr(row, key).mean, 3)} {interval(getattr(row, key).ci95, 3)}" for key in NAMES),
            number(row.distance_error_m.median),
            f"{row.n}" + (f" ({row.n_failed} failed)" if row.n_failed else ""),
        )
        for row in last_rows(rows)
    ]
    about = (
        "Mean absolute errors with 95 % intervals, bootstrapped over blocks of 10 s; the loss is over all steps. "
        "Several seeds: each window's error is their mean. On the map, other windows are judged."
    )
    return TextTable("Errors after 5 s", ("model", *NAMES.values(), "median [m]", "windows"), tuple(lines), about)


def difference_table(found: Findings) -> TextTable:
    """Every model against `b`, read in the same way on the same windows."""
    lines = []
    for member in found.members:
        for way in found.ways:
            if member.label != BASELINE:
                against = found.against(member, way)
                name = f"{member.label} · {' '.join(filter(None, way))}"
                lines.append((name, *(percent(against.relative[key]) for key in NAMES), str(against.n)))
    about = f"Mean error of the model relative to that of {BASELINE}; negative: the model is better."
    names = ("model", *(name.partition(" [")[0] for name in NAMES.values()), "windows")
    return TextTable("Against b", names, tuple(lines), about)


def seed_table(found: Findings) -> TextTable:
    """Each run against the `b` of its seed, for models with several."""
    lines = []
    for member in found.members:
        for way in found.ways:
            runs = found.each_seed(member, way)
            if member.label != BASELINE and len(runs) > 1 and way[1] in (None, "hindsight"):
                gains = [100 * run.relative["distance_error_m"].mean for run in runs]
                losses = [100 * run.relative["loss"].mean for run in runs]
                name = f"{member.label} · {' '.join(filter(None, way))}"
                lines.append((name, _spread(gains), _spread(losses)))
    about = "Each run relative to the b of its seed, and their standard deviation."
    return TextTable("Seeds", ("model", "distance error [%]", "loss [%]"), tuple(lines), about)


def distance_table(found: Findings, results: Sequence[ResultRow], quantity: str) -> TextTable:
    """A mean error by the distance that features were seen from, and relative to `b`'s with the normals seen then."""
    sets = [name for name in FEATURE_SETS if ("recorded", name) in found.ways]
    rows = {row.way: row for row in last_rows(results)}
    lines = []
    for member in found.members:
        mine = [rows[_way(member.label, name)] for name in sets]
        lines.append((member.label, *(number(getattr(row, quantity).mean, 3) for row in mine)))
        lines.append(("  95 % interval", *(interval(getattr(row, quantity).ci95, 3) for row in mine)))
        if member.label != BASELINE:
            gains = [found.against(member, ("recorded", name)).relative[quantity] for name in sets]
            lines.append(("  against b", *(percent(gain) for gain in gains)))
    about = "At recorded places; every model, b too, reads the normals of the same set as its features."
    return TextTable(f"Mean {NAMES[quantity]} by distance", ("model", *_metres(sets)), tuple(lines), about)


def seen_table(found: Findings, dataset: Dataset) -> TextTable:
    """Distance errors against `b` where nothing is missing: what is left is how looks change with distance."""
    sets = [name for name in FEATURE_SETS if ("recorded", name) in found.ways]
    windows = found.over_seeds(found.baseline, ("recorded", sets[0]))
    seen = {name: valid_throughout(dataset, name, windows) for name in sets}
    lines: list[tuple[str, ...]] = [("windows", *(str(int(s.sum())) for s in seen.values()))]
    for member in found.members:
        if member.label != BASELINE:
            gains = [found.against(member, ("recorded", name), seen[name]).relative for name in sets]
            lines.append((member.label, *(percent(gain["distance_error_m"]) for gain in gains)))
    about = "Distance error against b, only on windows whose every wheel has features of the set all along."
    return TextTable("Windows valid throughout", ("model", *_metres(sets)), tuple(lines), about)


def _way(label: str, feature_set: str) -> str:
    return f"{label} · recorded" + ("" if feature_set == "hindsight" else f" {feature_set} m")


def _metres(sets: Sequence[str]) -> list[str]:
    return [name if name == "hindsight" else f"{name} m" for name in sets]


def _spread(values: Sequence[float]) -> str:
    return f"{', '.join(f'{value:+.1f}' for value in values)} (std {np.std(values, ddof=1):.1f})"
