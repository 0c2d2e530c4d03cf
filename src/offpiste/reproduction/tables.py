"""What the paper says of its figures, beside what was found: nothing is rounded in favour of either.

The numbers of a figure as tables of text.
"""

from collections.abc import Iterator, Sequence

import numpy as np

from offpiste.conventions import FEATURE_SETS
from offpiste.dataset.store import Dataset
from offpiste.evaluation.evaluated_models import Reading
from offpiste.evaluation.intervals import PairedDifference
from offpiste.evaluation.metrics import ResultRow
from offpiste.report.text_table import TextTable, interval, number
from offpiste.reproduction.results import Findings, last_rows, valid_throughout
from offpiste.reproduction.settings import BASELINE, compression_sizes, feature_numbers

HINDSIGHT: Reading = ("recorded", "hindsight")
MAP: Reading = ("map", None)


def percent(difference: PairedDifference) -> str:
    """A relative difference with its interval."""
    if not np.isfinite(difference.mean):
        return "–"
    low, high = difference.ci95
    return f"{100 * difference.mean:+.1f} % {interval((100 * low, 100 * high), 1)}"


def verdict(difference: PairedDifference, limit: float = 0.0) -> str:
    """Whether errors are below `limit` (-0.1: by 10 % and more), as the mean says and as its interval does."""
    if not np.isfinite(difference.mean):
        return "–"
    reached = "yes" if difference.mean <= limit else "no"
    high = difference.ci95[1]
    sure = np.isfinite(high) and (high <= limit if reached == "yes" else difference.ci95[0] > limit)
    return reached if sure else f"{reached}, not certain"


def fig3_claims(found: Findings, stored: int) -> TextTable:
    """Hindsight: what features are worth, and that neither n nor their number matters much."""
    by_label = {member.label: member for member in found.members}
    lines: list[tuple[str, ...]] = []
    for quantity, name, limit in (("loss", "summed loss", -0.10), ("vx_error_mps", "v_x error at 5 s", -0.08)):
        for reading in _present(found, (HINDSIGHT, MAP)):
            mine = found.against(by_label["cf"], reading).relative[quantity]
            paper = f"{100 * limit:.0f} %" if reading == HINDSIGHT else f"{100 * limit:.0f} % (recorded)"
            lines.append((f"cf against b, mean {name}, {_said(reading)}", paper, percent(mine), verdict(mine, limit)))
    for reading in _present(found, (HINDSIGHT, MAP)):
        df, cf = (found.against(by_label[name], reading).relative["distance_error_m"] for name in ("df", "cf"))
        apart = df.mean - cf.mean
        lines.append(
            (
                f"df at or slightly below cf, distance error, {_said(reading)}",
                "df slightly below",
                f"df {100 * df.mean:+.1f} %, cf {100 * cf.mean:+.1f} % of b",
                "yes" if apart <= 0 else "no",
            )
        )
    for name, swept in (("n", compression_sizes(stored)), ("PCA features", feature_numbers(stored))):
        gains = {n: found.against(member, HINDSIGHT).relative["distance_error_m"].mean for n, member in swept.items()}
        said = ", ".join(f"{n}: {100 * gain:+.1f} %" for n, gain in gains.items())
        below = all(gain < 0 for gain in gains.values())
        lines.append((f"robust to {name}, distance error against b", "all below b", said, "yes" if below else "no"))
    return _table(lines)


def fig4_claims(found: Findings) -> TextTable:
    """Distance: naive training fails far away, `dc` does not."""
    by_label = {member.label: member for member in found.members}

    def gain(label: str, name: str) -> PairedDifference:
        return found.against(by_label[label], ("recorded", name)).relative["distance_error_m"]

    lines: list[tuple[str, ...]] = []
    for label in ("df", "cf"):
        far = {name: gain(label, name) for name in ("20", "30", "40")}
        behind = [name for name, value in far.items() if value.mean > 0]
        said = ", ".join(f"{name} m: {100 * value.mean:+.1f} %" for name, value in far.items())
        lines.append((f"{label} falls behind b far away", "behind", said, "yes" if behind else "no"))
    ahead = [gain("df", name).mean - gain("cf", name).mean for name in ("10", "20", "30", "40")]
    said = f"df minus cf, mean over 10 to 40 m: {100 * float(np.mean(ahead)):+.1f} % of b"
    lines.append(("df is more sensitive than cf", "df worse", said, "yes" if np.mean(ahead) > 0 else "no"))
    for name in ("hindsight", "0", "10", "20", "30"):
        value = gain("dc", name)
        where = "in hindsight" if name == "hindsight" else f"at {name} m"
        lines.append((f"dc below b {where}", "below", percent(value), verdict(value)))
    for reading in _present(found, (MAP,)):
        value = found.against(by_label["dc"], reading).relative["distance_error_m"]
        lines.append((f"dc below b, {_said(reading)} (decides)", "not in the paper", percent(value), verdict(value)))
    return _table(lines)


def sentences(found: Findings, label: str) -> list[str]:
    """The main numbers of a model, the way that decides first."""
    member = next(member for member in found.members if member.label == label)

    def sentence(reading: Reading) -> str:
        gains = found.against(member, reading).relative
        numbers = f"distance error after 5 s {percent(gains['distance_error_m'])}, loss {percent(gains['loss'])}"
        return f"{label} against b, {_said(reading)}: {numbers}"

    return [sentence(reading) for reading in _present(found, (MAP, HINDSIGHT))]


def _present(found: Findings, wanted: Sequence[Reading]) -> Iterator[Reading]:
    return (reading for reading in wanted if reading in found.readings)


def _said(reading: Reading) -> str:
    return "map at predicted places" if reading == MAP else "recorded lookup in hindsight"


def _table(lines: Sequence[tuple[str, ...]]) -> TextTable:
    about = (
        "Relative to b on the same windows, with 95 % intervals. The last column follows the mean; 'not certain' where "
        "its interval holds the limit as well."
    )
    return TextTable("What the paper says", ("claim", "paper", "here", "as in the paper"), tuple(lines), about)


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
            row.reading_label,
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
        for reading in found.readings:
            if member.label != BASELINE:
                against = found.against(member, reading)
                name = f"{member.label} · {' '.join(filter(None, reading))}"
                lines.append((name, *(percent(against.relative[key]) for key in NAMES), str(against.n)))
    about = f"Mean error of the model relative to that of {BASELINE}; negative: the model is better."
    names = ("model", *(name.partition(" [")[0] for name in NAMES.values()), "windows")
    return TextTable("Against b", names, tuple(lines), about)


def seed_table(found: Findings) -> TextTable:
    """Each run against the `b` of its seed, for models with several."""
    lines = []
    for member in found.members:
        for reading in found.readings:
            runs = found.each_seed(member, reading)
            if member.label != BASELINE and len(runs) > 1 and reading[1] in (None, "hindsight"):
                gains = [100 * run.relative["distance_error_m"].mean for run in runs]
                losses = [100 * run.relative["loss"].mean for run in runs]
                name = f"{member.label} · {' '.join(filter(None, reading))}"
                lines.append((name, _spread(gains), _spread(losses)))
    about = "Each run relative to the b of its seed, and their standard deviation."
    return TextTable("Seeds", ("model", "distance error [%]", "loss [%]"), tuple(lines), about)


def distance_table(found: Findings, results: Sequence[ResultRow], quantity: str) -> TextTable:
    """A mean error by the distance that features were seen from, and relative to `b`'s with the normals seen then."""
    sets = [name for name in FEATURE_SETS if ("recorded", name) in found.readings]
    rows = {row.reading_label: row for row in last_rows(results)}
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
    sets = [name for name in FEATURE_SETS if ("recorded", name) in found.readings]
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
