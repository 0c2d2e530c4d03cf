"""Tables of a figure: its numbers, and the paper's claims beside the results, rounded in favour of neither."""

from collections.abc import Iterator, Sequence

import numpy as np

from offpiste.core.conventions import FEATURE_SETS
from offpiste.dataset.store import Dataset
from offpiste.evaluation.evaluate import Reading
from offpiste.evaluation.intervals import PairedDifference
from offpiste.evaluation.metrics import ResultRow
from offpiste.report.text_table import TextTable, interval, number
from offpiste.reproduction.results import FigureResults, last_rows, seen_throughout
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
    # A model that learned nothing is no better than b, to the bit.
    reached = "yes" if difference.mean <= limit and difference.mean < 0 else "no"
    low, high = difference.ci95
    sure = np.isfinite(high) and (high <= limit if reached == "yes" else low > limit or low >= 0)
    return reached if sure else f"{reached}, not certain"


VERDICTS = ("yes", "yes, not certain", "no, not certain", "no", "–")
"""From what is sure to what is surely not."""


def above(difference: PairedDifference) -> str:
    """Whether errors are above 0, as the mean says and as its interval does."""
    low, high = difference.ci95
    return verdict(PairedDifference(-difference.mean, (-high, -low)))


def _not(said: str) -> str:
    return said if said == "–" else VERDICTS[3 - VERDICTS.index(said)]


def fig3_claims(results: FigureResults, stored: int) -> TextTable:
    """Claims of figure 3: features help in hindsight, and neither n nor their number matters much."""
    by_label = {model.label: model for model in results.models}
    lines: list[tuple[str, ...]] = []
    for quantity, name, limit in (("loss", "summed loss", -0.10), ("vx_error_mps", "v_x error at 5 s", -0.08)):
        for reading in _present(results, (HINDSIGHT, MAP)):
            mine = results.compare(by_label["cf"], reading).relative[quantity]
            paper = f"{100 * limit:.0f} %" if reading == HINDSIGHT else f"{100 * limit:.0f} % (recorded)"
            lines.append((f"cf against b, mean {name}, {_place(reading)}", paper, percent(mine), verdict(mine, limit)))
    for reading in _present(results, (HINDSIGHT, MAP)):
        df, cf = (results.compare(by_label[name], reading).relative["distance_error_m"] for name in ("df", "cf"))
        apart = results.apart(by_label["df"], by_label["cf"], [reading])
        lines.append(
            (
                f"df at or slightly below cf, distance error, {_place(reading)}",
                "df slightly below",
                f"df {100 * df.mean:+.1f} %, cf {100 * cf.mean:+.1f} %, df minus cf {percent(apart)} of b",
                _not(above(apart)),
            )
        )
    for name, swept in (("n", compression_sizes(stored)), ("PCA features", feature_numbers(stored))):
        gains = {n: results.compare(model, HINDSIGHT).relative["distance_error_m"] for n, model in swept.items()}
        numbers = ", ".join(f"{n}: {percent(gain)}" for n, gain in gains.items())
        below = max((verdict(gain) for gain in gains.values()), key=VERDICTS.index)
        lines.append((f"robust to {name}, distance error against b", "all below b", numbers, below))
    return _table(lines)


def fig4_claims(results: FigureResults) -> TextTable:
    """Claims of figure 4: naive training fails with features seen from afar, `dc` does not."""
    by_label = {model.label: model for model in results.models}

    def gain(label: str, name: str) -> PairedDifference:
        return results.compare(by_label[label], ("recorded", name)).relative["distance_error_m"]

    lines: list[tuple[str, ...]] = []
    for label in ("df", "cf"):
        far = {name: gain(label, name) for name in ("20", "30", "40")}
        behind = min((above(value) for value in far.values()), key=VERDICTS.index)
        numbers = ", ".join(f"{name} m: {percent(value)}" for name, value in far.items())
        lines.append((f"{label} falls behind b far away", "behind", numbers, behind))
    ahead: list[Reading] = [("recorded", name) for name in ("10", "20", "30", "40")]
    apart = results.apart(by_label["df"], by_label["cf"], ahead)
    numbers = f"df minus cf, mean over 10 to 40 m: {percent(apart)} of b"
    lines.append(("df is more sensitive than cf", "df worse", numbers, above(apart)))
    for name in ("hindsight", "0", "10", "20", "30"):
        value = gain("dc", name)
        where = "in hindsight" if name == "hindsight" else f"at {name} m"
        lines.append((f"dc below b {where}", "below", percent(value), verdict(value)))
    for reading in _present(results, (MAP,)):
        value = results.compare(by_label["dc"], reading).relative["distance_error_m"]
        lines.append((f"dc below b, {_place(reading)} (decides)", "not in the paper", percent(value), verdict(value)))
    return _table(lines)


def sentences(results: FigureResults, label: str) -> list[str]:
    """Sentences with a model's main numbers, the terrain lookup that decides first."""
    model = next(model for model in results.models if model.label == label)

    def sentence(reading: Reading) -> str:
        gains = results.compare(model, reading).relative
        numbers = f"distance error after 5 s {percent(gains['distance_error_m'])}, loss {percent(gains['loss'])}"
        return f"{label} against b, {_place(reading)}: {numbers}"

    return [sentence(reading) for reading in _present(results, (MAP, HINDSIGHT))]


def _present(results: FigureResults, wanted: Sequence[Reading]) -> Iterator[Reading]:
    return (reading for reading in wanted if reading in results.readings)


def _place(reading: Reading) -> str:
    return "map at predicted places" if reading == MAP else "recorded lookup in hindsight"


def _table(lines: Sequence[tuple[str, ...]]) -> TextTable:
    about = (
        "Relative to b on the same windows, over all seeds, with 95 % intervals over drives, blocks and seeds. The "
        "last column follows the mean; 'not certain' where its interval holds the limit as well. Where several "
        "numbers make a claim, it is as certain as the one that decides."
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
    """Mean errors after 5 s of every model and terrain lookup."""
    lines = [
        (
            row.reading_label,
            *(f"{number(getattr(row, key).mean, 3)} {interval(getattr(row, key).ci95, 3)}" for key in NAMES),
            number(row.distance_error_m.median),
            f"{row.n}" + (f" ({row.n_failed} failed)" if row.n_failed else ""),
            f"{row.levels.seeds}",
        )
        for row in last_rows(rows)
    ]
    about = (
        "Mean absolute errors over all seeds, with 95 % intervals bootstrapped over drives, blocks of 10 s within "
        "them, and seeds; the loss is over all steps. On the map, other windows are evaluated."
    )
    names = ("model", *NAMES.values(), "median [m]", "windows", "seeds")
    return TextTable("Errors after 5 s", names, tuple(lines), " ".join((about, *_caveats(rows))))


def _caveats(rows: Sequence[ResultRow]) -> list[str]:
    """Numbers of drives and blocks at recorded places and on the map, and what these do not allow to say."""
    counts = {row.lookup or "": row.levels for row in last_rows(rows)}
    each = [f"{name}: {levels.drives} drives, {levels.blocks} blocks" for name, levels in counts.items()]
    caveats = dict.fromkeys(levels.caveat for levels in counts.values() if levels.caveat)
    return [f"{'; '.join(each)}.", *caveats]


def difference_table(results: FigureResults) -> TextTable:
    """Every model against `b`, with the same terrain lookup on the same windows."""
    lines = []
    for model in results.models:
        for reading in results.readings:
            if model.label != BASELINE:
                against = results.compare(model, reading)
                name = f"{model.label} · {' '.join(filter(None, reading))}"
                seeds = str(against.levels.seeds if against.levels else 0)
                lines.append((name, *(percent(against.relative[key]) for key in NAMES), str(against.n), seeds))
    about = (
        f"Mean error of the model relative to that of {BASELINE}; negative: the model is better. Both on the same "
        "draws of drives, blocks and seeds."
    )
    names = ("model", *(name.partition(" [")[0] for name in NAMES.values()), "windows", "seeds")
    return TextTable("Against b", names, tuple(lines), about)


def seed_table(results: FigureResults) -> TextTable:
    """Each run against the `b` of its seed, for models with several runs."""
    lines = []
    for model in results.models:
        for reading in results.readings:
            runs = results.compare_seeds(model, reading)
            if model.label != BASELINE and len(runs) > 1 and reading[1] in (None, "hindsight"):
                gains = [100 * run.relative["distance_error_m"].mean for run in runs]
                losses = [100 * run.relative["loss"].mean for run in runs]
                name = f"{model.label} · {' '.join(filter(None, reading))}"
                lines.append((name, _spread(gains), _spread(losses)))
    about = "Each run relative to the b of its seed, and their standard deviation."
    return TextTable("Seeds", ("model", "distance error [%]", "loss [%]"), tuple(lines), about)


def distance_table(results: FigureResults, result_rows: Sequence[ResultRow], quantity: str) -> TextTable:
    """Mean error by the distance that features were seen from, and relative to `b`'s with the same normals."""
    sets = [name for name in FEATURE_SETS if ("recorded", name) in results.readings]
    rows = {row.reading_label: row for row in last_rows(result_rows)}
    lines = []
    for model in results.models:
        mine = [rows[_reading_label(model.label, name)] for name in sets]
        lines.append((model.label, *(number(getattr(row, quantity).mean, 3) for row in mine)))
        lines.append(("  95 % interval", *(interval(getattr(row, quantity).ci95, 3) for row in mine)))
        if model.label != BASELINE:
            gains = [results.compare(model, ("recorded", name)).relative[quantity] for name in sets]
            lines.append(("  against b", *(percent(gain) for gain in gains)))
    about = "At recorded places; every model, b too, reads the normals of the same set as its features."
    return TextTable(f"Mean {NAMES[quantity]} by distance", ("model", *_metres(sets)), tuple(lines), about)


def seen_table(results: FigureResults, dataset: Dataset) -> TextTable:
    """Distance errors against `b` in windows without missing features, where only their looks change with distance."""
    sets = [name for name in FEATURE_SETS if ("recorded", name) in results.readings]
    windows = results.over_seeds(results.baseline, ("recorded", sets[0]))
    seen = {name: seen_throughout(dataset, name, windows) for name in sets}
    lines: list[tuple[str, ...]] = [("windows", *(str(int(s.sum())) for s in seen.values()))]
    for model in results.models:
        if model.label != BASELINE:
            gains = [results.compare(model, ("recorded", name), seen[name]).relative for name in sets]
            lines.append((model.label, *(percent(gain["distance_error_m"]) for gain in gains)))
    about = "Distance error against b, only on windows whose every wheel has features of the set all along."
    return TextTable("Windows valid throughout", ("model", *_metres(sets)), tuple(lines), about)


def _reading_label(label: str, feature_set: str) -> str:
    return f"{label} · recorded" + ("" if feature_set == "hindsight" else f" {feature_set} m")


def _metres(sets: Sequence[str]) -> list[str]:
    return [name if name == "hindsight" else f"{name} m" for name in sets]


def _spread(values: Sequence[float]) -> str:
    return f"{', '.join(f'{value:+.1f}' for value in values)} (std {np.std(values, ddof=1):.1f})"
